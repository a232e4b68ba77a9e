"""The 22 unknown parameters of the base on its compliance, and the coordinates they are sought in.

Frame II sits at the base's centre of gravity, x right, y forward, z up; pitch, roll and yaw turn
about x, y and z (Thesis fig. 2-2). Inertia entries are elements of the tensor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

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
LEVER = slice(7, 10)
DAMPING = slice(10, 16)
STIFFNESS = slice(16, 22)

# Element (row, column) of the inertia tensor that each of the parameters 1..6 is.
INERTIA_ELEMENTS = ((0, 0), (1, 1), (2, 2), (0, 2), (1, 2), (0, 1))
_CHOLESKY_ELEMENTS = ((0, 0), (1, 1), (2, 2), (2, 0), (2, 1), (1, 0))


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


def to_unconstrained(parameters: FloatArray) -> FloatArray:
    """Map physical parameters (22,) to coordinates in which every point is a physical body.

    Logarithms for mass, damping and stiffness, the log-Cholesky factor of the second moments for
    the inertia, and the lever as it is.
    """
    theta = np.array(parameters, dtype=float)
    factor = np.linalg.cholesky(second_moments(parameters))
    for slot, (row, column) in enumerate(_CHOLESKY_ELEMENTS, start=1):
        theta[slot] = np.log(factor[row, column]) if row == column else factor[row, column]
    theta[0] = np.log(parameters[0])
    theta[DAMPING.start :] = np.log(parameters[DAMPING.start :])
    return theta


def _factor(theta: FloatArray) -> FloatArray:
    factor = np.zeros((3, 3))
    for slot, (row, column) in enumerate(_CHOLESKY_ELEMENTS, start=1):
        factor[row, column] = np.exp(theta[slot]) if row == column else theta[slot]
    return factor


def from_unconstrained(theta: FloatArray) -> FloatArray:
    """Invert `to_unconstrained`."""
    parameters = np.array(theta, dtype=float)
    factor = _factor(theta)
    moments = factor @ factor.T
    tensor = np.trace(moments) * np.eye(3) - moments
    for slot, (row, column) in enumerate(INERTIA_ELEMENTS, start=1):
        parameters[slot] = tensor[row, column]
    parameters[0] = np.exp(theta[0])
    parameters[DAMPING.start :] = np.exp(theta[DAMPING.start :])
    return parameters


def unconstrained_jacobian(theta: FloatArray) -> FloatArray:
    """Return d(physical) / d(unconstrained), (22, 22)."""
    jacobian = np.eye(COUNT)
    parameters = from_unconstrained(theta)
    jacobian[0, 0] = parameters[0]
    for index in range(DAMPING.start, COUNT):
        jacobian[index, index] = parameters[index]
    factor = _factor(theta)
    jacobian[1:7, 1:7] = 0.0
    for slot, (row, column) in enumerate(_CHOLESKY_ELEMENTS, start=1):
        change = np.zeros((3, 3))
        change[row, column] = factor[row, column] if row == column else 1.0
        moments = change @ factor.T + factor @ change.T
        tensor = np.trace(moments) * np.eye(3) - moments
        for target, (i, j) in enumerate(INERTIA_ELEMENTS, start=1):
            jacobian[target, slot] = tensor[i, j]
    return jacobian


@dataclasses.dataclass(frozen=True)
class Prior:
    """What is believed before the first sample: an order of magnitude, no more.

    Attributes:
        mass: Guess [kg].
        inertia: Guess of each principal moment [kg m^2].
        damping: Guess of translational [N s/m] and rotational [N m s/rad] damping.
        stiffness: Guess of translational [N/m] and rotational [N m/rad] stiffness.
        log_sigma: Standard deviation of the logarithms of the positive parameters.
        inertia_log_sigma: The same of the diagonal of the inertia's Cholesky factor.
        lever_sigma: Standard deviation of the lever about zero [m].
    """

    mass: float = 5.0
    inertia: float = 0.3
    damping: float = 150.0
    stiffness: float = 1500.0
    log_sigma: float = 1.5
    inertia_log_sigma: float = 1.0
    lever_sigma: float = 0.5

    def mean(self) -> FloatArray:
        """Return the prior mean (22,) in unconstrained coordinates."""
        vector = np.zeros(COUNT)
        vector[0] = self.mass
        vector[1:4] = self.inertia
        vector[DAMPING] = self.damping
        vector[STIFFNESS] = self.stiffness
        return to_unconstrained(vector)

    def sigma(self) -> FloatArray:
        """Return the prior standard deviation (22,) in unconstrained coordinates."""
        sigma = np.full(COUNT, self.log_sigma)
        sigma[1:4] = self.inertia_log_sigma
        sigma[4:7] = np.sqrt(0.5 * self.inertia)
        sigma[LEVER] = self.lever_sigma
        return sigma


@dataclasses.dataclass(frozen=True)
class Ranges:
    """The span of values that the 10-bit information metric is read on (Thesis eq. 2-12b).

    Generic for a rover of a few kilograms; wide, and not centred on any particular robot.
    """

    mass: tuple[float, float] = (0.0, 10.0)
    inertia: tuple[float, float] = (0.0, 1.0)
    product: tuple[float, float] = (-0.5, 0.5)
    lever: tuple[float, float] = (-1.0, 1.0)
    damping: tuple[float, float] = (0.0, 1000.0)
    stiffness: tuple[float, float] = (0.0, 10000.0)

    def bounds(self) -> FloatArray:
        """Return (22, 2) lower and upper ends, SI units."""
        rows = [self.mass] + [self.inertia] * 3 + [self.product] * 3 + [self.lever] * 3
        rows += [self.damping] * 6 + [self.stiffness] * 6
        return np.array(rows)


def average_error_percent(estimate: FloatArray, truth: FloatArray) -> float:
    """Return the mean of |error| / |truth| over the non-zero parameters, in percent.

    The metric that reproduces Table 2-2's averages; Table 2-1's do not follow from its rows.
    """
    used = truth != 0
    return float(100 * np.mean(np.abs(estimate - truth)[used] / np.abs(truth[used])))
