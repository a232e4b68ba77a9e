"""Stereo pairs of planes whose disparities are known exactly."""

import numpy as np

from perception.stereo.geometry import StereoGeometry

SMALL = StereoGeometry(200, 160, 300.0, 380.0, 99.5, 79.5, 0.038)


def pattern(columns: np.ndarray, rows: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return grey levels at any place [px]: waves of 5 px and longer, so that none aliases."""
    rng = np.random.default_rng(seed)
    angles, phases = rng.uniform(0.0, 2 * np.pi, (2, 60))
    lengths = 5.0 * 8.0 ** rng.uniform(0.0, 1.0, 60)
    result = np.zeros(np.broadcast_shapes(columns.shape, rows.shape))
    for angle, phase, length in zip(angles, phases, lengths):
        along = np.cos(angle) * columns + np.sin(angle) * rows
        result += np.sqrt(length) * np.cos(2 * np.pi * along / length + phase)
    return 128.0 + 25.0 * result / result.std()


def plane_pair(
    disparity: float,
    by_column: float = 0.0,
    by_row: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
    geometry: StereoGeometry = SMALL,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (2, H, W) uint8 and the true (H, W) disparities of the left image [px].

    The disparity is `disparity` in the middle and changes linearly with the left image's column
    and row; `noise` is that of the images [grey levels].
    """
    columns, rows = np.meshgrid(np.arange(geometry.width), np.arange(geometry.height))
    u, v = columns - geometry.cx, rows - geometry.cy
    truth = disparity + by_column * u + by_row * v
    # A right column u' shows the left column u with u - d(u, v) = u'.
    shown = (u + disparity + by_row * v) / (1.0 - by_column)
    images = np.stack([pattern(u, v, seed), pattern(shown, v, seed)])
    images += noise * np.random.default_rng(seed + 1).standard_normal(images.shape)
    return np.clip(np.rint(images), 0, 255).astype(np.uint8), truth
