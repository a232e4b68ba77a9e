"""One run of ``appa-tipover``: the arm swings a load, guarded or not, on true ground."""

import dataclasses
import math

import numpy as np

from controllers.motion.tipping.guarded_swing import HELD, GuardedSwing, GuardedSwingConfig
from controllers.motion.tipping.tip_over import Sweep
from experiments.appa.control.trial import PERIOD, ROBOT, arm_config
from experiments.appa.tipover.scene import TipScene
from perception.geometry.arrays import FloatArray
from twin.simulation import Simulation

FOLDED = np.array([0.0, 2.2, -2.4, 0.2])
"""Joint angles in which the load is nearest to the rover, but for the yaw [rad]."""
WAIT, AFTER = 0.5, 1.5
"""Rest before a motion and after it [s]."""
COMPARE_EVERY = 3
"""Servo ticks between two evaluations of the ground's pressure."""
TIPPED = np.radians(10.0)
"""Tilt from which the rover counts as tipped: two wheels are 5 cm in the air."""


@dataclasses.dataclass(frozen=True)
class TipTrial:
    """Parameters of one run.

    Attributes:
        load: Mass in the gripper [kg].
        yaw: Initial yaw of the arm [rad].
        target: (4,) joint angles of its end [rad].
        duration: Requested duration [s].
        guard: Kind of guard, one of `guarded_swing.GUARDS`.
        seed: Random seed of the sensors.
        slope: Slope of the ground [rad].
        downhill: Direction in which the ground falls, from the rover's right to its front [rad].
    """

    load: float
    yaw: float
    target: tuple[float, float, float, float]
    duration: float
    guard: str
    seed: int
    slope: float = 0.0
    downhill: float = 0.0


@dataclasses.dataclass(frozen=True)
class TipRun:
    """Result of one swing of a load.

    Attributes:
        tipped: Whether the rover tipped over, 0 or 1.
        tilt_deg: Largest tilt from the ground's normal [deg].
        seconds: Duration of the motion [s].
        stretch: Duration over the requested one.
        report: Report of the guard.
        part: Share of the path that was travelled, or that is allowed.
        point: (n, 2) zero-moment point of eq. A-5 on the ground, from below the rover [m].
        pressure: (n, 2) MuJoCo's centre of pressure, likewise [m].
        margin: (n,) distance of the pressure from the footprint's edge [m]; negative on the outer
            half of a tyre, since the footprint is that of the tyres' middles.
        gone: (n, 2) time [s] and share of the path that the reference has travelled.
    """

    tipped: int
    tilt_deg: float
    seconds: float
    stretch: float
    report: str
    part: float
    point: FloatArray
    pressure: FloatArray
    margin: FloatArray
    gone: FloatArray


def run_tip(trial: TipTrial) -> TipRun:
    """Swing the arm and watch the wheels."""
    folded = FOLDED + [trial.yaw, 0.0, 0.0, 0.0]
    scene = TipScene(trial.load, folded, trial.slope, trial.downhill)
    simulation = Simulation(scene.model, [ROBOT], seed=trial.seed, data=scene.data)
    scene.data = simulation.data
    robot = simulation.robots[ROBOT]
    # A load near the base's own weight makes the base's feed-forward a loop of gain above one.
    config = arm_config(scene.footing.chain, "pd_gravity", 0.0)
    asked = Sweep(folded, np.array(trial.target), trial.duration)
    controller = GuardedSwing(
        GuardedSwingConfig(config, scene.footing, asked, trial.guard, WAIT, scene.ahead, trial.seed)
    )
    controller.plan(robot.observe())
    robot.activate()
    points, pressures, gone = [], [], []
    tilt, tick, over = 0.0, 0, math.inf
    whole = np.linalg.norm(np.array(trial.target) - folded)
    while tick * PERIOD < over + AFTER and tilt <= TIPPED:
        time = tick * PERIOD - WAIT
        seen = robot.observe()
        robot.command(controller.step({ROBOT: seen})[ROBOT])
        simulation.tick()
        tick += 1
        tilt = max(tilt, scene.tilt)
        if math.isinf(over) and controller.over(time):
            over = tick * PERIOD
        pair = scene.balance() if tick % COMPARE_EVERY == 0 else None
        if pair is None:
            continue
        points.append(scene.on_ground(pair[0]))
        pressures.append(scene.on_ground(pair[1]))
        travelled = np.linalg.norm(controller.at(time).angles - folded)
        gone.append([time, travelled / whole])
    simulation.close()
    seconds = min(over, tick * PERIOD) - WAIT
    if controller.online is not None and math.isfinite(over):
        seconds -= min(controller.online.held, HELD)
    return TipRun(
        tipped=int(tilt > TIPPED),
        tilt_deg=float(np.degrees(tilt)),
        seconds=seconds,
        stretch=seconds / trial.duration,
        report=controller.report,
        part=controller.part,
        point=np.array(points),
        pressure=np.array(pressures),
        margin=np.array([scene.footing.margin(point) for point in pressures]),
        gone=np.array(gone),
    )
