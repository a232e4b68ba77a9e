"""One rover at work, its twin, and what happens to it."""

import dataclasses
import functools
import math

import numpy as np

from controllers.motion.simple_motions import Work
from controllers.sensing.diagnosis import Finding
from controllers.sensing.loose_camera import LOOSE_CAMERA
from experiments.live.twin_beside import Named, TwinBeside
from experiments.living.branches import branches
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
        happenings: What happens, each to the same rover at the same time: name and size as of
            `happenings.happen`; the part may be one of several, as ``spring *``. A camera comes
            loose as the only one, as its rover has images.
        learning: Time for which the twin only learns [s].
        unchanged: Time for which the rover works where nothing happens, beside that [s]; 0 for a
            random one of 5 s at most.
    """

    seed: int
    happenings: tuple[tuple[str, float], ...]
    learning: float
    unchanged: float = 0.0


@dataclasses.dataclass(frozen=True)
class Told:
    """What a twin named after something happened.

    Attributes:
        name: What happened, with its part.
        size: Its true size as the twin counts it.
        delay: Time until a change was named [s]; NaN if none was.
        found: Name of that change; empty for none.
        found_size: Its size.
        sigma: Standard deviation of that.
        suspected: What was suspected first, as far as innovations are linear in it, before it was
            tried out; empty if nothing was, or it was found otherwise.
        suspected_size: Its size.
        suspected_sigma: Standard deviation of that.
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

    @property
    def right(self) -> bool:
        """Whether what happened was named."""
        return self.found == self.name

    @property
    def whole(self) -> bool:
        """Whether it happens wholly or not at all, so that it has no size."""
        return self.name.startswith(("stuck", "blocked"))


@dataclasses.dataclass(frozen=True)
class Watched:
    """What a twin told of one rover.

    Attributes:
        told: What it told of each happening.
        alarms: Changes that were named before anything happened.
        seconds: Time for which it was watched before that [s].
        surprise: Root mean square of the innovations over their deviations, in that time.
        nees: Squared errors of its predictions over their bands, in that time, of which the mean
            over readings and predictions; NaN without any.
    """

    told: tuple[Told, ...]
    alarms: tuple[str, ...]
    seconds: float
    surprise: float
    nees: float


class _Beside(LoopRecorder):
    def __init__(self, twin: TwinBeside) -> None:
        self._twin = twin

    def record(self, tick: Tick) -> None:
        self._twin.step(RoverTick(ROBOT, tick.observations[ROBOT], tick.applied[ROBOT]))


def watch(trial: LivingTrial) -> Watched:
    """Let one rover work beside its twin, and things happen to it."""
    rng = np.random.default_rng([trial.seed, 1])
    placed = RobotPlacement(ROBOT)
    twin = TwinBeside(placed, trial.learning, threads=1)
    # Images are drawn where they tell something only.
    loose = any(name == LOOSE_CAMERA for name, _ in trial.happenings)
    stereo = StereoConfig(PAIRS) if loose else None
    with connect(
        "sim", robots=[placed], field=FIELD, realism="default", stereo=stereo, seed=trial.seed
    ) as connection:
        work = Work(twin.drawn, np.random.default_rng([trial.seed, 2]))
        before = trial.unchanged or float(rng.uniform(0.0, WITHIN))
        _run(connection, work, twin, trial.learning + before)
        alarms = tuple(each.finding.name for each in twin.named)
        nees = twin.foresight.nees
        foreseen, surprise = float(np.mean(nees)) if nees else math.nan, _surprise(twin)

        def told(name: str, size: float) -> Told:
            assert connection.simulation is not None
            name, happened = _part(name, twin, rng), trial.learning + before
            size = happen(connection.simulation, twin.shadow.model, ROBOT, name, size)
            _run(connection, work, twin, PATIENCE, len(alarms))
            return _told(twin, name, size, happened, len(alarms))

        ways = [functools.partial(told, *each) for each in trial.happenings]
        # What comes before is the same for all.
        found = branches(ways) if len(ways) > 1 else [way() for way in ways]
    twin.close()
    return Watched(tuple(found), alarms, before, surprise, foreseen)


def _told(twin: TwinBeside, name: str, size: float, happened: float, early: int) -> Told:
    """Return what was named first of something that happened [s], after earlier alarms."""
    named = twin.named[early] if len(twin.named) > early else _NOTHING
    suspected = next((each for each in twin.suspected if each.time > happened), _NOTHING)
    found, first = named.finding, suspected.finding
    return Told(
        name, size, named.time - happened,
        found.name, found.size, found.sigma, first.name, first.size, first.sigma,
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
