"""The acceleration of free fall, and the tilt that shows in it."""

import math
from typing import Final

import numpy as np

from perception.geometry.arrays import FloatArray

GRAVITY: Final = 9.81
"""Acceleration of free fall [m/s^2], MuJoCo's default."""


def apparent_tilt(force: FloatArray, most: float = math.pi / 2.0) -> FloatArray:
    """Return pitch and roll (n, 2) that masses hung in specific forces (n, 3) show.

    Args:
        force: In the frame of what is tilted [m/s^2]; pitch is about its x, roll about its y.
        most: Largest tilt along either axis, at which the masses stop [rad].
    """
    limit = math.sin(most)
    pitch = np.arcsin(np.clip(force[:, 1] / GRAVITY, -limit, limit))
    across = -force[:, 0] / (GRAVITY * np.cos(pitch))
    return np.column_stack([pitch, np.arcsin(np.clip(across, -limit, limit))])
