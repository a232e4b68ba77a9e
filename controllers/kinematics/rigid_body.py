"""The ten inertial parameters of a rigid body, and the wrench on it that is linear in them."""

import numpy as np

from controllers.kinematics.frame_motion import LinkMotion
from perception.geometry.arrays import FloatArray
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
