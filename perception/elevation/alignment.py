"""Alignment of a view with an elevation map: the tilt and the height of its camera.

A tilt that is wrong by a degree moves ground two metres away by as much as a rock is high, and
views from all sides then disagree. The map itself tells the tilt better than a rover's sensors:
most of what a view shows has been mapped before.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from perception.elevation.map import ElevationMap
from perception.elevation.submaps import Submaps
from perception.geometry.arrays import FloatArray, IntArray
from perception.geometry.se3 import transport_covariance

_CUTS = (0.3, 0.15, 0.08, 0.05, 0.03, 0.03, 0.03)
"""Height above or below the map from which on a point tells nothing [m], for each round of least
squares. The first ones find a view whose pose has drifted farther than rocks are high."""
_SIGMA = 0.01  # Deviation of a point's height from that of its cell, beside the pose's error [m].
_ALIKE = 30.0  # Number of points whose errors are one.
_FEWEST, _LEVEL = 3, 0.02  # Points of a cell, and their deviation [m], that show it to be level.
_ENOUGH = 100  # Level cells that tell a share.
_CONTRADICTS = 0.06  # Difference of heights that no error of a view explains, nor a low block [m].


class AlignedView(NamedTuple):
    """Points of a view as they fit a map.

    Attributes:
        points: (N, 3) points [m], world.
        covariance: (6, 6) covariance of the camera's pose in what tells heights: both tilts and the
            height, as a twist in the world; zero in all else.
        rise: Height by which the camera was moved [m].
        contradicted: Share of the known cells that the points show to be level, and whose heights
            they contradict; 0 of few cells.
    """

    points: FloatArray
    covariance: FloatArray
    rise: float
    contradicted: float


def aligned(
    elevation: ElevationMap | Submaps, points: FloatArray, eye: ArrayLike, covariance: ArrayLike
) -> AlignedView:
    """Return a view's points moved by the tilt and the height of the camera that fit the map best.

    Robust least squares over all points in known cells, with the pose's covariance as the prior:
    without any known cell nothing moves.

    Args:
        elevation: Map of the ground, world.
        points: (N, 3) points of the view [m], world.
        eye: (3,) place of the camera [m], world.
        covariance: (6, 6) covariance of its pose as a twist in the world [rad, m].
    """
    centre = RigidTransform.from_translation(np.asarray(eye, dtype=float))
    told = [0, 1, 5]  # Tilt about x, tilt about y, height.
    own = transport_covariance(centre.inv(), np.asarray(covariance, dtype=float))
    own = own[np.ix_(told, told)]
    away = points - centre.translation
    by_error = np.column_stack([away[:, 1], -away[:, 0], np.ones(len(points))])
    cells = elevation.grid.cells_of(points[:, :2])
    inside = elevation.grid.inside(cells)
    known = np.full(len(points), np.nan)
    known[inside] = elevation.heights[tuple(cells[inside].T)]
    seen = np.isfinite(known)
    rows, lacks = by_error[seen], (known - points[:, 2])[seen]
    prior = np.linalg.inv(own)
    error, information = np.zeros(3), prior
    for cut in _CUTS:
        off = (lacks - rows @ error) / cut
        weights = np.square(np.maximum(1.0 - off * off, 0.0)) / (_ALIKE * _SIGMA**2)
        information = prior + (rows * weights[:, None]).T @ rows
        error = np.linalg.solve(information, rows.T @ (weights * lacks))
    moved = points + np.outer(by_error @ error, [0.0, 0.0, 1.0])
    left = np.zeros((6, 6))
    left[np.ix_(told, told)] = np.linalg.inv(information)
    flat = cells[seen] @ [elevation.grid.shape[1], 1]
    contradicted = _contradicted(flat, moved[seen, 2], known[seen])
    return AlignedView(moved, transport_covariance(centre, left), float(error[2]), contradicted)


def _contradicted(cells: IntArray, heights: FloatArray, known: FloatArray) -> float:
    """Return the share of level cells that points contradict.

    Args:
        cells: (N,) number of each point's cell.
        heights: (N,) heights of the points [m].
        known: (N,) heights of their cells [m].
    """
    _, first, which, counts = np.unique(
        cells, return_index=True, return_inverse=True, return_counts=True
    )
    means = np.bincount(which, heights) / counts
    spreads = np.sqrt(np.bincount(which, np.square(heights - means[which])) / counts)
    level = (counts >= _FEWEST) & (spreads < _LEVEL)
    if np.count_nonzero(level) < _ENOUGH:
        return 0.0
    return float(np.mean(np.abs(means - known[first])[level] > _CONTRADICTS))
