"""The equations of motion as A x = F (Thesis eq. 2-1, B-4), and its solutions.

A x = F is linear in the 22 unknowns x. The thesis solves it by the pseudo-inverse and by a
recursive Kalman filter, which take A to be free of noise. `compensated` takes out what the noise
adds on average; it is where our own fit starts.
"""

import dataclasses
from collections.abc import Sequence

import numba
import numpy as np
import scipy.linalg

from controllers.identification.compliant_base import SIGNALS, ArmOnMount
from controllers.identification.parameters import (
    COUNT,
    LEVER,
    Prior,
    from_coordinates,
    inertia_tensor,
)
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from perception.geometry.se3 import cross_matrix


class MeasurementError(ValueError):
    """Measurements no estimate can be made from."""


def check_finite(outputs: FloatArray) -> None:
    """Refuse measurements that are not numbers.

    Args:
        outputs: (n, 24) measured samples.

    Raises:
        MeasurementError: Naming the signal and the first sample that is not finite.
    """
    bad = ~np.isfinite(outputs)
    if not bad.any():
        return
    sample, channel = (int(index) for index in np.argwhere(bad)[0])
    name = next(key for key, rows in SIGNALS.items() if rows.start <= channel < rows.stop)
    raise MeasurementError(
        f"{name}, component {channel % 3}, sample {sample} is {outputs[sample, channel]}; "
        "leave such samples out or check the sensor"
    )


def _hinges(angles: FloatArray, rates: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return R (n, 3, 3), E (n, 3, 3) and E_dot phi_dot (n, 3), as `compliant_base._hinges`."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles.T), np.cos(angles.T)
    zero, one = np.zeros_like(sx), np.ones_like(sx)
    rotation = np.array(
        [
            [cy * cz, -cy * sz, sy],
            [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
            [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
        ]
    )
    rate_matrix = np.array([[cy * cz, sz, zero], [-cy * sz, cz, zero], [sy, zero, one]])
    px, py, pz = rates.T
    x = (-sy * cz * py - cy * sz * pz) * px + cz * pz * py
    y = (sy * sz * py - cy * cz * pz) * px - sz * pz * py
    bias = np.stack([x, y, cy * py * px], axis=1)
    return np.moveaxis(rotation, 2, 0), np.moveaxis(rate_matrix, 2, 0), bias


def regressor(outputs: FloatArray, arm: ArmOnMount) -> tuple[FloatArray, FloatArray]:
    """Return A and F of A x = F for one mode.

    The printed equation fits neither order of the base's joints; this one is exact for slides
    outermost, in world axes, and hinges inner:
    -m a - b v - k r = R F - F0 and
    -E^T (I w' + w x I w) - [E^T (r2 x F) - r2 x F0] - b phi' - k phi = E^T N - N0.

    Args:
        outputs: (n, 24) measured deviations from rest, rows as `compliant_base.SIGNALS`.
        arm: The arm in this mode; its weight at rest is known.

    Returns:
        A (n, 6, 22) and F (n, 6).

    Raises:
        MeasurementError: If a sample is not finite.
    """
    check_finite(outputs)
    angles, rates = outputs[:, SIGNALS["angles"]], outputs[:, SIGNALS["angle_rates"]]
    rotation, rate_matrix, bias = _hinges(angles, rates)
    omega = np.einsum("nij,nj->ni", rate_matrix, rates)
    hinge_accelerations = outputs[:, SIGNALS["angle_accelerations"]]
    alpha = np.einsum("nij,nj->ni", rate_matrix, hinge_accelerations) + bias
    rest_force = np.array([0.0, 0.0, arm.mass * GRAVITY])
    rest_moment = np.cross(arm.rest_centre(), rest_force)
    force = outputs[:, SIGNALS["force"]] + rest_force
    moment = outputs[:, SIGNALS["moment"]] + rest_moment

    matrix = np.zeros((len(outputs), 6, COUNT))
    matrix[:, :3, 0] = -outputs[:, SIGNALS["acceleration"]]
    basis = np.array([inertia_tensor(row) for row in np.eye(COUNT)[1:7]])
    momentum = np.einsum("kij,nj->nik", basis, omega)
    momentum_rate = np.einsum("kij,nj->nik", basis, alpha) + cross_matrix(omega) @ momentum
    matrix[:, 3:, 1:7] = -np.einsum("nji,njk->nik", rate_matrix, momentum_rate)
    # r2 x F = -[F]x r2
    turned = np.einsum("nji,njk->nik", rate_matrix, cross_matrix(force))
    matrix[:, 3:, 7:10] = turned - cross_matrix(rest_force[None])
    diagonal = np.arange(3)
    matrix[:, diagonal, 10 + diagonal] = -outputs[:, SIGNALS["velocity"]]
    matrix[:, 3 + diagonal, 13 + diagonal] = -rates
    matrix[:, diagonal, 16 + diagonal] = -outputs[:, SIGNALS["displacement"]]
    matrix[:, 3 + diagonal, 19 + diagonal] = -angles
    right = np.empty((len(outputs), 6))
    right[:, :3] = np.einsum("nij,nj->ni", rotation, force) - rest_force
    right[:, 3:] = np.einsum("nji,nj->ni", rate_matrix, moment) - rest_moment
    return matrix, right


def pseudo_inverse(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve A x = F in the least-squares sense, x = (A^T A)^-1 A^T F (Thesis section 2.3).

    Args:
        matrix: A, (n, 22).
        right: F, (n,).

    Returns:
        x (22,). Unobservable directions get their least-norm value.
    """
    return np.linalg.lstsq(matrix, right, rcond=None)[0].astype(np.float64)


REWEIGHTINGS = 4
"""How often the equations are weighed anew by the estimate that they gave."""

BY_CHANCE = 4.0
"""Deviations of the noise's own scatter that the data must exceed to tell a direction."""


@dataclasses.dataclass(frozen=True)
class Equations:
    """Products of samples' equations [A F], and what the sensors' noise adds to them on average.

    Attributes:
        samples: Number n of the samples.
        products: (6, 6, 23, 23) products of the equations' rows i and j, summed over the samples.
        noise: (6, 6, 23, 23) mean share of the noise in them.
    """

    samples: int
    products: FloatArray
    noise: FloatArray

    @classmethod
    def of(cls, outputs: FloatArray, sigma: FloatArray, arm: ArmOnMount) -> "Equations":
        """Set up the equations of one mode's samples.

        Args:
            outputs: (n, 24) measured deviations from rest, rows as `compliant_base.SIGNALS`.
            sigma: (24,) deviations of their noise.
            arm: The arm in this mode.

        Raises:
            MeasurementError: If a sample is not finite.
        """
        count, channels = outputs.shape
        terms = _augmented(outputs, arm)
        shifted = _augmented((outputs[:, None] + np.diag(sigma)).reshape(-1, channels), arm)
        moved = shifted.reshape(count, channels, *terms.shape[1:]) - terms[:, None]
        return cls(count, _products(terms), _products(moved.reshape(shifted.shape)))

    def __add__(self, other: "Equations") -> "Equations":
        """Return the equations of both windows of one mode."""
        return Equations(
            self.samples + other.samples,
            self.products + other.products,
            self.noise + other.noise,
        )


def _augmented(outputs: FloatArray, arm: ArmOnMount) -> FloatArray:
    matrix, right = regressor(outputs, arm)
    return np.concatenate([matrix, right[:, :, None]], axis=2)


def _products(rows: FloatArray) -> FloatArray:
    return np.tensordot(rows, rows, (0, 0)).transpose(0, 2, 1, 3)


def compensated(parts: Sequence[Equations], prior: Prior) -> FloatArray:
    """Solve A x = F with the bias of the noise in A and F taken out.

    The noise adds to A^T W A and A^T W F, on average, the sums of what each channel's deviation
    alone moves them by (bias-compensated least squares). W is the inverse of the equations' joint
    covariance, which depends on x: it is found in `REWEIGHTINGS` rounds. Directions in which the
    data exceed neither the prior nor the scatter of what was taken out keep the prior's guess.

    Args:
        parts: The equations of windows of any modes, of which each mode's may be summed up.
        prior: Prior of the 22 parameters.

    Returns:
        x (22,). It need not be that of a body.
    """
    vague = KalmanFilter.from_prior(prior)
    guess, precision = vague.estimate, np.diag(1.0 / np.diag(vague.covariance))
    samples = sum(part.samples for part in parts)
    estimate = guess
    for _ in range(REWEIGHTINGS):
        square, noise = np.sum([_weighed(part, estimate) for part in parts], axis=0)
        data = square - noise
        scatter = BY_CHANCE * np.sqrt(2.0 / samples) * noise[:COUNT, :COUNT]
        values, vectors = scipy.linalg.eigh(data[:COUNT, :COUNT], precision + scatter)
        told, values = vectors[:, values > 1.0], values[values > 1.0]
        pull = data[:COUNT, COUNT] - data[:COUNT, :COUNT] @ guess
        estimate = guess + told @ (told.T @ pull / (1.0 + values))
    return estimate


def _weighed(part: Equations, estimate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return products (23, 23) and noise (23, 23), weighed by the rows' noise at `estimate`."""
    turned = np.append(estimate, -1.0)
    weight = np.linalg.inv(part.noise @ turned @ turned / part.samples)
    return np.tensordot(weight, part.products), np.tensordot(weight, part.noise)


@dataclasses.dataclass
class KalmanFilter:
    """The plain filter of Thesis fig. 2-3 on constant states; A is taken to be free of noise.

    Attributes:
        estimate: (22,).
        covariance: (22, 22). It knows nothing of the noise in A, so it is too small.
    """

    estimate: FloatArray
    covariance: FloatArray

    @classmethod
    def from_prior(cls, prior: Prior) -> "KalmanFilter":
        """Start from the same guess as every other estimator here."""
        guess = from_coordinates(prior.mean())
        sigma = np.abs(guess) * np.expm1(prior.log_sigma)
        sigma[4:7] = sigma[1:4].mean()
        sigma[LEVER] = prior.lever_sigma
        return cls(guess, np.diag(sigma**2))

    def update(self, matrix: FloatArray, right: FloatArray, sigma: FloatArray) -> None:
        """Take samples in, one after another.

        Args:
            matrix: A, (n, rows, 22).
            right: F, (n, rows).
            sigma: Standard deviation of each row of F, (rows,).

        Raises:
            ValueError: If A has not 22 columns.
        """
        if matrix.shape[-1] != COUNT:
            raise ValueError(f"matrix: expected {COUNT} columns, got {matrix.shape[-1]}")
        _update(self.estimate, self.covariance, matrix, right, sigma**2)


@numba.njit(cache=True)
def _update(estimate, covariance, matrix, right, variance):
    """Scalar updates: the rows' noise is independent, so no matrix need be inverted."""
    for n in range(matrix.shape[0]):
        for r in range(matrix.shape[1]):
            row = matrix[n, r]
            gain = covariance @ row
            innovation_variance = row @ gain + variance[r]
            error = right[n, r] - row @ estimate
            estimate += gain * (error / innovation_variance)
            for i in range(22):
                for j in range(22):
                    covariance[i, j] -= gain[i] * gain[j] / innovation_variance
