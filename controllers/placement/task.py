"""What a camera is placed for: the target, the lens, and how a view of it is rated.

Thesis section 4.2.3. Works alike on the plane (two coordinates) and in space (three); the camera is
the point at the front principal node of its lens and always looks straight at the target.
"""

from __future__ import annotations

import dataclasses

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

FREE_BELOW = 0.05
"""A place is free for a camera if its probability of being occupied is below (thesis 4.2.3)."""


@dataclasses.dataclass(frozen=True)
class Target:
    """A feature to watch.

    Attributes:
        name: Used in answers and errors.
        position: (D,) its reference point [m], world; D is 2 or 3.
        normal: (D,) unit vector out of its visible side, world.
        outline: (K, D) points whose convex hull is the whole of it [m], from the position, axes of
            the world. The hull contains the position.
        relation_error: How uncertain its place relative to the primary target is, ST_error of
            eq. 4-4 [m]; 0 for the primary target.
    """

    name: str
    position: FloatArray
    normal: FloatArray
    outline: FloatArray
    relation_error: float = 0.0

    def __post_init__(self) -> None:
        """Check and freeze the arrays.

        Raises:
            ValueError: Saying which entry is wrong.
        """
        position = np.array(self.position, dtype=float)
        normal = np.array(self.normal, dtype=float)
        outline = np.atleast_2d(np.array(self.outline, dtype=float))
        dimension = len(position) if position.ndim == 1 else 0
        if dimension not in (2, 3):
            raise ValueError(f"target {self.name!r}: position {position} is not of 2 or 3 numbers")
        if normal.shape != (dimension,) or outline.shape[1:] != (dimension,):
            raise ValueError(
                f"target {self.name!r}: normal {normal.shape} and outline {outline.shape} do not "
                f"fit a position of {dimension} numbers"
            )
        finite = all(np.all(np.isfinite(a)) for a in (position, normal, outline))
        if not finite or len(outline) == 0:
            raise ValueError(f"target {self.name!r}: a coordinate is missing or not finite")
        if abs(np.linalg.norm(normal) - 1.0) > 1e-6:  # noqa: PLR2004
            raise ValueError(f"target {self.name!r}: normal {normal} is no unit vector")
        if not (np.isfinite(self.relation_error) and self.relation_error >= 0.0):
            raise ValueError(f"target {self.name!r}: relation_error {self.relation_error} < 0")
        for name, value in (("position", position), ("normal", normal), ("outline", outline)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)


@dataclasses.dataclass(frozen=True)
class Lens:
    """What of a camera matters for where it is put.

    Attributes:
        field_of_view: Along one detector axis [rad].
        pixels: Along the same axis.
        near: Nearest distance in focus [m].
        far: Farthest distance in focus [m].
    """

    field_of_view: float
    pixels: int
    near: float
    far: float

    def __post_init__(self) -> None:
        """Refuse impossible lenses.

        Raises:
            ValueError: Saying what is expected.
        """
        if not 0.0 < self.field_of_view < np.pi:
            raise ValueError(f"field_of_view {self.field_of_view} rad: expected 0 to pi")
        if self.pixels < 1:
            raise ValueError(f"pixels {self.pixels}: expected at least one")
        if not 0.0 < self.near < self.far < np.inf:
            raise ValueError(f"near {self.near} m, far {self.far} m: expected 0 < near < far")

    @property
    def spread(self) -> float:
        """Size of a pixel on the target for each metre of distance, 2 tan(fov / 2) / n."""
        return 2.0 * np.tan(self.field_of_view / 2.0) / self.pixels


@dataclasses.dataclass(frozen=True)
class Exponents:
    """alpha, beta, gamma and delta of eq. 4-1; at 0 a term counts for nothing.

    A hidden or averted target is never a view, whatever the exponents; out of focus it is one only
    if the depth of field counts for nothing.

    Attributes:
        depth: Of the depth of field, alpha.
        resolution: Of the resolution, beta.
        field: Of the target field visibility, gamma.
        angle: Of the target angular visibility, delta.
    """

    depth: float = 1.0
    resolution: float = 1.0
    field: float = 1.0
    angle: float = 1.0

    def __post_init__(self) -> None:
        """Refuse exponents under which a better view would rate lower.

        Raises:
            ValueError: Naming the offender.
        """
        for name, value in dataclasses.asdict(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"exponent {name} = {value}: expected a number from 0 up")


@dataclasses.dataclass(frozen=True)
class View:
    """A camera pose with its rating.

    Attributes:
        target: Name of the target that it watches.
        position: (D,) of the camera [m], world. It looks straight at the target.
        distance: To the target [m].
        rating: Eq. 4-1 [1/m].
        free_cap: Target field visibility: how far the camera can go about the target, any way,
            until the target is hidden [rad].
        cos_angle: Target angular visibility (eq. 4-3).
        resolution: Eq. 4-4 [1/m].
        occupancy: P at the position.
    """

    target: str
    position: FloatArray
    distance: float
    rating: float
    free_cap: float
    cos_angle: float
    resolution: float
    occupancy: float


class PlacementError(RuntimeError):
    """No pose sees the target; the text says the nearest reason."""


@numba.njit(cache=True)
def rate_view(  # noqa: PLR0913, PLR0917
    distance: float,
    free_cap: float,
    cos_angle: float,
    occupancy: float,
    spread: float,
    near: float,
    far: float,
    relation_error: float,
    exponents: tuple[float, float, float, float],
) -> float:
    """Rate one view by eq. 4-1 [1/m]; 0 where it is none.

    That is where the target is hidden or averted, the place not free, or, unless the exponent of
    the depth is 0, the target out of focus.

    Args:
        distance: From camera to target [m].
        free_cap: Target field visibility [rad], 0 where hidden.
        cos_angle: Cosine between the target's normal and the direction to the camera.
        occupancy: P at the camera.
        spread: `Lens.spread`.
        near: `Lens.near` [m].
        far: `Lens.far` [m].
        relation_error: `Target.relation_error` [m].
        exponents: Depth, resolution, field, angle.
    """
    if occupancy >= FREE_BELOW or free_cap <= 0.0 or cos_angle <= 0.0:
        return 0.0
    in_focus = 1.0 if near <= distance <= far else 0.0
    return (
        in_focus ** exponents[0]
        * (1.0 / (distance * spread + relation_error)) ** exponents[1]
        * free_cap ** exponents[2]
        * cos_angle ** exponents[3]
        * (1.0 - occupancy)
    )


def resolution(distance: ArrayLike, lens: Lens, relation_error: float = 0.0) -> FloatArray:
    """Return the resolution of the target by eqs 4-2 and 4-4 [1/m].

    Args:
        distance: From the camera [m], any shape.
        lens: The camera.
        relation_error: ST_error [m].
    """
    return 1.0 / (np.asarray(distance, dtype=float) * lens.spread + relation_error)
