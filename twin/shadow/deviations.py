"""Ways in which a rover may differ from its drawing, each by one number that is zero as drawn."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import mujoco
import numpy as np

from models.compose import RobotPlacement, build_scene
from models.configuration import FieldConfig
from models.datasheets import SENSOR_ERRORS, TOLERANCES
from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription

DECK = (0.0, -0.11, 0.06)
"""Where a load on the base is taken to lie, in the rear half's frame [m]: on the middle of its
deck."""
LINKS = ("upper_arm", "forearm", "wrist")
"""Links of the arm that reach out, each along the y axis of its frame."""
TIME_STEP = 0.002
"""Physics step of a shadow [s], twice the scenes': its errors stay below the sensors' noise."""
ITERATIONS = 6
"""Of the solver in each step of a model that is to be fast."""
BLOCKING = 1e3
"""Armature by which a twin holds what is blocked [kg m^2]: so much friction its solver does not."""
HAPPENED = 0.5
"""Number from which on what happens wholly or not at all is taken to have happened."""
WEAKEST = 0.9
"""Share of a motor's voltage that is lost at most: a geared motor without any holds its part."""
_LEAST = 0.05  # Share of a stiffness or a friction that is left at least.
_HALF_LOAD = 0.025  # Half size of a load, of which its inertia follows [m].
_UNIFORM = 3.0**-0.5  # Standard deviation of what is even within 1 to both sides.

Writer = Callable[[mujoco.MjModel, float], None]


@dataclasses.dataclass(frozen=True)
class Deviation:
    """One way to differ.

    Attributes:
        name: Such as ``spring front_left``.
        unit: Unit of its number.
        spread: Standard deviation among new robots, and so what is known beforehand.
        change: Standard deviation of what may happen to it later; 0 for what stays as it was made.
        sign: 1 or -1 where it can then only grow or fall, as springs only get softer; 0 for both.
        step: Number with which its effect is calculated: large, as wheels lift and slide anew for
            every little difference.
        write: Function that gives it to a compiled model.
        supply: Share of each motor's voltage that is lost by one unit, by name of the axis.
        reading: What one unit adds to readings, by channel and number.
        encoder: Readings of the encoder of a part that sticks or is blocked, by channel and number;
            none for what else may differ.
        blocked: Joint that is blocked, by its name in the model; empty for what sticks.
        whole: Whether it happens wholly or not at all, and is tried out only.
        most: Largest number, to either side, that there can be.
        wholly: What it is called where it is as large as that; empty if it is still itself.
    """

    name: str
    unit: str
    spread: float
    change: float
    sign: int
    step: float
    write: Writer = lambda model, value: None
    supply: Mapping[str, float] = dataclasses.field(default_factory=dict[str, float])
    reading: Mapping[tuple[str, int], float] = dataclasses.field(
        default_factory=dict[tuple[str, int], float]
    )
    encoder: Sequence[tuple[str, int]] = ()
    blocked: str = ""
    whole: bool = False
    most: float = math.inf
    wholly: str = ""

    @property
    def sticks(self) -> bool:
        """Whether its encoder reads what it read when it stuck."""
        return bool(self.encoder) and not self.blocked


def shadow_scene(robot: RobotPlacement) -> mujoco.MjModel:
    """Return the thesis' rover as drawn on level ground, with loads that weigh nothing.

    Its sensors keep no histories, which MuJoCo cannot linearise.

    Args:
        robot: The rover; its name, card, mast and head count, nothing of how it was made.

    Raises:
        ValueError: If it is another robot, has no arm, or a locked centre joint.
    """
    if robot.model or not robot.arm or robot.centre_locked:
        raise ValueError(
            f"{robot.name}: the twin is of the thesis' rover with its arm and a free centre joint"
        )
    drawn = RobotPlacement(robot.name, card=robot.card, mast=robot.mast, stereo=robot.stereo)
    spec = build_scene(FieldConfig(texture_pixels=16), [drawn])
    spec.option.timestep = TIME_STEP
    for sensor in spec.sensors:
        sensor.nsample = 0
    gripper = spec.site(f"{robot.name}/gripper")
    for name, body, place in (
        ("base", spec.body(f"{robot.name}/rear_chassis"), DECK),
        ("gripper", gripper.parent, gripper.pos),
    ):
        load = body.add_body(name=f"{robot.name}/load_{name}", pos=place)
        load.explicitinertial = True
        load.mass, load.ipos, load.inertia = 1e-9, np.zeros(3), np.full(3, 1e-12)
    return spec.compile()


def hasten(model: mujoco.MjModel) -> None:
    """Let a model step in less time, and always in about the same.

    After a tick rates are within some 0.01 rad/s of what a solver that converges makes of them.
    """
    model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_PGS, ITERATIONS
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)


def rover_deviations(robot: RobotDescription) -> list[Deviation]:
    """Return how the thesis' rover may differ: loads, springs, motors, wheels, zeros, what sticks.

    Args:
        robot: The rover as drawn.
    """
    name = robot.name
    found = [
        Deviation(f"load {place}", "kg", spread, change, 1, step, _load(f"{name}/load_{place}"))
        for place, spread, change, step in (("base", 0.1, 1.5, 1.0), ("gripper", 0.02, 0.2, 0.1))
    ]
    found += _arm_bodies(name)
    for wheel in robot.wheels:
        spring = _factor("joint", f"{name}/{wheel.name}_suspension_joint", "stiffness")
        share = TOLERANCES.spring * _UNIFORM
        found.append(Deviation(f"spring {wheel.name}", "1", share, 0.4, -1, -0.4, spring, most=1.0))
    for wheel in robot.wheels:
        drag = _friction(f"{name}/{wheel.name}_joint")
        found.append(Deviation(f"drag {wheel.name}", "N m", 0.05, 0.5, 1, 0.2, drag))
    low, high = TOLERANCES.tyre_friction or (1.0, 1.0)
    spread = (high - low) / (high + low) * _UNIFORM
    grip = Deviation("grip all", "1", spread, 0.3, -1, -0.3, most=1.0)
    found.append(dataclasses.replace(grip, write=_grip(name, robot.wheel_names)))
    for wheel in robot.wheels:
        own, write = f"grip {wheel.name}", _grip(name, [wheel.name])
        found.append(dataclasses.replace(grip, name=own, spread=0.05, write=write))
    for joint in robot.arm.joints if robot.arm else ():
        friction = _friction(f"{name}/{joint.name}_joint")
        spread = TOLERANCES.joint_friction * _UNIFORM * joint.friction
        found.append(Deviation(f"drag {joint.name}", "N m", spread, 0.5, 1, 0.05, friction))
    for axis in robot.axes:
        supply = Deviation(f"supply {axis}", "1", 0.05, 0.4, 1, 0.2, supply={axis: 1.0})
        found.append(dataclasses.replace(supply, most=WEAKEST, wholly=f"blocked {axis}"))
    zeros = {
        "arm_angles": (robot.joint_names, "rad", SENSOR_ERRORS.encoder_zero, 0.005),
        "inclinometer": (("pitch", "roll"), "rad", SENSOR_ERRORS.inclinometer_zero, 0.03),
    }
    for channel, (labels, unit, most, step) in zeros.items():
        for number, label in enumerate(labels):
            reading = {(channel, number): 1.0}
            spread = most * _UNIFORM
            found.append(Deviation(f"zero {label}", unit, spread, 0.03, 0, step, reading=reading))
    encoders = {
        wheel: [("wheel_speeds", number)] for number, wheel in enumerate(robot.wheel_names)
    } | {
        joint: [("arm_angles", number), ("arm_rates", number)]
        for number, joint in enumerate(robot.joint_names)
    }
    for part, readings in encoders.items():
        whole = Deviation("", "1", 0.02, 0.2, 0, 1.0, encoder=readings, whole=True)
        found.append(dataclasses.replace(whole, name=f"stuck {part}"))
        joint = f"{name}/{part}_joint"
        write = _block(joint)
        found.append(dataclasses.replace(whole, name=f"blocked {part}", write=write, blocked=joint))
    return found


def _arm_bodies(robot: str) -> list[Deviation]:
    """Return what the arm's weight and its moments may be off by; it stays so."""
    found = [Deviation("mass arm", "1", TOLERANCES.mass * _UNIFORM, 0.0, 0, 0.05, _masses(robot))]
    spread = TOLERANCES.centre * _UNIFORM
    for link in LINKS:
        for axis, along in (("y", "along"), ("z", "across")):
            write = _centre(f"{robot}/{link}", "xyz".index(axis))
            found.append(Deviation(f"centre {link} {along}", "m", spread, 0.0, 0, 0.01, write))
    return found


def _masses(robot: str) -> Writer:
    def write(model: mujoco.MjModel, value: float) -> None:
        for link in ("arm_base_link", "turret", *LINKS):
            body = model.body(f"{robot}/{link}").id
            model.body_mass[body] *= 1.0 + value
            model.body_inertia[body] *= 1.0 + value

    return write


def _centre(body: str, axis: int) -> Writer:
    def write(model: mujoco.MjModel, value: float) -> None:
        model.body(body).ipos[axis] += value

    return write


def _load(body: str) -> Writer:
    def write(model: mujoco.MjModel, value: float) -> None:
        index = model.body(body).id
        model.body_mass[index] += value
        model.body_inertia[index] += value * _HALF_LOAD**2 * 2.0 / 3.0
        mujoco.mj_setConst(model, mujoco.MjData(model))

    return write


def _factor(kind: str, name: str, what: str) -> Writer:
    def write(model: mujoco.MjModel, value: float) -> None:
        getattr(getattr(model, kind)(name), what)[0] *= max(1.0 + value, _LEAST)

    return write


def _grip(robot: str, wheels: Sequence[str]) -> Writer:
    def write(model: mujoco.MjModel, value: float) -> None:
        for wheel in wheels:
            model.geom(f"{robot}/{wheel}_tyre").friction[0] *= max(1.0 + value, _LEAST)

    return write


def _friction(joint: str) -> Writer:
    def write(model: mujoco.MjModel, value: float) -> None:
        loss = model.joint(joint).frictionloss
        loss[0] = max(0.0, loss[0] + value)

    return write


def _block(joint: str) -> Writer:
    def write(model: mujoco.MjModel, value: float) -> None:
        model.joint(joint).armature[0] += BLOCKING * value

    return write


def happened(deviations: Sequence[Deviation], values: FloatArray) -> FloatArray:
    """Return deviations (..., n) with what happens wholly or not at all as 0 or 1."""
    whole = [bool(each.encoder) for each in deviations]
    return np.where(whole, values >= HAPPENED, values).astype(float)


def deviating(model: mujoco.MjModel, deviations: Sequence[Deviation], values: FloatArray) -> None:
    """Write deviations of given sizes (n,) into a model, as far as they are of the model."""
    for deviation, value in zip(deviations, happened(deviations, values).tolist()):
        deviation.write(model, value)
