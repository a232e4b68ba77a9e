"""One stage of BRAID, exactly: a 3-SPR parallel mechanism.

Three legs join two discs of one radius. A leg has a spherical joint on the base disc and a revolute
joint, tangential to its rim, under the platform disc. So each leg stays in the radial plane of its
platform joint, and seen from the platform its base joint is at
``((r - l sin a) radial, -l cos a)`` with one unknown tilt a. Three tilts close the base triangle:
Newton's method finds them for any number of stages at once.

Frames: z along the stage, leg 1 at -y, leg 2 at +x +y, leg 3 at -x +y (thesis figure E-2).
A pose is a row of 12: the platform's position in the base frame, then its rotation row by row.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from perception.geometry.arrays import FloatArray

LEGS, STATES = 3, 8
_BEARINGS = np.radians([-90.0, 30.0, 150.0])
RADIAL = np.column_stack([np.cos(_BEARINGS), np.sin(_BEARINGS)])
"""(3, 2) unit vectors from the axis of a disc to each leg's joints."""
TOLERANCE = 1e-13
"""Loop closure that Newton's method stops at, in radii."""
_STEPS = 50


@dataclasses.dataclass(frozen=True)
class StageGeometry:
    """Sizes of a stage.

    Attributes:
        radius: Radius of the joints' circle on both discs [m].
        short: Length of a leg whose actuator is off [m].
        long: Length of a leg whose actuator is on [m].
    """

    radius: float = 1.0
    short: float = 1.0
    long: float = 1.3

    def __post_init__(self) -> None:
        """Check the sizes.

        Raises:
            ValueError: If a size is not positive, or short is longer than long.
        """
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise ValueError(f"radius {self.radius}: expected a positive length")
        if not (np.isfinite(self.long) and 0.0 < self.short <= self.long):
            raise ValueError(f"legs {self.short} and {self.long}: expected 0 < short <= long")


def rim_joints(radius: float) -> FloatArray:
    """Return the joints (3, 3) [m] of a disc of a radius [m], in its frame."""
    return radius * np.column_stack([RADIAL, np.zeros(LEGS)])


def state_lengths(geometry: StageGeometry) -> FloatArray:
    """Return leg lengths (8, 3) [m] of all states; leg j is long where bit j is 1."""
    bits = (np.arange(STATES)[:, None] >> np.arange(LEGS)) & 1
    return np.where(bits == 1, geometry.long, geometry.short)


def state_poses(geometry: StageGeometry) -> FloatArray:
    """Return the platform's pose (8, 12) in every state."""
    return stage_pose(state_lengths(geometry), geometry.radius)


def stage_pose(lengths: FloatArray, radius: float) -> FloatArray:
    """Solve the forward kinematics of stages.

    Args:
        lengths: (..., 3) leg lengths [m].
        radius: Radius of the joints' circle [m].

    Returns:
        (..., 12) pose of the platform in the base frame.

    Raises:
        ValueError: If a length is not positive.
        RuntimeError: If the loop of a stage cannot be closed.
    """
    scaled = np.asarray(lengths, dtype=float) / radius
    if scaled.shape[-1] != LEGS or not np.all(np.isfinite(scaled) & (scaled > 0.0)):
        raise ValueError(f"lengths {scaled.shape}: expected (..., 3) positive lengths")
    flat = scaled.reshape(-1, LEGS)
    tilt = close_loops(lambda tilt: _closure(flat, tilt), np.zeros_like(flat), flat)
    return _pose(_base_joints(flat, tilt), radius).reshape(*scaled.shape[:-1], 12)


def close_loops(
    closure: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    unknown: FloatArray,
    lengths: FloatArray,
) -> FloatArray:
    """Solve the equations of n stages by Newton's method, as the thesis does.

    Args:
        closure: Function that returns the residuals (n, 3) and their derivatives (n, 3, 3).
        unknown: (n, 3) unknowns to begin with.
        lengths: (n, 3) leg lengths [radii], for the message.

    Returns:
        (n, 3) unknowns at which the residuals vanish.

    Raises:
        RuntimeError: If the iteration does not converge; it names the legs.
    """
    gap, slope = closure(unknown)
    for _ in range(_STEPS):
        if np.abs(gap).max(initial=0.0) <= TOLERANCE:
            break
        unknown = unknown - np.linalg.solve(slope, gap[..., None])[..., 0]
        gap, slope = closure(unknown)
    worst = int(np.argmax(np.abs(gap).max(axis=1)))
    if not np.abs(gap[worst]).max() <= 10.0 * TOLERANCE:
        raise RuntimeError(f"legs {lengths[worst]} radii: the stage cannot be closed")
    return unknown


def leg_vectors(pose: FloatArray, radius: float) -> FloatArray:
    """Return the vectors (..., 3, 3) [m] of the legs from base to platform, in the base frame.

    Args:
        pose: (..., 12) platform in base.
        radius: Radius of the joints' circle [m].
    """
    joints, rotation = rim_joints(radius), pose[..., 3:].reshape(*pose.shape[:-1], 3, 3)
    return pose[..., None, :3] + np.einsum("...ij,kj->...ki", rotation, joints) - joints


def closure_residual(pose: FloatArray, lengths: FloatArray, radius: float) -> FloatArray:
    """Return the errors with which poses close the loops, in radii.

    Args:
        pose: (..., 12) platform in base.
        lengths: (..., 3) leg lengths [m].
        radius: Radius of the joints' circle [m].

    Returns:
        (..., 6) error of each leg's length, and distance of its end from its radial plane.
    """
    legs = leg_vectors(pose, radius)
    axes = np.column_stack([-RADIAL[:, 1], RADIAL[:, 0], np.zeros(LEGS)])
    hinge = np.einsum("...ij,kj->...ki", pose[..., 3:].reshape(*pose.shape[:-1], 3, 3), axes)
    error = np.concatenate(
        [np.linalg.norm(legs, axis=-1) - lengths, np.sum(legs * hinge, axis=-1)], axis=-1
    )
    return error / radius


def _base_joints(lengths: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return the base joints (n, 3 legs, 3) in the platform frame, for a radius of 1."""
    inward = 1.0 - lengths * np.sin(tilt)
    down = -lengths * np.cos(tilt)
    return np.concatenate([inward[..., None] * RADIAL, down[..., None]], axis=-1)


def _closure(lengths: FloatArray, tilt: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the excess of the base triangle's squared sides, and its derivative."""
    joints = _base_joints(lengths, tilt)
    turn = np.concatenate(
        [
            (-lengths * np.cos(tilt))[..., None] * RADIAL,
            (lengths * np.sin(tilt))[..., None],
        ],
        axis=-1,
    )
    gap = np.empty_like(tilt)
    slope = np.zeros((*tilt.shape, LEGS))
    for row, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        side = joints[:, i] - joints[:, j]
        gap[:, row] = np.sum(side * side, axis=-1) - 3.0
        slope[:, row, i] = 2.0 * np.sum(side * turn[:, i], axis=-1)
        slope[:, row, j] = -2.0 * np.sum(side * turn[:, j], axis=-1)
    return gap, slope


def _pose(joints: FloatArray, radius: float) -> FloatArray:
    """Return the platform in the base frame from the base joints in the platform frame."""
    x = joints[:, 1] - joints[:, 2]
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y = 0.5 * (joints[:, 1] + joints[:, 2]) - joints[:, 0]
    y -= np.sum(x * y, axis=-1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    rotation = np.stack([x, y, np.cross(x, y)], axis=-2)  # rows: base axes in the platform frame
    position = -np.einsum("nij,nj->ni", rotation, joints.mean(axis=1)) * radius
    return np.concatenate([position, rotation.reshape(-1, 9)], axis=-1)
