"""How well each parameter is known: mutual information in bits, and identifiability."""

import dataclasses
import math

import numba
import numpy as np
import scipy.linalg

from controllers.identification.output_error import Estimate
from controllers.identification.parameters import INERTIA, NAMES, Prior
from perception.geometry.arrays import FloatArray

BITS = 10
"""A 10-bit sensor is assumed (Thesis section 2.6.1)."""


def mutual_information(
    estimate: FloatArray, sigma: FloatArray, bounds: FloatArray, bits: int = BITS
) -> FloatArray:
    """Return the information of each estimate, in bits (Thesis eq. 2-8 to 2-12b).

    In = H(x) - H(x | y): all 2^bits states of the sensor are equally likely before, and follow
    the Gaussian of the estimate, cut to the range, after. An estimate outside its range counts as
    lying at its end, where eq. 2-12b would divide by zero.

    Args:
        estimate: (n,) estimates; NaN where there is none, which holds no information.
        sigma: (n,) standard deviations; NaN or infinity where nothing is known.
        bounds: (n, 2) ends of the range.
        bits: Precision of the sensor.

    Returns:
        (n,) between 0 (nothing known) and `bits`.
    """
    return np.where(np.isnan(estimate), 0.0, _information(estimate, sigma, bounds, bits))


@numba.njit(cache=True)
def _information(estimate, sigma, bounds, bits):
    count = 2**bits
    result = np.empty(estimate.shape[0])
    for n in range(estimate.shape[0]):
        low, high = bounds[n, 0], bounds[n, 1]
        width = (high - low) / count
        mean = min(max(estimate[n], low), high)
        # A thousand ranges are as good as infinity, which NaN means too.
        deviation = 1e3 * (high - low)
        if sigma[n] < deviation:
            deviation = max(sigma[n], 1e-12 * (high - low))
        scale = 1.0 / (math.sqrt(2.0) * deviation)
        # Beyond eight sigma a bin holds nothing that counts.
        first = max(0, int((mean - 8 * deviation - low) / width))
        last = min(count, int((mean + 8 * deviation - low) / width) + 1)
        total = 0.5 * (math.erf((high - mean) * scale) - math.erf((low - mean) * scale))
        uncertainty = 0.0
        below = math.erf((low + first * width - mean) * scale)
        for i in range(first, last):
            above = math.erf((low + (i + 1) * width - mean) * scale)
            q = 0.5 * (above - below) / total
            if q > 0:
                uncertainty -= q * math.log2(q)
            below = above
        result[n] = bits - uncertainty
    return result


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """Parameters and directions that the data leave unknown.

    Attributes:
        unidentifiable: Names of the parameters that the data hardly determine.
        directions: The combinations that stay unknown, as name -> weight in prior deviations,
            largest weights first.
    """

    unidentifiable: tuple[str, ...]
    directions: tuple[dict[str, float], ...]


def identifiability(
    estimate: Estimate, prior: Prior | None = None, shrinkage: float = 0.5
) -> Identifiability:
    """Return the names of what a fit could not determine.

    A parameter counts as unidentifiable when its deviation stayed above `shrinkage` of the
    prior's, and a direction likewise. The prior is taken where the estimate lies, and the
    inertia's for a given mass: its deviation falls with the body's size and with what is known of
    the mass, neither of which is information on the inertia.

    Args:
        estimate: A fit.
        prior: The prior that it was made with.
        shrinkage: Ratio of posterior to prior deviation.
    """
    _, _, precision = (prior or Prior()).term(estimate.theta)
    sigma = np.sqrt(np.diag(np.linalg.inv(precision)))
    sigma[INERTIA] = np.sqrt(np.diag(np.linalg.inv(precision[INERTIA, INERTIA])))
    posterior = np.sqrt(np.diag(np.linalg.inv(estimate.information)))
    names = tuple(NAMES[i] for i in np.flatnonzero(posterior > shrinkage * sigma))
    values, vectors = scipy.linalg.eigh(estimate.information, precision)
    directions = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value * shrinkage**2 > 1:
            break
        weights = vector / sigma
        weights /= np.linalg.norm(weights)
        kept = [i for i in np.argsort(-np.abs(weights)) if abs(weights[i]) > 0.2]
        directions.append({NAMES[i]: float(weights[i]) for i in kept})
    return Identifiability(names, tuple(directions))
