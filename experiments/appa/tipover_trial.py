"""One run of ``appa-tipover``: the arm swings a load, guarded or not, and the ground tells."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.motion.arm_control import ArmController, Reference
from controllers.motion.base_motion import level_of
from controllers.motion.online_guard import OnlineGuard
from controllers.motion.tip_over import Guarded, Sweep, guard
from experiments.appa.control_trial import PERIOD, ROBOT, arm_config
from experiments.appa.tipover_scene import TipScene
from twin.robot import Observation
from twin.simulation import Simulation

FloatArray = NDArray[np.float64]
FOLDED = np.array([0.0, 2.2, -2.4, 0.2])
"""Joint angles in which the load is nearest to the rover, but for the yaw [rad]."""
WAYS = ("unguarded", "planned", "online")
"""As asked for; slowed as a whole before it begins; slowed tick by tick."""
WAIT, AFTER = 0.5, 1.5
"""Rest before a motion and after it [s]."""
HELD, PATIENCE = 1.0, 10.0
"""How long a motion may stand still online, and how late it may be, until it counts as over [s]."""
COMPARE_EVERY = 3
"""Servo ticks between two looks at the ground's pressure."""
TIPPED = np.radians(10.0)
"""Lean from which the rover counts as tipped: two wheels are 5 cm in the air."""


@dataclasses.dataclass(frozen=True)
class TipTrial:
    """What one run is.

    Attributes:
        load: Mass in the gripper [kg].
        yaw: Where the arm points before the motion [rad].
        target: (4,) joint angles of its end [rad].
        duration: Asked for [s].
        way: Of `WAYS`.
        seed: Of the sensors.
        slope: Of the ground [rad].
        downhill: Where it falls to, from the rover's right to its front [rad].
    """

    load: float
    yaw: float
    target: tuple[float, float, float, float]
    duration: float
    way: str
    seed: int
    slope: float = 0.0
    downhill: float = 0.0


class _Motion:
    """The reference of a run, by its way."""

    def __init__(self, trial: TipTrial, scene: TipScene, folded: FloatArray) -> None:
        asked = Sweep(folded, np.array(trial.target), trial.duration)
        self.verdict = Guarded(asked, 1.0, math.nan, "")
        self.online: OnlineGuard | None = None
        self._asked, self._scene, self._trial = asked, scene, trial
        if trial.way == "online":
            self.online = OnlineGuard(scene.footing, asked.at)
        self._sweep = asked

    def plan(self, seen: Observation) -> None:
        """Let the guard see the motion first, if it is to."""
        if self._trial.way == "planned":
            self.verdict = guard(self._scene.footing, self._asked, level_of(seen))
            start = self._asked.start
            self._sweep = self.verdict.sweep or Sweep(start, start, self._trial.duration)

    def step(self, time: float, seen: Observation) -> None:
        """Take what is seen at a tick; time is since the motion's beginning [s]."""
        if self.online is not None and time > -0.5 * PERIOD:
            self.online.step(level_of(seen) if seen.inclinometer.usable else None)

    def at(self, time: float) -> Reference:
        """Return the reference at a time since the motion's beginning [s]."""
        if self.online is not None and time > -0.5 * PERIOD:
            return Reference(*self.online.at(time))
        return Reference(*self._sweep.at(time))

    def over(self, time: float) -> bool:
        """Whether the motion has ended; time is since its beginning [s]."""
        if self.online is None:
            return time >= self._sweep.duration
        done = self.online.time >= self._asked.duration
        return done or self.online.held >= HELD or self.online.late >= PATIENCE

    @property
    def part(self) -> float:
        """How much of the way was gone, or is allowed."""
        if self.online is None:
            return 0.0 if self.verdict.sweep is None else self.verdict.sweep.part
        whole = np.linalg.norm(self._asked.end - self._asked.start)
        gone = self._asked.at(self.online.time)[0] - self._asked.start
        return float(np.linalg.norm(gone) / whole)


def run_tip(trial: TipTrial) -> dict[str, Any]:
    """Swing the arm and watch the wheels.

    Returns:
        ``tipped``, largest ``lean_deg`` from the ground's normal, the guard's ``report``, the
        ``part`` of the way that was gone, ``seconds`` of the motion and ``stretch``, these over the
        ones asked for; over the motion ``point`` and ``pressure`` (n, 2), eq. A-5's and MuJoCo's
        from below the rover's origin [m], ``margin`` (n,), of the pressure in the footprint [m]
        (negative on the outer half of a tyre, since the footprint is that of the tyres' middles),
        and ``gone`` (n, 2), time [s] and part of the way by the reference.

    Raises:
        ValueError: If there is no such way.
    """
    if trial.way not in WAYS:
        raise ValueError(f"way {trial.way!r}: valid are {', '.join(WAYS)}")
    folded = FOLDED + [trial.yaw, 0.0, 0.0, 0.0]
    scene = TipScene(trial.load, folded, trial.slope, trial.downhill)
    simulation = Simulation(scene.model, [ROBOT], seed=trial.seed, data=scene.data)
    scene.data = simulation.data
    robot = simulation.robots[ROBOT]
    motion = _Motion(trial, scene, folded)
    motion.plan(robot.observe())
    # A load near the base's own weight makes the base's feed-forward a loop of gain above one.
    config = arm_config(scene.footing.chain, "pd_gravity", 0.0)
    controller = ArmController(config, lambda time: motion.at(time - WAIT))
    robot.activate()
    points, pressures, gone = [], [], []
    lean, tick, over = 0.0, 0, math.inf
    whole = np.linalg.norm(np.array(trial.target) - folded)
    while tick * PERIOD < over + AFTER and lean <= TIPPED:
        time = tick * PERIOD - WAIT
        seen = robot.observe()
        motion.step(time, seen)
        robot.command(controller.step({ROBOT: seen})[ROBOT])
        simulation.step()
        tick += 1
        lean = max(lean, scene.lean)
        if math.isinf(over) and motion.over(time):
            over = tick * PERIOD
        pair = scene.balance() if tick % COMPARE_EVERY == 0 else None
        if pair is None:
            continue
        points.append(scene.on_ground(pair[0]))
        pressures.append(scene.on_ground(pair[1]))
        way = np.linalg.norm(motion.at(time).angles - folded)
        gone.append([time, way / whole])
    simulation.close()
    seconds = min(over, tick * PERIOD) - WAIT
    if motion.online is not None and math.isfinite(over):
        seconds -= min(motion.online.held, HELD)
    return {
        "tipped": int(lean > TIPPED),
        "lean_deg": float(np.degrees(lean)),
        "seconds": seconds,
        "stretch": seconds / trial.duration,
        "report": motion.verdict.report if motion.online is None else motion.online.report,
        "part": motion.part,
        "point": np.array(points),
        "pressure": np.array(pressures),
        "margin": np.array([scene.footing.margin(point) for point in pressures]),
        "gone": np.array(gone),
    }
