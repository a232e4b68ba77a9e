"""A vehicle's springs and tyres as one compliance of six degrees of freedom (Thesis eq. A-1).

Each corner's spring and tyre are in series, the corners in parallel. The printed rotational terms
divide a moment by the finite angle atan(dy / dz) of a displacement; for small angles that is the
sum of stiffness times lever squared, as computed here. The same sum reduces dampers.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import cross_matrix


@dataclasses.dataclass(frozen=True)
class Corner:
    """One wheel of a suspended vehicle.

    Attributes:
        place: (3,) where its tyre holds the body, in the body frame [m].
        suspension: (3,) stiffness of its suspension along x, y, z [N/m]; infinite where it is
            rigid, zero where it gives no hold.
        tyre: (3,) stiffness of its tyre along x, y, z [N/m].
    """

    place: tuple[float, float, float]
    suspension: tuple[float, float, float]
    tyre: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Refuse springs of negative stiffness.

        Raises:
            ValueError: Naming the corner and the stiffness.
        """
        for name in ("suspension", "tyre"):
            values = np.asarray(getattr(self, name), dtype=float)
            if values.shape != (3,) or not np.all(values >= 0.0):
                raise ValueError(
                    f"{name} of the corner at {self.place}: {values}, needs three numbers >= 0"
                )

    @property
    def series(self) -> FloatArray:
        """(3,) stiffness of spring and tyre one after the other [N/m].

        Infinite where both are rigid.
        """
        with np.errstate(divide="ignore"):
            return 1.0 / (1.0 / np.array(self.suspension) + 1.0 / np.array(self.tyre))


def reduce_suspension(corners: list[Corner], about: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Return the stiffness at a point of the body (6, 6).

    Rows and columns are translation and rotation along and about x, y, z: [N/m], [N/rad] and
    [N m/rad]. The diagonal is eq. A-1; the other elements couple a push off the elastic centre with
    a tilt. The weight of the body, which takes away m g h of a tilt's stiffness, is not in it.

    Args:
        corners: The wheels.
        about: (3,) the point, in the body frame [m].

    Raises:
        ValueError: If a corner is rigid in series, since then there is no compliance to reduce.
    """
    total = np.zeros((6, 6))
    for corner in corners:
        series = corner.series
        if not np.all(np.isfinite(series)):
            raise ValueError(
                f"corner at {corner.place}: suspension and tyre are both rigid, so there is no "
                "compliance to reduce; give one of them a stiffness"
            )
        lever = np.asarray(corner.place, dtype=float) - np.asarray(about, dtype=float)
        # A small motion (v, w) of the point moves the corner by v + w x lever.
        moves = np.hstack([np.eye(3), -cross_matrix(lever)])
        total += moves.T @ np.diag(series) @ moves
    return total
