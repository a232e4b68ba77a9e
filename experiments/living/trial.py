"""One rover at work, its twin, and what happens to it."""

import dataclasses
import math

import numpy as np

from controllers.motion.simple_motions import Work
from controllers.sensing.diagnosis import Finding
from controllers.sensing.loose_camera import LOOSE_CAMERA
from experiments.live.twin_beside import Named, TwinBeside
from experiments.living.happenings import happen
from models.compose import RobotPlacement
from models.configuration import FieldConfig
from twin.camera import StereoConfig
from twin.connect import Connection, connect
from twin.logs.ticks import RoverTick
from twin.loop import LoopRecorder, Tick
from twin.loop import run as run_loop

ROBOT = "rover1"
FIELD = FieldConfig(size=(16.0, 16.0), texture_pixels=16)
"""Level ground; each robot has tyres of its own."""
PAIRS = 2.0
"""Rate of its images, where a camera comes loose [Hz]."""
WITHIN = 5.0
"""Something happens within so long after the learning, at random [s]."""
PATIENCE = 20.0
"""Time after which what was not named is missed [s]."""
_NOTHING = Named(math.nan, Finding("", math.nan, math.nan, math.nan), "")


@dataclasses.dataclass(frozen=True)
class LivingTrial:
    """One rover to watch.

    Attributes:
        seed: Random seed of robot, sensors, motion, and of what happens where and when.
        happening: What happens: name and size as of `happenings.happen`; the part may be one of
            several, as ``spring *``. Empty for nothing.
        size: Its size.
        learning: Time for which the twin only learns [s].
        unchanged: Time for which the rover works where nothing happens, beside that [s].
    """

    seed: int
    happening: str
    size: float
    learning: float
    unchanged: float = 0.0


@dataclasses.dataclass(frozen=True)
class Watched:
    """What a twin named.

    Attributes:
        name: What happened, with its part; empty for nothing.
        size: Its true size as the twin counts it.
        delay: Time until a change was named [s]; NaN if none was.
        found: Name of that change; empty for none.
        found_size: Its size.
        sigma: Standard deviation of that.
        suspected: What was suspected first, as far as innovations are linear in it, before it was
            tried out; empty if nothing was, or it was found otherwise.
        suspected_size: Its size.
        suspected_sigma: Standard deviation of that.
        alarms: Changes that were named before anything happened.
        seconds: Time for which it was watched before that [s].
        surprise: Root mean square of the innovations over their deviations, in that time.
        nees: Squared errors of its predictions over their bands, in that time, of which the mean
            over readings and predictions; NaN without any.
    """

    name: str
    size: float
    delay: float
    found: str
    found_size: float
    sigma: float
    suspected: str
    suspected_size: float
    suspected_sigma: float
    alarms: tuple[str, ...]
    seconds: float
    surprise: float
    nees: float

    @property
    def right(self) -> bool:
        """Whether what happened was named."""
        return self.found == self.name

    @property
    def whole(self) -> bool:
        """Whether it happens wholly or not at all, so that it has no size."""
        return self.name.startswith(("stuck", "blocked"))


class _Beside(LoopRecorder):
    def __init__(self, twin: TwinBeside) -> None:
        self._twin = twin

    def record(self, tick: Tick) -> None:
        self._twin.step(RoverTick(ROBOT, tick.observations[ROBOT], tick.applied[ROBOT]))


def watch(trial: LivingTrial) -> Watched:
    """Let one rover work, and something happen to it, beside its twin."""
    rng = np.random.default_rng([trial.seed, 1])
    placed = RobotPlacement(ROBOT)
    twin = TwinBeside(placed, trial.learning, threads=1)
    # Images are drawn where they tell something only.
    stereo = StereoConfig(PAIRS) if trial.happening == LOOSE_CAMERA else None
    with connect(
        "sim", robots=[placed], field=FIELD, realism="default", stereo=stereo, seed=trial.seed
    ) as connection:
        work = Work(twin.drawn, np.random.default_rng([trial.seed, 2]))
        before = trial.unchanged or float(rng.uniform(0.0, WITHIN))
        _run(connection, work, twin, trial.learning + before)
        early, alarms = len(twin.named), tuple(each.finding.name for each in twin.named)
        surprise, nees = _surprise(twin), twin.foresight.nees
        foreseen = float(np.mean(nees)) if nees else math.nan
        name, size = _part(trial.happening, twin, rng), 0.0
        if name:
            assert connection.simulation is not None
            drawn = twin.shadow.model
            size = happen(connection.simulation, drawn, ROBOT, name, trial.size)
            _run(connection, work, twin, PATIENCE, early)
    twin.close()
    happened = trial.learning + before
    named = twin.named[early] if len(twin.named) > early else _NOTHING
    suspected = next((each for each in twin.suspected if each.time > happened), _NOTHING)
    found, first = named.finding, suspected.finding
    return Watched(
        name, size, named.time - happened,
        found.name, found.size, found.sigma, first.name, first.size, first.sigma,
        alarms, before, surprise, foreseen,
    )  # fmt: skip


def _surprise(twin: TwinBeside) -> float:
    return float(np.sqrt(np.nanmean(np.square([each.surprise for each in twin.blocks]))))


def _run(
    connection: Connection, work: Work, twin: TwinBeside, seconds: float, named: int | None = None
) -> None:
    """Work for a while, or until a further change is named."""
    run_loop(
        connection.robots, [work], connection.clock, [_Beside(twin)], seconds,
        lambda: named is not None and len(twin.named) > named,
    )  # fmt: skip


def _part(happening: str, twin: TwinBeside, rng: np.random.Generator) -> str:
    """Return a happening with one of its parts chosen at random."""
    kind, _, part = happening.partition(" ")
    parts = {
        "wheel": twin.drawn.wheel_names,
        "joint": twin.drawn.joint_names,
        "tilt": ("pitch", "roll"),
    }
    return f"{kind} {rng.choice(parts[part])}" if part in parts else happening
