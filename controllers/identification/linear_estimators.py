"""The thesis' two solutions of A x = F: pseudo-inverse and recursive Kalman filter."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np
from numpy.typing import NDArray

from controllers.identification.parameters import COUNT, LEVER, Prior, from_coordinates

FloatArray = NDArray[np.float64]


def pseudo_inverse(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve A x = F in the least-squares sense, x = (A^T A)^-1 A^T F (Thesis section 2.3).

    Args:
        matrix: A, (n, 22).
        right: F, (n,).

    Returns:
        x (22,). Unobservable directions get their least-norm value.
    """
    return np.linalg.lstsq(matrix, right, rcond=None)[0].astype(np.float64)


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
    def from_prior(cls, prior: Prior) -> KalmanFilter:
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
            spread = row @ gain + variance[r]
            error = right[n, r] - row @ estimate
            estimate += gain * (error / spread)
            for i in range(22):
                for j in range(22):
                    covariance[i, j] -= gain[i] * gain[j] / spread
