"""What it brings that an inclinometer feels acceleration, beside one that feels the tilt alone."""

from collections.abc import Sequence

import numpy as np
import scipy.signal

from controllers.identification.pitch import PitchPrior
from controllers.identification.pitch_model import PitchSensors, predict_tilt
from perception.geometry.arrays import FloatArray

_STEP = 1e-4  # Of a finite difference, as a share of the parameter.


def acceleration_gain(
    parameters: FloatArray,
    wrench: FloatArray,
    indices: Sequence[int],
    sensors: PitchSensors,
    prior: PitchPrior,
) -> FloatArray:
    """Return the deviations (5,) that a sensor of the tilt alone would leave, over the real one's.

    Both have the same low pass, noise and samples, and the wrench counts as exact.

    Args:
        parameters: (5,) parameters at which the model is linearised.
        wrench: (n, 6) deviation from rest of force and moment on the arm [N, N m].
        indices: Ticks at which the inclinometer is read.
        sensors: Sampling, place and noise of the sensors.
        prior: Prior of the parameters.
    """
    kept = np.exp(-2.0 * np.pi * sensors.tilt_bandwidth * sensors.period)

    def seen(at: FloatArray) -> FloatArray:
        tilt, _, reading = predict_tilt(at, wrench, sensors).T
        alone = scipy.signal.lfilter([1.0 - kept], [1.0, -kept], tilt)
        return np.array([alone, reading])[:, indices]

    steps = np.diag(_STEP * np.abs(parameters))
    ends = [seen(parameters + step) - seen(parameters - step) for step in steps]
    slopes = np.array(ends) / (2.0 * steps.sum(axis=1)[:, None, None] * sensors.tilt_sigma)
    logs, levers = np.abs(parameters) * prior.log_sigma, prior.lever_sigma
    before = np.where([True, False, False, True, True], logs, levers)
    left = [
        np.linalg.inv(rows @ rows.T + np.diag(before**-2.0)) for rows in np.moveaxis(slopes, 1, 0)
    ]
    alone, real = (np.sqrt(np.diag(covariance)) for covariance in left)
    return alone / real
