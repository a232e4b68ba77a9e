"""The rover's arm, and the rod that models it in the simulation study of chapter 2."""

import dataclasses
from typing import Final


@dataclasses.dataclass(frozen=True)
class ArmSheet:
    """The four-degree-of-freedom arm above the force/torque sensor, stereo head included.

    Lengths [m], masses [kg]. The thesis gives the weight alone; the rest is our assumption.
    """

    mass: float = 0.76  # Thesis app. D
    base_mass: float = 0.10  # Assumption: flange of the sensor
    turret_mass: float = 0.10  # Assumption
    upper_mass: float = 0.14  # Assumption: tube and elbow motor
    forearm_mass: float = 0.10  # Assumption: tube
    wrist_mass: float = 0.08  # Assumption: gripper
    base_height: float = 0.03  # Assumption: sensor face to the base joint
    turret_height: float = 0.03  # Assumption: base joint to the shoulder
    upper_length: float = 0.20  # Assumption: the arm reaches the ground and 0.4 m ahead
    forearm_length: float = 0.18  # Assumption
    wrist_length: float = 0.12  # Assumption: wrist joint to the grip point
    joint_limits: tuple[tuple[float, float], ...] = (
        (-2.6, 2.6),  # base yaw
        (-1.0, 2.4),  # shoulder
        (-2.6, 2.6),  # elbow
        (-2.0, 2.0),  # wrist
    )
    """Ranges of the joints [rad]. Assumption: free of collisions in the forward half space."""
    home: tuple[float, float, float, float] = (0.0, 0.9, -1.4, 0.1)
    """Joint angles of the key frame [rad]. Assumption: the cameras look at the ground ahead."""


@dataclasses.dataclass(frozen=True)
class RodArm:
    """The arm of the simulation study: a slender rod along its y axis (Thesis section 2.6.1).

    Mass [kg]; moments of inertia about its centre of gravity, in its own axes [kg m^2].
    """

    mass: float = 1.0
    ixx: float = 0.02
    iyy: float = 0.001
    izz: float = 0.02
    centre: float = 0.245  # Distance of its centre of gravity along y [m]


ARM: Final = ArmSheet()
ROD_ARM: Final = RodArm()
