"""Motion of an image and its circles of confusion, from depths and velocities."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray, IntArray
from perception.geometry.pinhole import Pinhole

BLOCK = 8
"""Edge of the blocks of pixels for which depth and motion are known once [px]."""


class View(NamedTuple):
    """A camera in the world.

    Attributes:
        lens: Intrinsics.
        pose: Transform from the camera (x right, y down, z forward) to the world.
    """

    lens: Pinhole
    pose: RigidTransform


class Surfaces(NamedTuple):
    """What stands at the middle of each block of an image.

    Attributes:
        closeness: (rows, columns) inverse of the depth along the view [1/m]; 0 for the sky.
        bodies: (rows, columns) index of the body; 0 for the sky and what does not move.
    """

    closeness: FloatArray
    bodies: IntArray


def block_lens(lens: Pinhole) -> Pinhole:
    """Return a camera that has one pixel for each block of another's image."""
    return Pinhole(
        -(-lens.width // BLOCK),
        -(-lens.height // BLOCK),
        lens.fx / BLOCK,
        lens.fy / BLOCK,
        (lens.cx + 0.5) / BLOCK - 0.5,
        (lens.cy + 0.5) / BLOCK - 0.5,
    )


def image_flow(view: View, surfaces: Surfaces, camera: int, twists: FloatArray) -> FloatArray:
    """Return how fast the image moves at each block (rows, columns, 2) [px/s].

    Args:
        view: The camera.
        surfaces: What it sees.
        camera: Index of the body that carries the camera.
        twists: (bodies, 6) angular velocity [rad/s] and velocity [m/s] of the point of each body
            that is at the world's origin, world frame.
    """
    lens, rotation = view.lens, view.pose.rotation.as_matrix()
    rays = block_lens(lens).rays(block_lens(lens).pixel_grid())
    relative = twists[surfaces.bodies] - twists[camera]
    turn, slip = relative[..., :3], relative[..., 3:]
    # A point at depth z is at t + z R ray; its velocity is divided by z, which may be infinite.
    velocity = (slip + np.cross(turn, view.pose.translation)) * surfaces.closeness[..., None]
    motion = (velocity + np.cross(turn, rays @ rotation.T)) @ rotation
    return (motion[..., :2] - rays[..., :2] * motion[..., 2:]) * [lens.fx, lens.fy]


def confusion(
    lens: Pinhole, surfaces: Surfaces, f_number: float, focus_distance: float
) -> FloatArray:
    """Return each block's circle of confusion (rows, columns), its diameter in columns [px].

    A thin lens of focal length f and aperture a, in focus at s, draws a point at depth z as a disc
    of diameter a f / (s - f) |z - s| / z; here over the pixel, by the lens' distance s f / (s - f).

    Args:
        lens: Intrinsics of the camera.
        surfaces: What it sees.
        f_number: Focal length over aperture.
        focus_distance: Depth in focus [m].
    """
    aperture = CAMERA.focal_length / f_number
    return lens.fx * aperture * np.abs(surfaces.closeness - 1.0 / focus_distance)
