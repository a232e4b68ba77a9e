"""A rover on soft springs swings its arm: what it measured, what was true, what it identified."""

import dataclasses
import functools

import numpy as np

from controllers.identification.pitch import PitchData, PitchFit
from controllers.identification.pitch_model import PitchSensors
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.arm_control import ArmController
from controllers.motion.base_tilt import TiltAxis
from controllers.sensing.surrogate import SensorLimits, SurrogateSensing
from controllers.sensing.surrogate_models import (
    TiltModel,
    TiltModelConfig,
    WrenchModel,
    WrenchModelConfig,
)
from experiments.appa.control.plant import MOUNT, sprung_rover
from experiments.appa.control.trial import ROBOT, arm_config, reference
from models import datasheets
from models.compose import settle
from twin.describe import describe
from twin.robot import MISSING, Observation
from twin.simulation import Simulation

PERIOD = 0.01
LEARNT = 400
"""Ticks from which the springs are identified; the rest is for tests."""
PUSH = np.array([1.0, -2.0, 1.5])
"""Force on the hand by the world, world frame, in a pushed run's last second [N]."""
GRIP = np.array([0.0, 0.12, 0.0])


@dataclasses.dataclass(frozen=True)
class Run:
    """Ticks of a run; the thesis' rover has neither accelerometer nor gyro."""

    seen: list[Observation]
    wrench: np.ndarray
    tilt: np.ndarray
    arm: SerialChain


@functools.cache
def swing(ticks=700, pushed=False, inertial=False) -> Run:
    """Return a run of MuJoCo's on springs of 150 N m/rad."""
    model = sprung_rover(150.0)
    arm = SerialChain.of_robot(describe(model, ROBOT))
    simulation = Simulation(model, [ROBOT], seed=3, data=settle(model))
    robot, data = simulation.robots[ROBOT], simulation.data
    config = arm_config(arm, "pd_gravity", 0.015)
    controller = ArmController(config, reference)
    site, chassis = data.site(f"{ROBOT}/gripper"), data.body(f"{ROBOT}/chassis")
    wrist = int(model.site_bodyid[site.id])
    robot.activate()
    seen, wrench, tilt = [], [], []
    for tick in range(ticks):
        observation = robot.observe()
        up = chassis.xmat.reshape(3, 3)[2]
        tilt.append([np.arcsin(up[1]), -np.arctan2(up[0], up[2])])
        # The last of ten samples.
        parts = [data.sensor(f"{ROBOT}/arm_base_{k}").data[-3:] for k in ("force", "torque")]
        wrench.append(np.concatenate(parts))
        shown = observation if inertial else observation._replace(accelerometer=MISSING,
                                                                  gyro=MISSING)  # fmt: skip
        seen.append(shown)
        robot.command(controller.step({ROBOT: observation})[ROBOT])
        if pushed and tick >= ticks - 100:
            lever = site.xpos - data.xipos[wrist]
            data.xfrc_applied[wrist] = np.concatenate([PUSH, np.cross(lever, PUSH)])
        simulation.tick()
    simulation.close()
    return Run(seen, np.array(wrench), np.array(tilt), arm)


def wrench_model() -> WrenchModel:
    """Return the model of the rover's arm, as it is known."""
    return WrenchModel(WrenchModelConfig(swing().arm, MOUNT, GRIP))


@functools.cache
def tilt_config() -> TiltModelConfig:
    """Return the springs as they are identified from wrench and inclinometer."""
    run = swing()
    wrench = np.array([o.arm_base_wrench.value for o in run.seen[:LEARNT]])
    tilt = np.array([o.inclinometer.value for o in run.seen[:LEARNT]])
    wrench, tilt = wrench - wrench[:5].mean(axis=0), tilt - tilt[0]
    x, y, z, nx, ny, nz = wrench.T
    quarter = np.column_stack([y, -x, z, ny, -nx, nz])
    indices = np.arange(4, LEARNT, 4)
    axes = [
        TiltAxis.of(PitchFit(PitchSensors()).fit(PitchData.of(w, indices, t[indices])))
        for w, t in ((wrench, tilt[:, 0]), (quarter, tilt[:, 1]))
    ]
    return TiltModelConfig(axes[0], axes[1])


def limits(**changes) -> dict[str, SensorLimits]:
    """Return limits of both sensors."""
    force, moment = datasheets.FORCE_TORQUE.force_noise, datasheets.FORCE_TORQUE.torque_noise
    wrench = SensorLimits(np.array([force] * 3 + [moment] * 3), np.array([1.0] * 3 + [0.5] * 3))
    tilt = SensorLimits(np.full(2, datasheets.INCLINOMETER.noise), np.radians([1.0, 1.0]))
    both = {"arm_base_wrench": wrench, "inclinometer": tilt}
    return {name: dataclasses.replace(one, **changes) for name, one in both.items()}


def sensing(**changes) -> SurrogateSensing:
    """Return both models with their monitors."""
    return SurrogateSensing(wrench_model(), TiltModel(tilt_config()), limits(**changes))
