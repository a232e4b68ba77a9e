"""The thesis' equations of a stage (E-6 to E-31), repaired: an approximation beside `stage`.

As printed they cannot be solved. This reading takes delta_j as the height of joint j over
cos gamma_j, ``sin(pi/3)`` in E-7 and E-8, the sign of E-17 that moves the disc towards its
tilt, and drops E-11 to E-15, which nothing uses. E-24 and E-30 hold by themselves once the three
heights lie on a tilted disc; what determines the tilt are the three leg lengths (E-18, E-19, and
leg 1 in section ABCD).

Where legs 2 and 3 are alike it agrees with the exact stage to 3e-6 r at 5 % and 2.4e-4 r at 20 % of
extension. In the other states E-16 and E-17 lack terms in theta_x theta_y and theta_y^2, and E-17
takes leg 3 for both: there x and y are 6e-4 r and 1.0e-2 r off, the disc's normal 5e-6 and 3e-4.
"""

import numpy as np

from controllers.braid.arm.stage import LEGS, close_loops
from perception.geometry.arrays import FloatArray

_STEP = 1e-6
_HALF_WIDTH = np.sqrt(3.0) / 2.0
_SIN_60 = np.sin(np.pi / 3.0)
_COS_30 = np.cos(np.pi / 6.0)


def thesis_stage_pose(lengths: FloatArray, radius: float) -> FloatArray:
    """Solve the repaired equations by Newton's method, as the thesis does.

    Args:
        lengths: (..., 3) leg lengths [m].
        radius: Radius of the joints' circle [m].

    Returns:
        (..., 12) pose of the platform in the base frame, as `stage.stage_pose`.

    Raises:
        RuntimeError: If the iteration does not converge.
    """
    scaled = np.asarray(lengths, dtype=float) / radius
    flat = scaled.reshape(-1, LEGS)

    def closure(unknown: FloatArray) -> tuple[FloatArray, FloatArray]:
        slope = np.empty((len(flat), LEGS, LEGS))
        for column, shift in enumerate(_STEP * np.eye(LEGS)):
            ahead, behind = (_length_errors(unknown + s * shift, flat) for s in (1.0, -1.0))
            slope[:, :, column] = (ahead - behind) / (2.0 * _STEP)
        return _length_errors(unknown, flat), slope

    start = np.column_stack([np.zeros((len(flat), 2)), flat.mean(axis=1)])
    unknown = close_loops(closure, start, flat)
    return _pose(unknown, radius).reshape(*scaled.shape[:-1], 12)


def _shift(unknown: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x (n,), y (n,) of the platform and the heights (n, 3) of its joints, in radii."""
    tilt_x, tilt_y, height = unknown.T
    front, side = np.sin(tilt_x), _HALF_WIDTH * np.sin(tilt_y)
    # E-31, with E-24 and E-30 solved for the heights of the joints.
    heights = np.column_stack(
        [height - front, height + 0.5 * front + side, height + 0.5 * front - side]
    )
    x = -heights[:, 0] * np.tan(tilt_y)  # E-16, gamma_1 = theta_y (E-6)
    gamma_x = -_SIN_60 * tilt_x  # E-8
    y = 0.5 + heights[:, 2] * np.tan(gamma_x) / _COS_30 - 0.5 * np.cos(tilt_x)  # E-17
    return x, y, heights


def _length_errors(unknown: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return by how much the squared legs (n, 3) are too long."""
    tilt_x, tilt_y, _ = unknown.T
    x, y, heights = _shift(unknown)
    narrowing = _HALF_WIDTH * (1.0 - np.cos(tilt_y))
    along_x = np.column_stack([x, x - narrowing, x + narrowing])  # E-16, E-10, E-9
    gamma = np.tan(_SIN_60 * tilt_x) / _COS_30
    along_y = np.column_stack(
        [y + 1.0 - np.cos(tilt_x), -heights[:, 1] * gamma, -heights[:, 2] * gamma]
    )
    return along_x**2 + along_y**2 + heights**2 - lengths**2  # E-18, E-19


def _pose(unknown: FloatArray, radius: float) -> FloatArray:
    tilt_x, tilt_y, height = unknown.T
    x, y, _ = _shift(unknown)
    cx, sx, cy, sy = np.cos(tilt_x), np.sin(tilt_x), np.cos(-tilt_y), np.sin(-tilt_y)
    zero = np.zeros_like(cx)
    # E-5: about x, then about the turned y; the thesis' theta_y lifts leg 2, at +x.
    rotation = np.stack([cy, zero, sy, sx * sy, cx, -sx * cy, -cx * sy, sx, cx * cy], axis=-1)
    return np.concatenate([radius * np.column_stack([x, y, height]), rotation], axis=-1)
