"""Description of a robot: plain data of the robot as drawn.

It comes from drawings and datasheets, never from the robot as made, and is readable while the robot
is disconnected. Frames: the robot frame is that of the chassis, x to the right, y forward, z up
(Thesis fig. 2-2); the camera frame is that of the left camera, x to the right, y down, z along the
view.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.geometry.pinhole import EXACT_CALIBRATION, Pinhole, StereoCalibration


@dataclasses.dataclass(frozen=True)
class RigidBody:
    """A rigid body in a frame of its own.

    Attributes:
        mass: Mass [kg].
        centre: (3,) centre of mass from the frame's origin [m].
        inertia: (3, 3) inertia tensor about the centre of mass [kg m^2].
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray


@dataclasses.dataclass(frozen=True)
class JointDescription:
    """A hinge or slide and the link that it moves; its axis goes through the link's origin.

    Attributes:
        name: Name of the joint and of its axis in the contract.
        transform_link_to_parent: Transform from the link's frame to its parent's at position zero.
        axis: (3,) unit vector of the hinge or slide in the link's frame.
        body: Link with everything fixed to it, link frame.
        limits: Lowest and highest position [rad, or m for a slide].
        slides: True for a slide, False for a hinge.
        rotor_inertia: Inertia of the motor's rotor at the joint [kg m^2, or kg for a slide].
        friction: Dry friction of gear and motor at the joint [N m, or N for a slide].
        cover_points: (k, 3) points in the link's frame [m]; spheres about them of the arm's
            `cover_radius` cover the link.
        zero_sigma: Standard deviation of the measured position's zero [rad or m].
        rest: Distance from the middle of the gear's play at which the joint rests [rad or m], to
            the one side or to the other; joints that bear a load rest on the same side.
        place_sigma: Standard deviation of the joint's place along each axis [m].
    """

    name: str
    transform_link_to_parent: RigidTransform
    axis: tuple[float, float, float]
    body: RigidBody
    limits: tuple[float, float] = (-math.inf, math.inf)
    slides: bool = False
    rotor_inertia: float = 0.0
    friction: float = 0.0
    cover_points: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 3)))
    zero_sigma: float = 0.0
    rest: float = 0.0
    place_sigma: float = 0.0


@dataclasses.dataclass(frozen=True)
class ArmDescription:
    """A serial arm of hinges on its force/torque sensor.

    Attributes:
        transform_base_to_robot: Transform from the arm's base, the sensor's face, to the robot.
        base: Body between the sensor and the first joint, base frame.
        joints: Joints from the base to the wrist.
        home: (n,) joint angles of the arm's rest posture [rad].
        cover_radius: Radius of the spheres that cover the links [m].
    """

    transform_base_to_robot: RigidTransform
    base: RigidBody
    joints: tuple[JointDescription, ...]
    home: FloatArray
    cover_radius: float

    @property
    def limits(self) -> FloatArray:
        """(n, 2) lowest and highest joint angles [rad]."""
        return np.array([joint.limits for joint in self.joints])


@dataclasses.dataclass(frozen=True)
class MotorDescription:
    """A motor's torque-speed line at its output shaft, friction of the gear included.

    At duty d it turns with torque = stall_torque * (d - speed / no_load_speed).

    Attributes:
        stall_torque: Torque at full duty and rest [N m].
        no_load_speed: Speed at full duty without a load [rad/s].
    """

    stall_torque: float
    no_load_speed: float

    def __post_init__(self) -> None:
        """Refuse a motor that could not turn.

        Raises:
            ValueError: If a number is not positive.
        """
        for name, value in vars(self).items():
            if not value > 0.0:
                raise ValueError(f"motor {name} must be positive, got {value}")


@dataclasses.dataclass(frozen=True)
class WheelDescription:
    """A driven wheel on its spring, which lets it move up and down.

    Attributes:
        name: Name of the wheel and of its axis in the contract.
        centre: (3,) the wheel's centre [m], robot frame, at rest.
        radius: Rolling radius [m].
        mass: Mass of the parts that move with the wheel [kg].
        spring: Stiffness of its spring [N/m]; infinite for a wheel that is fixed to the body.
        damper: Damping of its spring [N s/m].
        friction: Dry friction of its gear [N m].
        spring_sigma: Standard deviation of the stiffness by its tolerance, as a share of it.
    """

    name: str
    centre: FloatArray
    radius: float
    mass: float
    spring: float
    damper: float
    friction: float
    spring_sigma: float


@dataclasses.dataclass(frozen=True)
class StereoHeadDescription:
    """Two equal cameras on the arm's last link, rows aligned.

    Attributes:
        camera: Intrinsics of either camera.
        baseline: Distance from the left to the right camera along the camera's x [m].
        transform_camera_to_wrist: Transform from the left camera to the arm's last link.
        calibration: What the head's calibration states of its own errors.
        exposure: Exposure time of a pair, as set [s]; 0 for images that no motion blurs.
    """

    camera: Pinhole
    baseline: float
    transform_camera_to_wrist: RigidTransform
    calibration: StereoCalibration = EXACT_CALIBRATION
    exposure: float = 0.0


@dataclasses.dataclass(frozen=True)
class RobotDescription:
    """A rover as drawn.

    Attributes:
        name: Name of the robot.
        wheels: Driven wheels in contract order; the same number on either side.
        body: Rover without its arm, robot frame.
        body_spheres: (k, 4) centre and radius [m] of spheres that cover the rover without its arm,
            robot frame.
        centre_height: Height of the robot frame's origin over level ground at rest [m].
        arm: Description of the arm; None for a rover without one.
        head: Description of the stereo head on the arm; None without one.
        sensor_sigma: Standard deviation of each channel's noise by its datasheet, by name of the
            channel, in the channel's units; one number, or one for each of its values.
        motors: Motors of the axes, in the order of `axes`.
    """

    name: str
    wheels: tuple[WheelDescription, ...]
    body: RigidBody
    body_spheres: FloatArray
    centre_height: float
    arm: ArmDescription | None
    head: StereoHeadDescription | None
    sensor_sigma: Mapping[str, FloatArray]
    motors: tuple[MotorDescription, ...]

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of all motors in contract order: the wheels, then the arm's joints."""
        return (*self.wheel_names, *self.joint_names)

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """Names of the wheels in contract order."""
        return tuple(wheel.name for wheel in self.wheels)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints from the base to the wrist; none without an arm."""
        return tuple(joint.name for joint in self.arm.joints) if self.arm is not None else ()

    @property
    def wheel_radius(self) -> float:
        """Mean rolling radius of the wheels [m]."""
        return float(np.mean([wheel.radius for wheel in self.wheels]))

    @property
    def half_track(self) -> float:
        """Mean distance of the wheels from the robot's plane of symmetry [m]."""
        return float(np.mean([abs(wheel.centre[0]) for wheel in self.wheels]))

    @property
    def half_wheelbase(self) -> float:
        """Largest distance of a wheel ahead of or behind the robot's middle [m]."""
        return float(np.max([abs(wheel.centre[1]) for wheel in self.wheels]))
