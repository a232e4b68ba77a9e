"""Vertical plane in which a rover's arm swings: ahead its base pitches, sideways it rolls.

With the arm turned to the right the equations of `pitch_model` hold for roll, the axes exchanged.
One thing is added: the base's halves turn about the centre joint, so each rolls on its own springs.
Both roll about the line on the ground, in which the tyres' grip acts, and what one half exerts on
the other acts on that one the other way round. So in the sum of both halves' equations the centre
joint and the grip cancel: the mean roll of two like halves obeys the equation of one body. As the
centre joint lies as high as the inclinometer, that feels the acceleration of the mean roll as well.
What it shows is the tilt of the front half, from which the mean differs by half the angle that the
centre joint's potentiometer reads.
"""

import dataclasses

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.robot import Observation


@dataclasses.dataclass(frozen=True)
class SwingPlane:
    """Vertical plane through the arm's base in which it swings.

    Frame of the plane: y along the stretched arm, z up, x to the right of it.

    Attributes:
        name: Name of the base's tilt in this plane.
        yaw: Angle of the arm's first joint, to the left of straight ahead [rad].
        parameters: Names of the five parameters of the tilt: inertia, lever along the plane, lever
            up, damping and stiffness.
        twists: Whether the base's halves tilt by themselves in this plane.
    """

    name: str
    yaw: float
    parameters: tuple[str, str, str, str, str]
    twists: bool

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of an observation that an identification in this plane needs."""
        always = ("arm_base_wrench", "arm_angles", "inclinometer")
        return (*always, "centre_angle") if self.twists else always

    @property
    def axis(self) -> FloatArray:
        """(3,) unit vector about which the base tilts, to the right of the plane, robot frame."""
        return np.array([np.cos(self.yaw), np.sin(self.yaw), 0.0])

    @property
    def along(self) -> FloatArray:
        """(3,) unit vector along the stretched arm at shoulder angle zero, robot frame."""
        return np.array([-np.sin(self.yaw), np.cos(self.yaw), 0.0])

    def wrench(self, wrench: FloatArray) -> FloatArray:
        """Return a wrench (6,) of the robot's frame in the plane's."""
        robot_to_plane = np.array([self.axis, self.along, [0.0, 0.0, 1.0]])
        return (wrench.reshape(2, 3) @ robot_to_plane.T).ravel()

    def tilt(self, inclinometer: FloatArray) -> float:
        """Return the tilt in the plane [rad] of an inclinometer's pitch and roll (2,) [rad]."""
        return float(self.axis[:2] @ inclinometer)

    def half_twist(self, observation: Observation) -> float:
        """Return by how much the mean of the halves tilts beyond the front half [rad]."""
        if not self.twists:
            return 0.0
        rear_beyond_front = np.array([0.0, float(observation.centre_angle.value[0])])
        return 0.5 * self.tilt(rear_beyond_front)


PITCH = SwingPlane("pitch", 0.0, ("ixx", "ry", "rz", "b_pitch", "k_pitch"), twists=False)
ROLL = SwingPlane("roll", -np.pi / 2, ("iyy", "rx", "rz", "b_roll", "k_roll"), twists=True)
"""The lever rx leads to the right, as the arm points."""
