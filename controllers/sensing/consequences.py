"""What a change means for the rover's task: go on, go on slower, or stop."""

import dataclasses
import enum

import numpy as np

from controllers.sensing.diagnosis import UNKNOWN, Finding
from perception.geometry.gravity import GRAVITY
from twin.description import RobotDescription


class Consequence(enum.Enum):
    """What to do, the mildest first."""

    GO_ON = "go on"
    SLOWER = "go on slower"
    STOP = "stop"


@dataclasses.dataclass(frozen=True)
class Bounds:
    """From which size on a change has a consequence, as (slower, stop).

    Assumptions: what a rover as drawn has to spare. A size counts with its standard deviation, so
    that of two that look alike the one that is known worse is taken for larger.

    Attributes:
        torque: Share of a motor's torque at rest that is lost, or that friction takes; what is
            blocked lacks all, and a motor whose encoder sticks is led by none.
        base_load: Load on the base over the rover's weight as drawn.
        gripper_load: Moment of a load in the gripper about the shoulder with the arm stretched
            out, over the torque of that motor at rest.
        spring: Share of a spring's stiffness that is lost.
        grip: Share of a tyre's friction that is lost.
        zero: What a zero drifted by [rad].
        camera: What a camera turned by [rad]: beyond a few pixels the eyes match nothing.
    """

    torque: tuple[float, float] = (0.1, 0.5)
    base_load: tuple[float, float] = (0.1, 0.5)
    gripper_load: tuple[float, float] = (0.1, 0.5)
    spring: tuple[float, float] = (0.3, 0.8)
    grip: tuple[float, float] = (0.3, 0.7)
    zero: tuple[float, float] = (0.02, 0.1)
    camera: tuple[float, float] = (0.002, 0.01)


def consequence_of(
    finding: Finding, robot: RobotDescription, bounds: Bounds | None = None
) -> tuple[Consequence, str]:
    """Return what a change means, and why.

    Args:
        finding: A change that a detector named, of those of `twin.shadow.deviations`.
        robot: The rover as drawn.
        bounds: From which size on; None for the default.
    """
    bounds = bounds or Bounds()
    kind, _, part = finding.name.partition(" ")
    part = part.replace("_", " ")
    size = abs(finding.size) + finding.sigma
    if finding.name == UNKNOWN:
        return Consequence.STOP, "what changed is not known"
    motors = dict(zip(robot.axes, robot.motors))
    match kind:
        case "supply":
            share, limits, what = size, bounds.torque, f"the motor of {part} has lost torque"
        case "battery":
            share, limits, what = size, bounds.torque, "all motors have lost torque"
        case "drag":
            motor = motors[finding.name.partition(" ")[2]]
            share, limits = size / motor.stall_torque, bounds.torque
            what = f"{part} turns hard"
        case "stuck" | "blocked":
            share, limits = size, bounds.torque
            what = f"{part} is blocked" if kind == "blocked" else f"the encoder of {part} sticks"
        case "load" if part == "base":
            share, limits = size / robot_mass(robot), bounds.base_load
            what = "the base carries a load"
        case "load":
            moment = size * GRAVITY * reach(robot)
            share, limits = moment / motors["shoulder"].stall_torque, bounds.gripper_load
            what = "the gripper carries a load"
        case "spring":
            share, limits, what = size, bounds.spring, f"the spring of {part} is soft"
        case "grip":
            share, limits, what = size, bounds.grip, f"the grip of {part} fell"
        case "loose":
            share, limits, what = size, bounds.camera, "a camera came loose"
        case _:
            share, limits, what = size, bounds.zero, f"the zero of {part} drifted"
    slower, stop = limits
    if share >= stop:
        return Consequence.STOP, what
    return (Consequence.SLOWER if share >= slower else Consequence.GO_ON), what


def on_springs(finding: Finding) -> bool:
    """Return whether a change moves how the rover pitches on its springs under its arm."""
    return finding.name.partition(" ")[0] in ("load", "spring")


def robot_mass(robot: RobotDescription) -> float:
    """Return the mass of a rover with its arm, as drawn [kg]."""
    arm = robot.arm
    if arm is None:
        return robot.body.mass
    return robot.body.mass + arm.base.mass + sum(joint.body.mass for joint in arm.joints)


def reach(robot: RobotDescription) -> float:
    """Return how far the arm's end gets from its shoulder, stretched out [m].

    Raises:
        ValueError: If the rover has no arm.
    """
    if robot.arm is None:
        raise ValueError(f"{robot.name} has no arm")
    beyond = robot.arm.joints[2:]
    lengths = [np.linalg.norm(joint.transform_link_to_parent.translation) for joint in beyond]
    last = robot.arm.joints[-1].cover_points
    return float(sum(lengths) + np.linalg.norm(last, axis=1).max(initial=0.0))
