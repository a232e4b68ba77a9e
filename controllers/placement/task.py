"""Target, occluder, lens and the rating of a view (Thesis section 4.2.3).

The same on the plane (two coordinates) and in space (three). The camera is the point at the front
principal node of its lens and always points straight at the target.
"""

import dataclasses
from typing import NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import FloatArray

FREE_BELOW = 0.05
"""Probability of occupancy below which a position is free for a camera (section 4.2.3)."""


@dataclasses.dataclass(frozen=True)
class Target:
    """A feature to watch.

    Attributes:
        name: Name used in results and errors.
        position: (D,) reference point of the target [m], world; D is 2 or 3.
        normal: (D,) unit vector out of the visible side, world.
        outline: (K, D) points whose convex hull is the target [m], from `position`, world axes.
            The hull contains the position.
        relation_error: Uncertainty of the target's position relative to the primary target,
            ST_error of eq. 4-4 [m]; 0 for the primary target.

    Raises:
        ValueError: If an entry is malformed; the message names it.
    """

    name: str
    position: FloatArray
    normal: FloatArray
    outline: FloatArray
    relation_error: float = 0.0

    def __post_init__(self) -> None:
        position = np.array(self.position, dtype=float)
        normal = np.array(self.normal, dtype=float)
        outline = np.atleast_2d(np.array(self.outline, dtype=float))
        if position.shape not in ((2,), (3,)):
            raise ValueError(f"target {self.name!r}: position {position} is not of 2 or 3 numbers")
        if normal.shape != position.shape or outline.shape[1:] != position.shape:
            raise ValueError(
                f"target {self.name!r}: normal {normal.shape} and outline {outline.shape} do not "
                f"fit a position of {len(position)} numbers"
            )
        if not all(np.isfinite(a).all() for a in (position, normal, outline)) or not len(outline):
            raise ValueError(f"target {self.name!r}: a coordinate is missing or not finite")
        if abs(np.linalg.norm(normal) - 1.0) > 1e-6:  # noqa: PLR2004
            raise ValueError(f"target {self.name!r}: normal {normal} is no unit vector")
        if not (np.isfinite(self.relation_error) and self.relation_error >= 0.0):
            raise ValueError(f"target {self.name!r}: relation_error {self.relation_error} < 0")
        for name, value in (("position", position), ("normal", normal), ("outline", outline)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)


@dataclasses.dataclass(frozen=True)
class Occluder:
    """A convex body that may hide a target: the convex hull of its points.

    Attributes:
        name: Name used in results and errors.
        points: (N, D) points whose convex hull is the occluder [m], world; D is 2 or 3.

    Raises:
        ValueError: If the points are malformed; the message names the occluder.
    """

    name: str
    points: FloatArray

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=float)
        if points.shape[1:] not in ((2,), (3,)) or len(points) == 0:
            raise ValueError(
                f"occluder {self.name!r}: points {points.shape}, expected (N, 2) or (N, 3)"
            )
        if not np.all(np.isfinite(points)):
            raise ValueError(f"occluder {self.name!r}: a coordinate is not finite")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)


@dataclasses.dataclass(frozen=True)
class Lens:
    """Properties of a camera that bound its placement.

    Attributes:
        field_of_view: Field of view along one detector axis [rad].
        pixels: Number of pixels along the same axis.
        near: Nearest distance in focus [m].
        far: Farthest distance in focus [m].

    Raises:
        ValueError: If a number is out of range; the message says what is expected.
    """

    field_of_view: float
    pixels: int
    near: float
    far: float

    def __post_init__(self) -> None:
        if not 0.0 < self.field_of_view < np.pi:
            raise ValueError(f"field_of_view {self.field_of_view} rad: expected 0 to pi")
        if self.pixels < 1:
            raise ValueError(f"pixels {self.pixels}: expected at least one")
        if not 0.0 < self.near < self.far < np.inf:
            raise ValueError(f"near {self.near} m, far {self.far} m: expected 0 < near < far")

    @property
    def pixel_per_metre(self) -> float:
        """Size of a pixel on the target over the distance, 2 tan(fov / 2) / n [m/m]."""
        return 2.0 * np.tan(self.field_of_view / 2.0) / self.pixels


@dataclasses.dataclass(frozen=True)
class Exponents:
    """Exponents alpha, beta, gamma and delta of eq. 4-1; 0 removes a term.

    A hidden or averted target is never a view, whatever the exponents; a target out of focus is
    one only if the exponent of the depth of field is 0.

    Attributes:
        depth: Exponent alpha of the depth of field.
        resolution: Exponent beta of the resolution.
        field: Exponent gamma of the target field visibility.
        angle: Exponent delta of the target angular visibility.

    Raises:
        ValueError: If an exponent is negative or not finite: a better view would rate lower.
    """

    depth: float = 1.0
    resolution: float = 1.0
    field: float = 1.0
    angle: float = 1.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"exponent {name} = {value}: expected a number from 0 up")


@dataclasses.dataclass(frozen=True)
class View:
    """A camera pose with its rating.

    Attributes:
        target: Name of the target that the camera watches.
        position: (D,) camera position [m], world. The camera points straight at the target.
        distance: Distance from camera to target [m].
        rating: Rating by eq. 4-1 [1/m].
        free_cap: Target field visibility: smallest angle by which the camera can move around the
            target, in any direction, until the target is hidden [rad].
        occupancy: Probability that the camera position is occupied.
    """

    target: str
    position: FloatArray
    distance: float
    rating: float
    free_cap: float
    occupancy: float


class PlacementError(RuntimeError):
    """No pose sees the target; the message gives the most common reason."""


class RatingTerms(NamedTuple):
    """Numbers of eq. 4-1 that do not depend on the camera's position, for compiled code.

    Attributes:
        pixel_per_metre: `Lens.pixel_per_metre` [m/m].
        near: `Lens.near` [m].
        far: `Lens.far` [m].
        relation_error: `Target.relation_error` [m].
        depth_exponent: `Exponents.depth`.
        resolution_exponent: `Exponents.resolution`.
        field_exponent: `Exponents.field`.
        angle_exponent: `Exponents.angle`.
    """

    pixel_per_metre: float
    near: float
    far: float
    relation_error: float
    depth_exponent: float
    resolution_exponent: float
    field_exponent: float
    angle_exponent: float


def rating_terms(lens: Lens, target: Target, exponents: Exponents) -> RatingTerms:
    """Return the terms of the rating for a lens, a target and exponents."""
    values = (lens.pixel_per_metre, lens.near, lens.far, target.relation_error)
    return RatingTerms(*map(float, (*values, *dataclasses.astuple(exponents))))


@numba.njit(cache=True)
def sharpness(terms: RatingTerms, distance: float) -> float:
    """Return the factor of the resolution in eq. 4-1.

    Args:
        terms: Numbers of the rating.
        distance: Distance from camera to target [m].
    """
    size = distance * terms.pixel_per_metre + terms.relation_error
    return (1.0 / size) ** terms.resolution_exponent


@numba.njit(cache=True)
def rate_view(
    terms: RatingTerms, distance: float, free_cap: float, cos_angle: float, occupancy: float
) -> float:
    """Rate one view by eq. 4-1 [1/m]; 0 where it is none.

    It is none where the target is hidden or averted, where the position is not free, or, unless the
    exponent of the depth of field is 0, where the target is out of focus.

    Args:
        terms: Numbers of the rating.
        distance: Distance from camera to target [m].
        free_cap: Target field visibility [rad], 0 where hidden.
        cos_angle: Cosine between the target's normal and the direction to the camera.
        occupancy: Probability that the camera position is occupied.
    """
    if occupancy >= FREE_BELOW or free_cap <= 0.0 or cos_angle <= 0.0:
        return 0.0
    in_focus = 1.0 if terms.near <= distance <= terms.far else 0.0
    return (
        in_focus**terms.depth_exponent
        * sharpness(terms, distance)
        * free_cap**terms.field_exponent
        * cos_angle**terms.angle_exponent
        * (1.0 - occupancy)
    )
