"""How a frame moves, as an accelerometer and a gyro fixed in it would read."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from perception.geometry.se3 import cross_matrix


@dataclasses.dataclass(frozen=True)
class FrameMotion:
    """Motion of a frame, in its own axes, at one sample or at n.

    Attributes:
        specific_force: (3,) or (n, 3) acceleration of its origin minus that of free fall [m/s^2],
            as an accelerometer there would read: 9.81 upward at rest.
        angular_velocity: (3,) or (n, 3) [rad/s].
        angular_acceleration: (3,) or (n, 3) [rad/s^2].
    """

    specific_force: FloatArray
    angular_velocity: FloatArray
    angular_acceleration: FloatArray

    def at(self, place: ArrayLike) -> "FrameMotion":
        """Return the motion of another point of the same rigid body, at one sample.

        Args:
            place: (3,) the point from this origin [m].
        """
        lever = np.asarray(place, dtype=float)
        # As a matrix: np.cross takes ten times as long, and this runs many times a tick.
        spin = cross_matrix(self.angular_velocity)
        turning = (cross_matrix(self.angular_acceleration) + spin @ spin) @ lever
        return FrameMotion(
            self.specific_force + turning, self.angular_velocity, self.angular_acceleration
        )


@dataclasses.dataclass(frozen=True)
class LinkMotion:
    """Pose and motion of a link of a chain at n samples.

    Attributes:
        rotation: (n, 3, 3) from the link's frame to the base frame.
        position: (n, 3) origin of the link's frame [m], base frame.
        motion: Motion of the link's frame, in its own axes.
    """

    rotation: FloatArray
    position: FloatArray
    motion: FrameMotion


def at_rest(up: ArrayLike = (0.0, 0.0, 1.0)) -> FrameMotion:
    """Return the motion of a frame at rest.

    Args:
        up: (3,) unit vector that points up, in the frame's axes.
    """
    return FrameMotion(GRAVITY * np.asarray(up, dtype=float), np.zeros(3), np.zeros(3))


LEVEL = at_rest()
"""A level frame at rest."""
