"""What is tried on one robot, what was found of it, and how far that is from the truth."""

import dataclasses

import numpy as np
from scipy.stats import chi2

from controllers.identification.any_model.fit import information_of
from experiments.own.identification import Identified, measurements
from perception.geometry.arrays import BoolArray, FloatArray

TOLD = 0.25
"""Deviation left by the information at the truth below which a parameter is to be called told."""
SURE = 0.999
"""Share of right results that lie within the bound of which a result called good may not be out."""


@dataclasses.dataclass(frozen=True)
class RobotTrial:
    """One robot to identify.

    Attributes:
        kind: Kind of robot.
        seed: Random seed of robot, sensors and random motions.
        duration: Duration of each motion [s].
        shape: Shape of the motion that was designed for its drawing.
        motions: Which motions it plays.
        peer: Whether ``mujoco.sysid`` identifies it from the first as well.
    """

    kind: str
    seed: int
    duration: float
    shape: tuple[float, ...]
    motions: tuple[str, ...]
    peer: bool


@dataclasses.dataclass(frozen=True)
class Found:
    """What one log told.

    Attributes:
        coordinates: (n,) as fitted.
        covariance: (n, n) that is stated.
        told: (n,) whether it is called told.
        plain: (n,) whether the information at the truth tells it.
        doubts: Why it is not good; empty if it is.
        hold_out: Error above the noise on the run held out, over that as drawn.
        chi_square: Squared residuals per sample over the noise's variance.
        seconds: CPU time of the identification [s].
    """

    coordinates: FloatArray
    covariance: FloatArray
    told: BoolArray
    plain: BoolArray
    doubts: tuple[str, ...]
    hold_out: float
    chi_square: float
    seconds: float

    @property
    def deviations(self) -> FloatArray:
        """(n,) that are stated."""
        return np.sqrt(np.diag(self.covariance))


@dataclasses.dataclass(frozen=True)
class RobotResult:
    """What was found of one robot.

    Attributes:
        trial: The robot.
        names: Names of its parameters, those planted last.
        planted: How many of them no motion tells.
        truth: (n,) its true coordinates.
        found: What each motion's log told.
        peer: (n - planted,) coordinates by the peer; empty if it was not asked.
        peer_seconds: CPU time of the peer [s].
    """

    trial: RobotTrial
    names: tuple[str, ...]
    planted: int
    truth: FloatArray
    found: tuple[Found, ...]
    peer: FloatArray
    peer_seconds: float

    @property
    def asked(self) -> slice:
        """Place of the parameters that are not planted."""
        return slice(0, len(self.names) - self.planted)

    def squared_error(self, found: Found) -> float:
        """Return the summed squared error, in deviations beforehand."""
        return float(np.sum((found.coordinates - self.truth)[self.asked] ** 2))

    def off(self, found: Found) -> FloatArray:
        """Return (n,) errors over stated deviations."""
        return (found.coordinates - self.truth) / found.deviations

    def false(self, found: Found) -> bool:
        """Whether a result is called good, and what it calls told lies beyond its bound."""
        off = (found.coordinates - self.truth)[found.told]
        covariance = found.covariance[np.ix_(found.told, found.told)]
        distance = float(off @ np.linalg.solve(covariance, off))
        return not found.doubts and distance > float(chi2.ppf(SURE, len(off)))


def found_in(result: Identified, truth: FloatArray, seconds: float) -> Found:
    """Return what an identification found, and close its predictors.

    Args:
        result: The identification; a run was held out.
        truth: (n,) true coordinates.
        seconds: CPU time that it took [s].
    """
    predictor = result.seen.predictor
    at_truth = information_of(predictor, measurements(predictor), truth)
    left = np.sqrt(np.diag(np.linalg.inv(at_truth + np.eye(len(truth)))))
    assert result.unseen is not None
    predictor.close()
    result.unseen.predictor.close()
    return Found(
        result.fit.coordinates,
        result.fit.covariance,
        np.array([each.told for each in result.estimates]),
        left < TOLD,
        tuple(result.doubts),
        result.unseen.ratio,
        result.fit.chi_square,
        seconds,
    )
