"""How a rover on its suspension pitches under its arm, and what its inclinometer shows of it.

The physical rover has an inclinometer and a force/torque sensor, no more. So the pitch row of
eq. 2-1 is simulated, driven by the measured wrench: I tilt'' + b tilt' + k tilt = -(N_x + ry F_z -
rz F_y). On wheels that neither slip nor roll a base does not pitch about its centre of gravity but
about a line near the ground: the inertia is about that line, and (ry, rz) leads from it to the arm.

Two things go beyond that equation. An inclinometer's masses feel the specific force along the base,
g tilt - h tilt'' at a height h above the line, through a low pass: at 10 Hz and 0.1 m the second
term is forty times the first. And uneven ground makes the wheels turn a little as the body pitches,
against the dry friction of their gears, which looks like damping that falls with the amplitude.
"""

import dataclasses
from typing import NamedTuple

import numba
import numpy as np
import scipy.ndimage

from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

_NEAR = 1.0  # Width over which the wrench's power is averaged [Hz].
_CREEP = 0.03  # Rate of pitching from which dry friction is whole [rad/s].
# State of the base and its inclinometer, then the moment on the base in a period.
_TILT, _RATE, _READING, _MOMENT = range(4)
# Deviations of the state where nothing is known of the motion [rad, rad/s, rad].
_UNKNOWN = np.array([0.03, 2.0, 0.1])


@dataclasses.dataclass(frozen=True)
class PitchSensors:
    """Sampling, place and noise of the sensors of the pitch identification.

    Attributes:
        period: Sampling period of the wrench, of which each sample is the mean [s].
        wrench_age: Age of a wrench sample beyond that of a tilt sample of the same tick, from the
            middle of its period [s].
        force_sigma: Standard deviation of the forces' noise [N].
        torque_sigma: Standard deviation of the moments' noise [N m].
        wrench_scale_sigma: Standard deviation of the wrench's scale from its calibration [share].
        tilt_bandwidth: First-order pole of the inclinometer [Hz].
        tilt_sigma: Standard deviation of the inclinometer's noise [rad].
        tilt_period: Time between its samples [s].
        tilt_range: Apparent tilt beyond which its masses stop [rad].
        tilt_height: Height of the inclinometer over the arm's force/torque sensor [m].
    """

    period: float = 0.01
    wrench_age: float = 0.0045
    force_sigma: float = 0.1
    torque_sigma: float = 0.01
    wrench_scale_sigma: float = 0.006
    tilt_bandwidth: float = 6.0
    tilt_sigma: float = np.deg2rad(0.05)
    tilt_period: float = 0.04
    tilt_range: float = np.deg2rad(20.0)
    tilt_height: float = -0.036


class Nuisance(NamedTuple):
    """What the inclinometer shows depends on, beside the five parameters.

    Attributes:
        zero: Reading at rest beyond its tare [rad].
        friction: Dry friction of the pitching [N m].
        mounting: Height of the inclinometer beyond the drawing's [m].
        scale: Scale of the inclinometer beyond its calibration's [share].
    """

    zero: float = 0.0
    friction: float = 0.0
    mounting: float = 0.0
    scale: float = 0.0


CALIBRATED = Nuisance()
"""No dry friction, and an inclinometer as drawn and calibrated."""


@dataclasses.dataclass(frozen=True)
class PitchModel:
    """The base and its inclinometer over one period of the wrench, which holds meanwhile.

    A motor's duty holds for a period, and the arm's pull nearly does: drawn straight from mean to
    mean instead, it is off by half as much again.

    Attributes:
        step: (3, 4) what the state after the period is made of: tilt, its rate and the filtered
            reading before it, and the moment.
        shown: (3, 4) what tilt, apparent tilt and reading are made of when the inclinometer is
            read.
        lead: Number of samples by which the wrench lags the tilt of the same tick.
        levers: (2,) forward and up, from the line that the base pitches about to the arm [m].
        friction: Dry friction of the pitching [N m].
    """

    step: FloatArray
    shown: FloatArray
    lead: int
    levers: tuple[float, float]
    friction: float

    @classmethod
    def of(
        cls, parameters: FloatArray, sensors: PitchSensors, nuisance: Nuisance = CALIBRATED
    ) -> "PitchModel":
        """Return the model of a base.

        Args:
            parameters: (5,) inertia, lever forward and up, damping and stiffness of the pitching.
            sensors: Sampling and place of the sensors.
            nuisance: What else the reading depends on.
        """
        inertia, ry, rz, damping, stiffness = parameters
        turn = np.array([-stiffness, -damping, 0.0, 1.0]) / inertia
        height = rz + sensors.tilt_height + nuisance.mounting
        apparent = np.eye(4)[_TILT] - height / GRAVITY * turn
        pole = 2 * np.pi * sensors.tilt_bandwidth
        dynamics = np.zeros((4, 4))
        dynamics[_TILT, _RATE], dynamics[_RATE] = 1.0, turn
        dynamics[_READING] = pole * ((1.0 + nuisance.scale) * apparent - np.eye(4)[_READING])
        lead, part = divmod(sensors.wrench_age + sensors.period / 2, sensors.period)
        step, until = exponential(dynamics * sensors.period), exponential(dynamics * part)
        shown = np.array([until[_TILT], apparent @ until, until[_READING]])
        return cls(step[:_MOMENT], shown, int(lead), (float(ry), float(rz)), nuisance.friction)

    def moment(self, wrench: FloatArray) -> FloatArray:
        """Return the pitching moment (n,) on the base in every period of a wrench (n, 6)."""
        ry, rz = self.levers
        return -(wrench[:, 3] + ry * wrench[:, 2] - rz * wrench[:, 1])

    def moment_variance(self, sensors: PitchSensors) -> float:
        """Return the variance of the noise of the moment [N^2 m^2]."""
        ry, rz = self.levers
        return sensors.torque_sigma**2 + (ry**2 + rz**2) * sensors.force_sigma**2


@numba.njit(cache=True)
def exponential(matrix):
    """Return the exponential of a small matrix (n, n): a series, scaled and squared.

    SciPy's checks of its arguments take twenty times as long, and a fit asks thousands of times.
    """
    squarings, norm = 0, np.abs(matrix).sum(axis=1).max()
    while 0.25 < norm < np.inf:
        squarings, norm = squarings + 1, 0.5 * norm
    scaled = matrix / 2.0**squarings
    power = np.eye(matrix.shape[0])
    result = power.copy()
    for k in range(1, 14):  # 0.25^14 / 14! is below what a number of 64 bits holds beside 1.
        power = power @ scaled / k
        result += power
    for _ in range(squarings):
        result = result @ result
    return result


def smoothed(wrench: FloatArray, sensors: PitchSensors) -> FloatArray:
    """Return the wrench with its noise shrunk, frequency by frequency (Wiener filter).

    A fit is driven by the measured wrench: at frequencies that hold more noise than motion it would
    explain the noise by heavier and stiffer bodies (errors in variables).

    Args:
        wrench: (n, 6) deviation from rest of force and moment on the arm.
        sensors: Its sampling and noise.
    """
    count = len(wrench)
    spectrum = np.fft.rfft(np.concatenate([wrench, wrench[::-1]]), axis=0)
    near = max(3, round(2 * count * sensors.period * _NEAR))
    power = scipy.ndimage.uniform_filter1d(np.abs(spectrum) ** 2, near, axis=0)
    sigma = np.repeat([sensors.force_sigma, sensors.torque_sigma], 3)
    kept = np.maximum(1.0 - 2 * count * sigma**2 / np.maximum(power, 1e-30), 0.0)
    return np.fft.irfft(spectrum * kept, 2 * count, axis=0)[:count].astype(np.float64)


def predict_tilt(
    parameters: FloatArray,
    wrench: FloatArray,
    sensors: PitchSensors,
    nuisance: Nuisance = CALIBRATED,
) -> FloatArray:
    """Return how the base tilts while the arm pulls, from rest, and what is read of it.

    Exact for a wrench that holds over each sample's period, but for the dry friction.

    Args:
        parameters: (5,) as for `PitchModel.of`.
        wrench: (n, 6) deviation from rest of force and moment on the arm, arm-base frame.
        sensors: Sampling and place of the sensors.
        nuisance: What else the reading depends on.

    Returns:
        (n, 3) deviations from rest of the tilt, of the apparent tilt in the specific force, and of
        the reading, when the inclinometer is sampled at each tick [rad].
    """
    model = PitchModel.of(parameters, sensors, nuisance)
    moment = model.moment(wrench)
    found = _march(model.step, model.shown, moment - dry_moment(model.step, moment, model.friction))
    found[:, 2] += nuisance.zero
    return found[np.minimum(np.arange(len(wrench)) + model.lead, len(wrench) - 1)]


@numba.njit(cache=True)
def dry_moment(step, moment, friction):
    """Return the moment of the dry friction in each period (n,), while the base is driven.

    Args:
        step: (3, 4) transition, see `PitchModel`.
        moment: (n,) moment that drives it in each period.
        friction: Dry friction [N m].
    """
    held = np.zeros(moment.shape[0])
    tilt, rate = 0.0, 0.0
    for n in range(moment.shape[0] if friction != 0.0 else 0):
        ahead = step[_RATE, _TILT] * tilt + step[_RATE, _RATE] * rate
        middle = 0.5 * (rate + ahead + step[_RATE, _MOMENT] * moment[n])
        held[n] = friction * np.tanh(middle / _CREEP)
        left = moment[n] - held[n]
        tilt = step[_TILT, _TILT] * tilt + step[_TILT, _RATE] * rate + step[_TILT, _MOMENT] * left
        rate = ahead + step[_RATE, _MOMENT] * left
    return held


@numba.njit(cache=True)
def _march(step, shown, moment):
    """Return what is seen in each period (n, 3)."""
    found, state = np.zeros((moment.shape[0], 3)), np.zeros(4)
    for n in range(moment.shape[0]):
        state[_MOMENT] = moment[n]
        found[n] = shown @ state
        state[:_MOMENT] = step @ state
    return found


@numba.njit(cache=True)
def kalman_gains(step, reading, indices, lost, moment_variance, tilt_variance):
    """Return the gains (m, 4) of the state by each reading, and the readings' deviations (m,).

    The state are the model's three, and the error of the moment in the present period.

    Args:
        step: (3, 4) transition, see `PitchModel`.
        reading: (4,) what a reading is made of.
        indices: (m,) periods in which the inclinometer is read.
        lost: (m,) whether the motion is unknown before a reading.
        moment_variance: (n,) variance of the moment in every period.
        tilt_variance: Variance of a reading.
    """
    size = _MOMENT + 1
    gains, deviations = np.zeros((indices.shape[0], size)), np.ones(indices.shape[0])
    covariance, moved, gain = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size)
    k = 0
    for n in range(moment_variance.shape[0]):
        covariance[_MOMENT, _MOMENT] = moment_variance[n]
        if k < indices.shape[0] and n == indices[k]:
            if lost[k]:
                covariance[:_MOMENT], covariance[:, :_MOMENT] = 0.0, 0.0
                for i in range(_MOMENT):
                    covariance[i, i] = _UNKNOWN[i] ** 2
            variance = tilt_variance
            for i in range(size):
                gain[i] = 0.0
                for j in range(size):
                    gain[i] += covariance[i, j] * reading[j]
                variance += gain[i] * reading[i]
            for i in range(size):
                gains[k, i] = gain[i] / variance
                for j in range(size):
                    covariance[i, j] -= gain[i] * gain[j] / variance
            deviations[k] = np.sqrt(variance)
            k += 1
        for i in range(_MOMENT):
            for j in range(size):
                moved[i, j] = 0.0
                for m in range(size):
                    moved[i, j] += step[i, m] * covariance[m, j]
        covariance[:] = 0.0
        for i in range(_MOMENT):
            for j in range(_MOMENT):
                for m in range(size):
                    covariance[i, j] += moved[i, m] * step[j, m]
    return gains, deviations


@numba.njit(cache=True)
def prediction_errors(step, reading, moment, indices, tilt, gains):
    """Return what each reading differs by from the prediction by all before it (m,).

    Args:
        step: (3, 4) transition, see `PitchModel`.
        reading: (4,) what a reading is made of.
        moment: (n,) moment in each period.
        indices: (m,) periods in which the inclinometer is read.
        tilt: (m,) readings.
        gains: (m, 4) gains, see `kalman_gains`.
    """
    errors, state, after = np.zeros(indices.shape[0]), np.zeros(4), np.zeros(3)
    k = 0
    for n in range(moment.shape[0]):
        state[_MOMENT] = moment[n]
        if k < indices.shape[0] and n == indices[k]:
            errors[k] = tilt[k]
            for i in range(4):
                errors[k] -= reading[i] * state[i]
            for i in range(4):
                state[i] += gains[k, i] * errors[k]
            k += 1
        for i in range(3):
            after[i] = 0.0
            for j in range(4):
                after[i] += step[i, j] * state[j]
        state[:_MOMENT] = after
    return errors
