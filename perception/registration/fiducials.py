"""Which points of a view serve as fiducials: the evaluation function of eq. 3-21.

``F.E.F. = f(P(x)) + g(C(u, v)) + h(H(x))``, less a penalty near other fiducials. Each term is
brought to [0, 1], so that the weights say what matters. The thesis' contrast is large on a
straight edge as well, along which a match slides: so a fiducial must also be told apart along both
axes, to a given accuracy for the image noise. And its depth contrast draws to where one surface
hides another, whose images move apart: so the patch that is tracked must lie on one surface.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from perception.registration.checks import RegistrationError, weakness
from perception.registration.fiducial_terms import (
    FiducialConfig,
    depth_term,
    inverse_radius,
    match_sigma,
    on_one_surface,
    visual_term,
)
from perception.stereo.geometry import StereoGeometry

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


@dataclasses.dataclass(frozen=True)
class Selection:
    """The chosen fiducials, best first; there may be fewer than asked for, or none.

    Attributes:
        indices: (K,) which of the points they are.
        image_points: (K, 3) columns, rows, disparities [px].
        ratings: (K,) F.E.F. without the penalty.
        certainty: (K,) f, 0 to 1.
        visual: (K,) g, 0 to 1.
        depth: (K,) h, 0 to 1.
        trouble: Why the set cannot fix a motion; None if it can.
    """

    indices: IndexArray
    image_points: FloatArray
    ratings: FloatArray
    certainty: FloatArray
    visual: FloatArray
    depth: FloatArray
    trouble: str | None


def select_fiducials(
    image: NDArray[np.uint8],
    image_points: ArrayLike,
    geometry: StereoGeometry,
    *,
    certainties: ArrayLike | None = None,
    taken: ArrayLike | None = None,
    next_view: RigidTransform | None = None,
    config: FiducialConfig | None = None,
) -> Selection:
    """Choose fiducials among measured points by eq. 3-21.

    Args:
        image: (H, W) left image.
        image_points: (N, 3) columns, rows, disparities [px] of points that a stereo match or a
            map puts there; those with a value that is not finite are passed over.
        geometry: Of the cameras.
        certainties: (N,) P(x), 0 to 1, for instance of the map's occupancy; from the points'
            covariance by default.
        taken: (K, 2 or more) columns and rows of fiducials that there are already [px].
        next_view: The next camera to this one, roughly; what will leave the view is passed over.
        config: What makes a good one.

    Raises:
        RegistrationError: If an array has the wrong shape.
    """
    c = config or FiducialConfig()
    seen = np.asarray(image_points, dtype=float)
    if image.shape != (geometry.height, geometry.width) or seen.ndim != 2 or seen.shape[1] != 3:
        raise RegistrationError(
            f"fiducials of an image {image.shape} with points {seen.shape}: expected "
            f"({geometry.height}, {geometry.width}) and (N, 3)"
        )
    points = geometry.points(seen)
    certain = _certainties(points, certainties, geometry, c)
    usable = np.isfinite(points).all(axis=1) & np.isfinite(certain) & _inside(seen, geometry, c)
    if next_view is not None and len(points):
        usable &= _inside(geometry.project(next_view.apply(points, inverse=True)), geometry, c)
    usable[usable] &= match_sigma(image, seen[usable], c) <= c.localisation
    chosen = np.flatnonzero(usable)
    chosen = chosen[on_one_surface(seen, image.shape, chosen, c)]
    visual = visual_term(image, seen[chosen], c)
    depth = depth_term(seen, points[:, 2], image.shape, chosen, c)
    score = c.visual_weight * visual + c.depth_weight * depth + c.certainty_weight * certain[chosen]
    order = _best_of_cells(seen[chosen], score, c)
    chosen, visual, depth = chosen[order], visual[order], depth[order]
    good = np.isfinite(points).all(axis=1) & np.isfinite(certain)
    certainty = certain[chosen] * inverse_radius(
        points[good], certain[good], points[chosen], certain[chosen], c.shell, c.shells
    )
    ratings = c.certainty_weight * certainty + c.visual_weight * visual + c.depth_weight * depth
    others = np.zeros((0, 2)) if taken is None else np.asarray(taken, dtype=float)[:, :2]
    best = _spaced(seen[chosen, :2], ratings, others, c)
    picked = chosen[best]
    return Selection(
        picked,
        seen[picked],
        ratings[best],
        certainty[best],
        visual[best],
        depth[best],
        weakness(seen[picked], c.sigma),
    )


def _certainties(
    points: FloatArray, given: ArrayLike | None, geometry: StereoGeometry, config: FiducialConfig
) -> FloatArray:
    if given is not None:
        certain = np.asarray(given, dtype=float)
        if certain.shape != (len(points),):
            raise RegistrationError(f"certainties {certain.shape}: expected ({len(points)},)")
        return certain
    if not len(points):
        return np.zeros(0)
    safe = np.where(np.isfinite(points), points, 1.0)
    spread = np.trace(geometry.covariance(safe, config.sigma), axis1=1, axis2=2) / 3.0
    return 1.0 / (1.0 + spread / config.spread**2)


def _inside(
    seen: FloatArray, geometry: StereoGeometry, config: FiducialConfig
) -> NDArray[np.bool_]:
    """Say which lie so that the whole patch is in both images."""
    margin = config.patch // 2 + 1
    column, row, disparity = seen[:, 0], seen[:, 1], seen[:, 2]
    inside = (column - disparity >= margin) & (column < geometry.width - margin)
    return inside & (row >= margin) & (row < geometry.height - margin)


def _best_of_cells(seen: FloatArray, score: FloatArray, config: FiducialConfig) -> IndexArray:
    """Return which points score best in their square of the image."""
    order = np.argsort(-score, kind="stable")
    squares = np.floor(seen[order, :2] / config.cell).astype(np.intp)
    _, first = np.unique(squares, axis=0, return_index=True)
    return order[np.sort(first)]


def _spaced(
    pixels: FloatArray, ratings: FloatArray, taken: FloatArray, config: FiducialConfig
) -> IndexArray:
    """Pick the best one by one; each pick lowers the ratings about it."""
    left = ratings.copy()
    picked: list[int] = []
    near = list(taken)
    while True:
        for place in near:
            distance = np.linalg.norm(pixels - place, axis=1)
            left -= config.penalty * np.maximum(1.0 - distance / config.spacing, 0.0)
            left[distance < config.least_spacing] = -np.inf
        if len(picked) == config.count or not len(left) or not np.isfinite(left.max()):
            return np.array(picked, dtype=np.intp)
        best = int(left.argmax())
        picked.append(best)
        near = [pixels[best]]
