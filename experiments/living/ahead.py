"""Motions that may tip a rover over, and what was foreseen of them."""

import dataclasses
import math

import numpy as np

from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.arm_control import ArmGains
from controllers.motion.driving import SkidSteer
from controllers.motion.tipping.foreseen_motion import ForeseenMotion, MotionConfig
from controllers.motion.tipping.look_ahead import TIPPED, LookAhead
from controllers.motion.tipping.tip_guard import HORIZON, LIKELY
from controllers.motion.tipping.tip_over import Sweep
from experiments.appa.control.trial import arm_config
from models.compose import PayloadConfig, RobotPlacement, make_model
from models.configuration import FieldConfig
from perception.geometry.arrays import FloatArray
from twin.connect import connect
from twin.describe import describe
from twin.description import RobotDescription
from twin.loop import run as run_loop
from twin.simulation import Simulation

ROBOT = "rover1"
KINDS = ("swing", "drive")
WITHIN = 5.0
"""Time of a motion, all of which is looked at before a swing [s]."""
APPROACH, REST = 2.5, 1.0
"""Time in which the arm goes to where a motion begins, and for which it rests there [s]."""
STRETCH = 1.6
"""Time for which a drive does one thing [s]."""
EVERY = 0.5
"""Time from one look ahead to the next, of a drive [s]."""
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
        slope: Slope of the ground [rad].
        load: Mass of the load in the gripper [kg].
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
    arm = arm_config(SerialChain.of_robot(rover), "pd_gravity", 0.0)
    config = MotionConfig(
        dataclasses.replace(arm, gains=_GAINS),
        SkidSteer.of(rover, _TURN_SHARE),
        Sweep(rover.arm.home, start, APPROACH),
        path,
        ways,
        STRETCH,
        REST,
        HORIZON if len(ways) else WITHIN,
        EVERY,
    )
    motion = ForeseenMotion(config, LookAhead(rover), rng)
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
    return Foreseen(tipped, asked, chances, config.horizon, slope, load, motion.took)


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
