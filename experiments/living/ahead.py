"""Motions that may tip a rover over, and what was foreseen of them."""

import dataclasses
import math
import time
from collections.abc import Mapping

import numpy as np

from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.arm_control import ArmController, ArmGains, Reference
from controllers.motion.base_motion import level_of
from controllers.motion.driving import SkidSteer
from controllers.motion.look_ahead import PERIOD, TIPPED, LookAhead, Plan
from controllers.motion.tip_over import Sweep
from experiments.appa.control.trial import arm_config
from models.compose import PayloadConfig, RobotPlacement, make_model
from models.configuration import FieldConfig
from perception.geometry.arrays import FloatArray
from twin.connect import connect
from twin.describe import describe
from twin.description import RobotDescription
from twin.loop import run as run_loop
from twin.robot import Command, Observation, WheelMode
from twin.simulation import Simulation

ROBOT = "rover1"
KINDS = ("swing", "drive")
WITHIN = 5.0
"""Time of a motion, all of which is looked at before a swing [s]."""
AHEAD = 2.0
"""How far is looked ahead of a drive [s]."""
APPROACH, REST = 2.5, 1.0
"""Time in which the arm goes to where a motion begins, and for which it rests there [s]."""
STRETCH = 1.6
"""Time for which a drive does one thing [s]."""
EVERY = 0.5
"""Time from one look ahead to the next, of a drive [s]."""
LIKELY = 0.4
"""Probability above which a guard would stop the motion."""
SLOPE, LOADS = math.radians(20.0), (0.1, 1.0)
SWINGS, SPEED, TURN = (0.4, 2.0), 0.2, 0.6
POSTURES = np.array([[-2.0, 2.0], [-0.2, 1.2], [-1.6, 0.3], [-0.5, 0.5]])
CLEARANCE = 0.18
"""Least height of hand and load above level ground, on the whole way to a posture [m]."""
HAND = np.array([0.0, 0.12, 0.0])
"""Where the load lies in the frame of the wrist [m]."""
_TURN_SHARE = 0.5  # Of the rover as drawn on slopes.
_GAINS = ArmGains(10.0)  # As stiff as arms as made carry such loads without swinging.
_BARE = FieldConfig(texture_pixels=16)


@dataclasses.dataclass(frozen=True)
class AheadTrial:
    """One motion.

    Attributes:
        seed: Random seed of the rover, the slope, the load and the motion.
        kind: ``swing`` of the arm while the wheels stand, or ``drive`` with the arm at rest.
    """

    seed: int
    kind: str


@dataclasses.dataclass(frozen=True)
class Foreseen:
    """What was foreseen of a motion, and what came.

    Attributes:
        tipped: Time at which the rover had tipped over, from the motion's beginning [s]; infinite
            if it did not.
        asked: (n,) times at which was looked ahead [s].
        chances: (n,) probabilities to tip over within the horizon, as foreseen.
        horizon: How far was looked ahead [s].
        slope: Of the ground [rad].
        load: In the gripper [kg].
        took: Longest time that one look took [s].
    """

    tipped: float
    asked: FloatArray
    chances: FloatArray
    horizon: float
    slope: float
    load: float
    took: float

    @property
    def foretold(self) -> bool:
        """Whether a guard would have stopped it, of one that tipped over not too early."""
        looked = (
            self.chances[self.asked >= self.tipped - self.horizon] if self.over else self.chances
        )
        return bool(np.any(looked > LIKELY))

    @property
    def over(self) -> bool:
        """Whether the rover tipped over."""
        return math.isfinite(self.tipped)


class Motion:
    """Makes one motion with a load in the gripper that it knows, and looks ahead.

    Args:
        rover: The rover with its load, as drawn.
        start: (4,) where the arm begins [rad].
        path: The arm's motion from there.
        ways: (k, 2) forward speeds [m/s] and turning rates [rad/s] of a drive; none for a swing.
        rng: Random generator of what is looked at.

    Attributes:
        asked: Times at which it looked ahead [s].
        chances: Probabilities to tip over within `horizon`, as it foresaw.
        horizon: How far it looks ahead [s].
        took: Longest time that one look took [s].
    """

    def __init__(
        self,
        rover: RobotDescription,
        start: FloatArray,
        path: Sweep,
        ways: FloatArray,
        rng: np.random.Generator,
    ) -> None:
        assert rover.arm is not None
        self._approach, self._path = Sweep(rover.arm.home, start, APPROACH), path
        self._steer, self._ways = SkidSteer.of(rover, _TURN_SHARE), ways
        self._ahead, self._rng = LookAhead(rover), rng
        self.horizon = AHEAD if len(ways) else WITHIN
        config = arm_config(SerialChain.of_robot(rover), "pd_gravity", 0.0)
        config = dataclasses.replace(config, gains=_GAINS)
        self._arm = ArmController(config, self._reference)
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._arm.reset()
        self._ticks = -round((APPROACH + REST) / PERIOD)
        self.asked: list[float] = []
        self.chances: list[float] = []
        self.took = 0.0

    @property
    def time(self) -> float:
        """Time since the motion began [s]; below 0 before."""
        return self._ticks * PERIOD

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Command arm and wheels, and look ahead when it is time."""
        seen = observations[ROBOT]
        if self._ticks == 0 or (len(self._ways) and self._is_due()):
            begun = time.perf_counter()
            angles = np.array(seen.arm_angles.value, dtype=float)
            found = self._ahead.outlook(self.plan(angles), self._rng, level_of(seen))
            self.asked.append(self.time)
            self.chances.append(found.tip())
            self.took = max(self.took, time.perf_counter() - begun)
        arm = self._arm.step(observations)[ROBOT]
        wheels = self._steer.wheel_speeds(*self._way(self.time))
        self._ticks += 1
        return {ROBOT: dataclasses.replace(arm, wheels=wheels, wheel_mode=WheelMode.SPEED)}

    def plan(self, angles: FloatArray) -> Plan:
        """Return what is planned from now on.

        Args:
            angles: (4,) where the arm is measured [rad].
        """
        if not len(self._ways):
            return Plan.of_arm(dataclasses.replace(self._path, start=angles).at, self.horizon)
        times = self.time + PERIOD * np.arange(round(self.horizon / PERIOD))
        speeds, turns = np.array([self._way(each) for each in times]).T
        return Plan.of_drive(angles, speeds, turns)

    def _is_due(self) -> bool:
        return self._ticks > 0 and self._ticks % round(EVERY / PERIOD) == 0

    def _way(self, at: float) -> tuple[float, float]:
        """Return speed [m/s] and turning rate [rad/s] at a time."""
        index = math.floor(at / STRETCH + 1e-9)
        if not 0 <= index < len(self._ways):
            return 0.0, 0.0
        speed, turn = self._ways[index].tolist()
        return speed, turn

    def _reference(self, at: float) -> Reference:
        begun = at - APPROACH - REST
        return Reference(*(self._approach.at(at) if begun < 0.0 else self._path.at(begun)))


def foresee(trial: AheadTrial) -> Foreseen:
    """Look ahead before a swing, or every `EVERY` of a drive, and see what comes."""
    rng = np.random.default_rng([trial.seed, KINDS.index(trial.kind)])
    while True:
        found = _attempt(trial, rng)
        if found is not None:
            return found


def _attempt(trial: AheadTrial, rng: np.random.Generator) -> Foreseen | None:
    """Draw a motion and make it; None where the rover tips over before it begins."""
    slope, down = float(rng.uniform(0.0, SLOPE)), rng.uniform(-np.pi, np.pi)
    rises = np.arcsin(math.sin(slope) * np.array([math.cos(down), math.sin(down)])).tolist()
    field = FieldConfig(size=(16.0, 16.0), texture_pixels=16, slope=(rises[0], rises[1]))
    load = float(rng.uniform(*LOADS))
    placed = RobotPlacement(ROBOT, payload=PayloadConfig(load), stereo=False)
    rover = describe(make_model(_BARE, [placed]), ROBOT)
    assert rover.arm is not None
    posture, seconds = _posture(rover, rng), float(rng.uniform(*SWINGS))
    start, path, ways = rover.arm.home, Sweep(rover.arm.home, posture, seconds), np.zeros((0, 2))
    if trial.kind == "drive":
        start, path = posture, Sweep(posture, posture, WITHIN)
        ways = rng.uniform([-SPEED, -TURN], [SPEED, TURN], (math.floor(WITHIN / STRETCH), 2))
    motion = Motion(rover, start, path, ways, rng)
    robots, seed = [placed], int(rng.integers(2**31))
    with connect("sim", robots=robots, field=field, realism="default", seed=seed) as connection:
        simulation = connection.simulation
        assert simulation is not None
        run_loop(
            connection.robots, [motion], connection.clock, [], APPROACH + REST + WITHIN,
            lambda: _tilt(simulation) > TIPPED,
        )  # fmt: skip
        tipped = motion.time if _tilt(simulation) > TIPPED else math.inf
    if tipped <= 0.0:
        return None
    asked, chances = np.array(motion.asked), np.array(motion.chances)
    return Foreseen(tipped, asked, chances, motion.horizon, slope, load, motion.took)


def _posture(rover: RobotDescription, rng: np.random.Generator) -> FloatArray:
    """Return a posture (4,) to which the arm goes clear of the ground."""
    assert rover.arm is not None
    chain, home = SerialChain.of_robot(rover), rover.arm.home
    while True:
        posture = rng.uniform(*POSTURES.T)
        way = home + np.linspace(0.0, 1.0, 12)[:, None] * (posture - home)
        rotations, origins = chain.link_frames(way)
        hands = origins[:, -1] + rotations[:, -1] @ HAND
        lowest = min(origins[:, -1, 2].min(), hands[:, 2].min()) + rover.centre_height
        if lowest > CLEARANCE:
            return posture


def _tilt(simulation: Simulation) -> float:
    """Return the true angle between the rover's and the ground's normals [rad]."""
    axes = simulation.data.xmat[simulation.model.body(f"{ROBOT}/chassis").id]
    return math.acos(min(1.0, float(axes[8])))
