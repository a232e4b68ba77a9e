"""Ground whose friction differs from patch to patch, and tyres that feel it.

MuJoCo knows one friction a geom, and a tyre's decides alone (`priority`). So it is the tyres'
friction that changes, to that of the ground below each. The map is kept in the compiled model, as a
custom field: whoever steps the scene has it.
"""

import dataclasses

import mujoco
import numba
import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray, IndexArray

TYRE = "_tyre"
"""End of the names of the geoms that feel the map."""
_NAME = "friction_map"


@dataclasses.dataclass(frozen=True)
class FrictionMap:
    """Coulomb coefficients between tyres and a field, one a patch.

    The patches are rectangles with sharp borders: ground of one kind ends where another begins,
    wheels of one robot stand on different kinds, and each coefficient in the range is as likely as
    any other, which interpolation would not leave.

    Attributes:
        size: Lengths of the field along x and y [m], centred on the origin.
        coefficients: (rows, columns), one a patch; row 0 lies at the smallest y.
    """

    size: tuple[float, float]
    coefficients: FloatArray

    def at(self, points: ArrayLike) -> FloatArray:
        """Return the coefficients of the patches in which points lie.

        Args:
            points: (..., 2) [m], world; points outside the field are in its nearest patch.

        Returns:
            (...) coefficients.
        """
        points = np.asarray(points, dtype=float)
        flat = np.ascontiguousarray(points[..., :2].reshape(-1, 2))
        found = np.empty((len(flat), 1))
        whole = np.ones(len(flat))
        _look_up(flat, np.arange(len(flat)), whole, self.coefficients, *self.size, found)
        return found.reshape(points.shape[:-1])


def draw_friction(
    rng: np.random.Generator, size: tuple[float, float], limits: tuple[float, float], patch: float
) -> FrictionMap:
    """Draw a map.

    Args:
        rng: Source of randomness.
        size: Lengths of the field along x and y [m].
        limits: Lowest and highest coefficient; each patch's is uniform between them.
        patch: Edge of a patch [m]; made a little larger or smaller, so that whole ones fill the
            field.
    """
    columns, rows = (max(1, round(length / patch)) for length in size)
    return FrictionMap(size, rng.uniform(*limits, (rows, columns)))


def keep_friction(scene: mujoco.MjSpec, friction: FrictionMap) -> None:
    """Keep a map in a scene, from which `TyreFriction.of` reads it after compilation.

    Args:
        scene: Scene to add to.
        friction: Map to keep.
    """
    shape = friction.coefficients.shape
    numbers = np.concatenate([friction.size, shape, friction.coefficients.ravel()])
    scene.add_numeric(name=_NAME, data=numbers, size=len(numbers))


class TyreFriction:
    """Tyres of a scene that have the friction of the ground below them, or a share if they wear.

    Args:
        model: Compiled scene, whose friction of the tyres is changed.
        friction: Map of the ground.
    """

    def __init__(self, model: mujoco.MjModel, friction: FrictionMap) -> None:
        self._model, self._map = model, friction
        self._tyres = np.array(
            [i for i in range(model.ngeom) if model.geom(i).name.endswith(TYRE)], dtype=np.intp
        )
        #: Share of the ground's friction that each tyre has.
        self._left: FloatArray = np.ones(len(self._tyres))
        self._friction = model.geom_friction

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "TyreFriction | None":
        """Return the tyres of a scene that keeps a map; None without one.

        Args:
            model: Compiled scene.
        """
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, _NAME)
        if index < 0:
            return None
        first, count = model.numeric_adr[index], model.numeric_size[index]
        x, y, rows, columns, *values = model.numeric_data[first : first + count].tolist()
        coefficients = np.array(values).reshape(round(rows), round(columns))
        return cls(model, FrictionMap((x, y), coefficients))

    def wear(self, tyre: str, lost: float) -> None:
        """Let a tyre lose a share of its friction, on all ground from the next update on.

        Args:
            tyre: Name of its geom.
            lost: Share of the friction that it has.
        """
        self._left[self._tyres == self._model.geom(tyre).id] *= 1.0 - lost

    def update(self, data: mujoco.MjData) -> None:
        """Set the friction that the next contacts of the tyres will have.

        The ground that a tyre touches is taken for that below its centre, normal to the plane: its
        contact is within millimetres of there, but for a tyre that climbs a rock. It follows from
        the positions alone, so that a restored state goes on bit for bit.

        Args:
            data: State of the scene; what MuJoCo derives from its positions is computed anew.
        """
        mujoco.mj_kinematics(self._model, data)
        ground, where = self._map, data.geom_xpos
        _look_up(where, self._tyres, self._left, ground.coefficients, *ground.size, self._friction)


@numba.njit(cache=True, inline="always")
def _within(place: float, count: int) -> int:
    """Return the index, among some, of what lies at a place; the first where it is no number."""
    return int(min(place, count - 1.0)) if place > 0.0 else 0


@numba.njit(cache=True)
def _look_up(
    points: FloatArray,
    which: IndexArray,
    shares: FloatArray,
    coefficients: FloatArray,
    length: float,
    width: float,
    found: FloatArray,
) -> None:
    """Write shares of the coefficients at some of the points (N, 2 or more) to their first columns.

    Compiled, since it runs every tick: NumPy's calls would take 2 to 4 % of two rovers' physics.
    """
    rows, columns = coefficients.shape
    for i, share in zip(which, shares):
        row = _within((points[i, 1] / width + 0.5) * rows, rows)
        column = _within((points[i, 0] / length + 0.5) * columns, columns)
        found[i, 0] = share * coefficients[row, column]
