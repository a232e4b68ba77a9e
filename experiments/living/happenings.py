"""What happens to a simulated rover, by the names of `twin.shadow.deviations`."""

import mujoco
import numpy as np

from perception.geometry.arrays import FloatArray
from twin.shadow.deviations import DECK
from twin.simulation import Simulation

TILT = ("pitch", "roll")
BLOCKED = 20.0
"""Friction of what is blocked [N m]; no motor gives 11."""


def happen(
    simulation: Simulation, drawn: mujoco.MjModel, robot: str, name: str, size: float
) -> float:
    """Let something happen to a rover, and return its size as its twin counts it.

    Args:
        simulation: The rover's scene.
        drawn: The rover as drawn, with the same names.
        robot: Its name.
        name: ``battery``, ``loose camera`` (the right eye), or kind and part as of
            `twin.shadow.deviations.rover_deviations`.
        size: Load [kg], friction [N m], drift of a zero or turn of a camera [rad]; 1 of what
            sticks or is blocked; else the share that is lost.

    Returns:
        The size in the twin's unit: of springs and grip what is lost over the drawing's.

    Raises:
        ValueError: If there is no such happening.
    """
    model, one = simulation.model, simulation.robots[robot]
    kind, _, part = name.partition(" ")
    match kind:
        case "load":
            _load(model, robot, part, size)
        case "spring":
            joint = f"{robot}/{part}_suspension_joint"
            lost = size * float(model.joint(joint).stiffness[0])
            model.joint(joint).stiffness[0] -= lost
            return -lost / float(drawn.joint(joint).stiffness[0])
        case "drag":
            model.dof_frictionloss[model.joint(f"{robot}/{part}_joint").dofadr[0]] += size
        case "blocked":
            joint = model.joint(f"{robot}/{part}_joint")
            model.dof_frictionloss[joint.dofadr[0]] += BLOCKED * size
        case "grip":
            wheels = one.description.wheel_names if part == "all" else (part,)
            shares: list[float] = []
            for wheel in wheels:
                lost = size * simulation.wear(robot, wheel, size)
                shares.append(-lost / float(drawn.geom(f"{robot}/{wheel}_tyre").friction[0]))
            return float(np.mean(shares))
        case "loose":
            _turn_camera(model, f"{robot}/stereo_right", size)
        case "supply" | "battery":
            for axis in (part,) if kind == "supply" else one.description.axes:
                one.weaken(axis, size)
        case "stuck" if part in one.description.wheel_names:
            one.sensors.stick("wheel_speeds", one.description.wheel_names.index(part), 0.0)
        case "stuck":
            joint = one.description.joint_names.index(part)
            angle = one.observe().arm_angles.value[joint]
            one.sensors.stick("arm_angles", joint, float(angle))
            one.sensors.stick("arm_rates", joint, 0.0)
        case "zero" if part in TILT:
            one.sensors.drift("inclinometer", TILT.index(part), size)
        case "zero":
            one.sensors.drift("arm_angles", one.description.joint_names.index(part), size)
        case _:
            raise ValueError(f"nothing happens that is called {name!r}")
    return size


def _load(model: mujoco.MjModel, robot: str, part: str, mass: float) -> None:
    """Fix a load to the rear half's deck, or to what holds the gripper."""
    if part == "base":
        body, place = model.body(f"{robot}/rear_chassis"), np.array(DECK)
    else:
        site = model.site(f"{robot}/gripper")
        body, place = model.body(int(site.bodyid[0])), np.array(site.pos)
    _add(model, body.id, place, mass)


def _turn_camera(model: mujoco.MjModel, camera: str, angle: float) -> None:
    """Turn a camera by an angle about all of its axes alike."""
    index = model.camera(camera).id
    turn, turned = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(turn, np.full(3, 3.0**-0.5), angle)
    mujoco.mju_mulQuat(turned, model.cam_quat[index].copy(), turn)
    model.cam_quat[index] = turned


def _add(model: mujoco.MjModel, body: int, place: FloatArray, mass: float) -> None:
    """Add a mass at a place in a body's frame; as a point, which the body's axes bear alike."""
    own, centre = float(model.body_mass[body]), model.body_ipos[body].copy()
    apart = float(np.sum((place - centre) ** 2)) * own * mass / (own + mass)
    model.body_ipos[body] = (own * centre + mass * place) / (own + mass)
    model.body_mass[body] = own + mass
    model.body_inertia[body] += apart
    mujoco.mj_setConst(model, mujoco.MjData(model))
