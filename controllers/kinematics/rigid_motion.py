"""Motion of frames and links, and the wrench on a body, linear in its inertial parameters."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from perception.geometry.se3 import cross_matrix
from twin.description import RigidBody

NAMES = ("mass", "hx", "hy", "hz", "ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Inertial parameters of a body: mass [kg], first moment of mass h [kg m], inertia [kg m^2].

First moment and inertia are about the origin of the body's frame; off-diagonal inertias are
elements of the tensor, minus the products of inertia.
"""
COUNT = len(NAMES)
INERTIA_ELEMENTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
WEIGHTLESS = RigidBody(0.0, np.zeros(3), np.zeros((3, 3)))


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


def inertial_parameters(body: RigidBody) -> FloatArray:
    """Return the ten inertial parameters (10,) of a body, in the order of `NAMES`.

    Args:
        body: Body, in the frame that the parameters are to be in.
    """
    centre = np.asarray(body.centre)
    about_origin = body.inertia + body.mass * (
        centre @ centre * np.eye(3) - np.outer(centre, centre)
    )
    upper = [about_origin[row, column] for row, column in INERTIA_ELEMENTS]
    return np.array([body.mass, *(body.mass * centre), *upper])


def wrench_regressor(link: LinkMotion) -> FloatArray:
    """Return (n, 6, 10): wrench on a body fixed to a link, per inertial parameter.

    Force [N] and moment [N m] about the base frame's origin, in the base frame; the parameters
    (order of `NAMES`) are in the link's frame.

    Args:
        link: Motion of the link.
    """
    motion = link.motion
    omega = cross_matrix(motion.angular_velocity)
    local = np.zeros((len(link.rotation), 6, COUNT))
    local[:, :3, 0] = motion.specific_force
    local[:, :3, 1:4] = cross_matrix(motion.angular_acceleration) + omega @ omega
    local[:, 3:, 1:4] = -cross_matrix(motion.specific_force)
    turning = _inertia_times(motion.angular_velocity)
    local[:, 3:, 4:] = _inertia_times(motion.angular_acceleration) + omega @ turning
    force = link.rotation @ local[:, :3]
    moment = link.rotation @ local[:, 3:] + cross_matrix(link.position) @ force
    return np.concatenate([force, moment], axis=1)


def _inertia_times(vectors: FloatArray) -> FloatArray:
    """Return (n, 3, 6): I v as a linear map of the six elements of I."""
    matrix = np.zeros((len(vectors), 3, 6))
    for index, (row, column) in enumerate(INERTIA_ELEMENTS):
        matrix[:, row, index] = vectors[:, column]
        matrix[:, column, index] = vectors[:, row]
    return matrix
