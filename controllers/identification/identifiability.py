"""What a fit could not determine, by name."""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.linalg

from controllers.identification.output_error import Estimate
from controllers.identification.parameters import INERTIA, NAMES, Prior


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """What the data say and what they do not.

    Attributes:
        unidentifiable: Names of the parameters of which the data say little.
        directions: The combinations that stay unknown, as name -> weight in prior deviations,
            largest weights first.
    """

    unidentifiable: tuple[str, ...]
    directions: tuple[dict[str, float], ...]


def identifiability(
    estimate: Estimate, prior: Prior | None = None, shrinkage: float = 0.5
) -> Identifiability:
    """Say by name what a fit could not determine.

    A parameter counts as unidentifiable when its deviation stayed above `shrinkage` of the
    prior's, and a direction likewise. The prior is taken where the estimate lies, and the
    inertia's for a given mass: its deviation falls with the body's size and with what is known of
    the mass, neither of which the data say of the inertia.

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
