"""The 22 unknown parameters of the base on its compliance, and the coordinates they are sought in.

Frame II sits at the base's centre of gravity, x right, y forward, z up; pitch, roll and yaw turn
about x, y and z (Thesis fig. 2-2). Inertia entries are elements of the tensor.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from perception.geometry.arrays import FloatArray

NAMES = (
    "mass",
    "ixx",
    "iyy",
    "izz",
    "ixz",
    "iyz",
    "ixy",
    "rx",
    "ry",
    "rz",
    "bx",
    "by",
    "bz",
    "b_pitch",
    "b_roll",
    "b_yaw",
    "kx",
    "ky",
    "kz",
    "k_pitch",
    "k_roll",
    "k_yaw",
)
UNITS = ("kg",) + ("kg m^2",) * 6 + ("m",) * 3
UNITS += ("N s/m",) * 3 + ("N m s/rad",) * 3 + ("N/m",) * 3 + ("N m/rad",) * 3
COUNT = len(NAMES)
INERTIA = slice(1, 7)
LEVER = slice(7, 10)
DAMPING = slice(10, 16)
STIFFNESS = slice(16, 22)

# Element (row, column) of the inertia tensor that each of the parameters 1..6 is.
INERTIA_ELEMENTS = ((0, 0), (1, 1), (2, 2), (0, 2), (1, 2), (0, 1))
_LOGARITHMIC = np.array([0, *range(10, 22)])
# Least ratio of the second moments in a search: thinner bodies are lost to rounding.
_FLATTEST = 1e-4
# The same ratio where a search starts, away from the prior's steep walls, and a body's least
# extent there [m].
_THINNEST = 0.01


class ParameterError(ValueError):
    """A parameter set no rigid body on springs can have."""


def inertia_tensor(parameters: FloatArray) -> FloatArray:
    """Return the base's inertia tensor (3, 3) [kg m^2] about its centre of gravity, frame II."""
    tensor = np.zeros((3, 3))
    for value, (row, column) in zip(parameters[1:7], INERTIA_ELEMENTS, strict=True):
        tensor[row, column] = tensor[column, row] = value
    return tensor


def from_mapping(values: Mapping[str, float]) -> FloatArray:
    """Return a parameter vector (22,) from names, checked.

    Args:
        values: One number for each of `NAMES`, in SI units.

    Raises:
        ParameterError: If a name is missing, unknown or not a number, or if no body can have it.
    """
    unknown = sorted(set(values) - set(NAMES))
    missing = [name for name in NAMES if name not in values]
    if unknown or missing:
        raise ParameterError(
            f"parameter names: unknown {unknown}, missing {missing}; expected {', '.join(NAMES)}"
        )
    try:
        vector = np.array([float(values[name]) for name in NAMES])
    except (TypeError, ValueError) as error:
        raise ParameterError(f"parameter values: {error}") from None
    check_physical(vector)
    return vector


def check_physical(parameters: FloatArray) -> None:
    """Refuse a parameter set that no body on springs and dampers can have.

    Raises:
        ParameterError: Naming the offending parameter.
    """
    for index in (0, *range(DAMPING.start, COUNT)):
        if not np.isfinite(parameters[index]) or parameters[index] <= 0:
            raise ParameterError(f"{NAMES[index]} = {parameters[index]}: must be positive")
    if not np.all(np.isfinite(parameters)):
        bad = NAMES[int(np.flatnonzero(~np.isfinite(parameters))[0])]
        raise ParameterError(f"{bad} is not finite")
    if np.linalg.eigvalsh(second_moments(parameters)).min() <= 0:
        raise ParameterError(
            f"inertia {inertia_tensor(parameters).tolist()}: no mass distribution has it "
            "(a principal moment must be less than the sum of the other two)"
        )


def second_moments(parameters: FloatArray) -> FloatArray:
    """Return the second moments of mass (3, 3) [kg m^2]: the pseudo-inertia about the c.g."""
    tensor = inertia_tensor(parameters)
    return 0.5 * np.trace(tensor) * np.eye(3) - tensor


def to_coordinates(parameters: FloatArray) -> FloatArray:
    """Map physical parameters (22,) to the coordinates of the search.

    Logarithms for mass, damping and stiffness; lever and inertia as they are. The inertia is kept
    physical by the prior, which is infinite at the edge: in a log-Cholesky chart a search that runs
    to the edge stays there, because the gradient vanishes with the factor.
    """
    coordinates = np.array(parameters, dtype=float)
    coordinates[_LOGARITHMIC] = np.log(parameters[_LOGARITHMIC])
    return coordinates


def from_coordinates(coordinates: FloatArray) -> FloatArray:
    """Invert `to_coordinates`."""
    parameters = np.array(coordinates, dtype=float)
    parameters[_LOGARITHMIC] = np.exp(coordinates[_LOGARITHMIC])
    return parameters


def coordinate_scale(coordinates: FloatArray) -> FloatArray:
    """Return (22,): the diagonal of d(physical) / d(coordinates)."""
    scale = np.ones(COUNT)
    scale[_LOGARITHMIC] = np.exp(coordinates[_LOGARITHMIC])
    return scale


def physical_step(coordinates: FloatArray, step: FloatArray) -> FloatArray:
    """Return `step` with the inertia's share bent so that it ends near by, at a physical body.

    In no direction does the second moment fall below a tenth or rise above ten times of what it
    was, and no body is left thinner than a hundredth of its breadth; every other coordinate is
    kept.

    Args:
        coordinates: (22,) search coordinates of a physical body.
        step: (22,) change of them.
    """
    moments = second_moments(coordinates)
    wanted = second_moments(coordinates + step)
    root = np.linalg.cholesky(moments)
    inverse = np.linalg.inv(root)
    left = root @ _between(inverse @ wanted @ inverse.T, 0.1, 10.0) @ root.T
    left = _between(left, _FLATTEST * np.linalg.eigvalsh(left)[-1], np.inf)
    bent = step.copy()
    bent[INERTIA] = _tensor_elements(left) - coordinates[INERTIA]
    return bent


def closest_body(parameters: FloatArray, least: FloatArray) -> FloatArray:
    """Return the parameters (22,) made physical.

    Args:
        parameters: (22,) any values, of a regression that knows nothing of bodies.
        least: (22,) what mass, damping and stiffness are raised to if they lie below it.
    """
    body = parameters.copy()
    body[_LOGARITHMIC] = np.maximum(body, least)[_LOGARITHMIC]
    moments = second_moments(parameters)
    thinnest = max(_THINNEST * np.linalg.eigvalsh(moments)[-1], _THINNEST**2 * body[0])
    body[INERTIA] = _tensor_elements(_between(moments, thinnest, np.inf))
    return body


def _between(moments: FloatArray, least: float, most: float) -> FloatArray:
    """Return the symmetric matrix (3, 3) with its eigenvalues clipped to these bounds."""
    values, vectors = np.linalg.eigh(moments)
    return (vectors * np.clip(values, least, most)) @ vectors.T


def _tensor_elements(moments: FloatArray) -> FloatArray:
    """Return the inertia's parameters (6,) of a body with these second moments (3, 3)."""
    tensor = np.trace(moments) * np.eye(3) - moments
    return np.array([tensor[element] for element in INERTIA_ELEMENTS])


_MOMENT_BASIS = np.array([second_moments(row) for row in np.eye(COUNT)[1:7]])
_LOWER = np.tril_indices(3)
_DIAGONAL = np.equal(*_LOWER)


@dataclasses.dataclass(frozen=True)
class Prior:
    """Prior of the 22 parameters: an order of magnitude, no more.

    The inertia is guessed as that of a cube of side `size` and of the mass itself, not of its
    guess: a body found to be lighter is not believed to be as hard to turn. The deviation is that
    of the log-Cholesky factor of the second moments; it grows without bound towards a flat body,
    so that a search in the tensor's own elements never reaches one.

    Attributes:
        mass: Guess [kg].
        size: Guess of the body's extent [m].
        damping: Guess of translational [N s/m] and rotational [N m s/rad] damping.
        stiffness: Guess of translational [N/m] and rotational [N m/rad] stiffness.
        log_sigma: Standard deviation of the logarithms of mass, damping and stiffness.
        factor_sigma: Standard deviation of the logarithms of the Cholesky factor's diagonal, and
            of its other elements relative to the diagonal's guess.
        lever_sigma: Standard deviation of the lever about zero [m].
    """

    mass: float = 5.0
    size: float = 0.5
    damping: float = 150.0
    stiffness: float = 1500.0
    log_sigma: float = 1.5
    factor_sigma: float = 0.5
    lever_sigma: float = 0.5

    def mean(self) -> FloatArray:
        """Return the prior mean (22,) as search coordinates."""
        vector = np.zeros(COUNT)
        vector[0] = self.mass
        vector[1:4] = self.mass * self.size**2 / 6
        vector[DAMPING] = self.damping
        vector[STIFFNESS] = self.stiffness
        return to_coordinates(vector)

    def draw(self, generator: np.random.Generator) -> FloatArray:
        """Return search coordinates (22,) drawn from the prior."""
        deviations = generator.normal(size=COUNT)
        coordinates = self.mean()
        coordinates[_LOGARITHMIC] += self.log_sigma * deviations[_LOGARITHMIC]
        coordinates[LEVER] += self.lever_sigma * deviations[LEVER]
        entries = self.factor_sigma * deviations[INERTIA]
        entries[_DIAGONAL] = np.exp(entries[_DIAGONAL])
        factor = np.zeros((3, 3))
        factor[_LOWER] = self._factor_guess(coordinates) * entries
        coordinates[INERTIA] = _tensor_elements(factor @ factor.T)
        return coordinates

    def term(
        self, coordinates: FloatArray, directions: FloatArray | None = None
    ) -> tuple[float, FloatArray, FloatArray]:
        """Return cost (half of the squares), gradient (22,) and information (22, 22).

        Args:
            coordinates: (22,) search coordinates.
            directions: (22, n) orthonormal columns, the combinations of `deviations` that count;
                all unless given.
        """
        deviations, change = self.deviations(coordinates)
        if directions is not None:
            deviations, change = directions.T @ deviations, directions.T @ change
        return float(0.5 * deviations @ deviations), change.T @ deviations, change.T @ change

    def noticeable(self, coordinates: FloatArray, data: FloatArray, share: float) -> FloatArray:
        """Return the combinations of `deviations` along which the prior matters beside the data.

        Args:
            coordinates: (22,) search coordinates.
            data: (22, 22) information of the data about them.
            share: Share of prior and data's joint information from which the prior matters, (0, 1].

        Returns:
            (22, n) orthonormal columns; n is zero if the prior matters nowhere.
        """
        _, change = self.deviations(coordinates)
        inverse = np.linalg.inv(change)
        values, vectors = np.linalg.eigh(inverse.T @ data @ inverse)
        return vectors[:, share * (values + 1.0) <= 1.0]

    def deviations(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how many deviations the coordinates lie off the guess.

        Returns:
            (22,) independent deviations, those of the inertia being of its factor's elements, and
            their derivatives (22, 22) by the coordinates.
        """
        others = np.array([0, *range(LEVER.start, COUNT)])
        sigma = np.full(COUNT, self.log_sigma)
        sigma[LEVER] = self.lever_sigma
        deviations = (coordinates - self.mean()) / sigma
        change = np.zeros((COUNT, COUNT))
        change[others, others] = 1.0 / sigma[others]
        deviations[INERTIA], change[INERTIA, :7] = self._factor_deviations(coordinates)
        return deviations, change

    def _factor_guess(self, coordinates: FloatArray) -> np.float64:
        """Return the guess of the factor's diagonal, that of a cube of the mass itself."""
        return np.exp(0.5 * coordinates[0]) * self.size / np.sqrt(12)

    def _factor_deviations(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the inertia's share of `deviations` (6,), and its derivatives (6, 7)."""
        factor = np.linalg.cholesky(second_moments(coordinates))
        inverse = np.linalg.inv(factor)
        guess = self._factor_guess(coordinates)
        deviation = (factor / guess)[_LOWER]
        # The guess grows with the root of the mass.
        change = np.empty((7, 6))
        change[0] = np.where(_DIAGONAL, -0.5, -0.5 * deviation)
        deviation[_DIAGONAL] = np.log(deviation[_DIAGONAL])
        # dL = L Phi(L^-1 dS L^-T), Phi keeping the lower triangle and half of the diagonal.
        turned = inverse @ _MOMENT_BASIS @ inverse.T
        kept = np.tril(turned) - 0.5 * np.einsum("kii->ki", turned)[:, :, None] * np.eye(3)
        change[1:] = (factor @ kept)[:, _LOWER[0], _LOWER[1]] / guess
        change[1:, _DIAGONAL] *= guess / np.diag(factor)
        return deviation / self.factor_sigma, change.T / self.factor_sigma


RANGES = np.repeat(
    [[0.0, 10.0], [0.0, 1.0], [-0.5, 0.5], [-1.0, 1.0], [0.0, 1000.0], [0.0, 10000.0]],
    [1, 3, 3, 3, 6, 6],
    axis=0,
)
"""(22, 2) spans of values on which the 10-bit metric is read, SI units (Thesis eq. 2-12b).

Generic for a rover of a few kilograms; wide, and not centred on any particular robot.
"""


def average_error_percent(estimate: FloatArray, truth: FloatArray) -> float:
    """Return the mean of |error| / |truth| over the non-zero parameters, in percent.

    The metric that reproduces Table 2-2's averages; Table 2-1's do not follow from its rows.
    """
    used = truth != 0
    return float(100 * np.mean(np.abs(estimate - truth)[used] / np.abs(truth[used])))
