"""Inclinometer constants from weighings, with the force/torque sensor as tilt reference.

At each tilt the force/torque sensor is zeroed, a weight is hung on the arm, and the direction of
the added force is the vertical (Thesis app. D). A line through the voltages over the tilts gives
the zero angle voltage and the sensitivity of eq. D-1. Two tilts suffice, as in the thesis; more are
fitted by least squares.

The weight also tilts the robot slightly on its springs (the sag). The arm's own weight, which was
zeroed at the old tilt only, turns with it and rotates the added force by W_arm / W_added times the
sag. Since the sag is proportional to W_added, a heavier weight does not help: the error is 0.6
degrees for the rover with its arm ahead. The inclinometer measures the sag, so it is corrected.

Tilts are pitch and roll as in `twin.robot.Observation`. The reference is the force/torque sensor's
frame: a misalignment between the two sensors becomes part of the zero angle voltages.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray

_SAG_ROUNDS = 4


@dataclasses.dataclass(frozen=True)
class Sample:
    """Mean readings of a robot at rest, and their standard errors.

    Attributes:
        volts: (2,) outputs of the inclinometer's pitch and roll axes [V].
        volts_error: (2,) standard errors [V].
        force: (3,) force of the rover on the arm, arm base frame [N].
        force_error: (3,) standard errors [N].
    """

    volts: FloatArray
    volts_error: FloatArray
    force: FloatArray
    force_error: FloatArray


@dataclasses.dataclass(frozen=True)
class Weighing:
    """Samples at one tilt, before and after the weight was hung on the arm."""

    before: Sample
    after: Sample

    @property
    def added(self) -> FloatArray:
        """(3,) force added by the weight, arm base frame [N]."""
        return self.after.force - self.before.force


@dataclasses.dataclass(frozen=True)
class TiltLine:
    """Constants of one inclinometer axis (Thesis eq. D-1).

    Attributes:
        zero_volts: Output at angle zero [V].
        volts_per_radian: Slope [V/rad].
        zero_error: Standard error of `zero_volts` [V]; NaN from two readings.
        slope_error: Standard error of `volts_per_radian` [V/rad]; NaN from two readings.
        residual: Root mean square residual of the readings [V].
    """

    zero_volts: float
    volts_per_radian: float
    zero_error: float
    slope_error: float
    residual: float


def sample(volts: ArrayLike, force: ArrayLike) -> Sample:
    """Return means and standard errors of independent readings.

    Args:
        volts: (n, 2) pitch and roll outputs [V], n at least 2.
        force: (m, 3) forces [N], m at least 2.
    """
    outputs, forces = np.asarray(volts, dtype=float), np.asarray(force, dtype=float)
    return Sample(
        outputs.mean(axis=0), _standard_error(outputs), forces.mean(axis=0), _standard_error(forces)
    )


def tilt_of_up(up: ArrayLike) -> FloatArray:
    """Return pitch and roll (..., 2) [rad] from the vertical ``up`` (..., 3) in the body frame."""
    x, y, z = np.moveaxis(np.asarray(up, dtype=float), -1, 0)
    pitch = np.arctan2(y, np.hypot(x, z))
    return np.stack([pitch, np.arctan2(-x, z)], axis=-1)


def up_of_tilt(tilt: ArrayLike) -> FloatArray:
    """Return the unit vertical (..., 3) in the body frame at pitch and roll (..., 2) [rad]."""
    pitch, roll = np.moveaxis(np.asarray(tilt, dtype=float), -1, 0)
    across = np.cos(pitch)
    return np.stack([-np.sin(roll) * across, np.sin(pitch), np.cos(roll) * across], axis=-1)


def weighed_tilts(
    weighings: Sequence[Weighing], volts_per_radian: ArrayLike | None, arm_weight: float
) -> FloatArray:
    """Return pitch and roll (n, 2) [rad] of the loaded robot, from the forces.

    Args:
        weighings: Weighings at n tilts.
        volts_per_radian: (2,) approximate slopes of the pitch and roll axes that correct the sag
            [V/rad]; None uses the added force as the vertical, as the thesis does.
        arm_weight: Weight carried by the force/torque sensor [N].
    """
    added = np.array([weighing.added for weighing in weighings])
    up = _unit(added)
    if volts_per_radian is None:
        return tilt_of_up(up)
    rise = np.array([each.after.volts - each.before.volts for each in weighings])
    sag = rise / np.asarray(volts_per_radian, dtype=float)
    for _ in range(_SAG_ROUNDS):
        before = up_of_tilt(tilt_of_up(up) - sag)
        up = _unit(added - arm_weight * (up - before))
    return tilt_of_up(up)


def two_point_line(tilts: ArrayLike, volts: ArrayLike) -> TiltLine:
    """Return the line through the two outermost of n readings, as the thesis does.

    Args:
        tilts: (n,) tilts about one axis [rad].
        volts: (n,) outputs of that axis [V].

    Raises:
        ValueError: If all tilts are the same.
    """
    angles, outputs = np.asarray(tilts, dtype=float), np.asarray(volts, dtype=float)
    low, high = int(np.argmin(angles)), int(np.argmax(angles))
    span = _span(angles)
    slope = float(outputs[high] - outputs[low]) / span
    zero = float(outputs[low]) - slope * float(angles[low])
    return TiltLine(zero, slope, math.nan, math.nan, _residual(angles, outputs, zero, slope))


def fitted_line(tilts: ArrayLike, volts: ArrayLike) -> TiltLine:
    """Return the least-squares line through n readings, with standard errors.

    Args:
        tilts: (n,) tilts about one axis [rad].
        volts: (n,) outputs of that axis [V].

    Raises:
        ValueError: If all tilts are the same.
    """
    angles, outputs = np.asarray(tilts, dtype=float), np.asarray(volts, dtype=float)
    _span(angles)
    count, middle = angles.size, float(angles.mean())
    squares = float(np.sum((angles - middle) ** 2))
    slope = float(np.sum((angles - middle) * outputs)) / squares
    zero = float(outputs.mean()) - slope * middle
    residual = _residual(angles, outputs, zero, slope)
    scatter = residual * math.sqrt(count / (count - 2)) if count > 2 else math.nan
    slope_error = scatter / math.sqrt(squares)
    zero_error = scatter * math.sqrt(1.0 / count + middle**2 / squares)
    return TiltLine(zero, slope, zero_error, slope_error, residual)


def fit_tilt(
    weighings: Sequence[Weighing],
    arm_weight: float,
    *,
    two_point: bool = False,
    without_sag: bool = True,
) -> tuple[TiltLine, TiltLine]:
    """Return the constants of the pitch and the roll axis.

    Args:
        weighings: Weighings at different tilts; each is used for both axes.
        arm_weight: Weight carried by the force/torque sensor [N].
        two_point: Whether to use only the two outermost tilts of each axis.
        without_sag: Whether to correct the sag under the weight.

    Raises:
        ValueError: If the tilts of an axis are all the same.
    """
    line = two_point_line if two_point else fitted_line
    volts = np.array([weighing.after.volts for weighing in weighings])
    tilts = weighed_tilts(weighings, None, arm_weight)
    pitch, roll = (line(tilts[:, axis], volts[:, axis]) for axis in (0, 1))
    # The sag is small: slopes that it biases by a few percent suffice to correct it.
    for _ in range(_SAG_ROUNDS if without_sag else 0):
        slopes = (pitch.volts_per_radian, roll.volts_per_radian)
        tilts = weighed_tilts(weighings, slopes, arm_weight)
        pitch, roll = (line(tilts[:, axis], volts[:, axis]) for axis in (0, 1))
    return pitch, roll


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _span(angles: FloatArray) -> float:
    span = float(np.ptp(angles))
    if not span > 0.0:
        raise ValueError("a line needs readings at two different tilts")
    return span


def _residual(angles: FloatArray, outputs: FloatArray, zero: float, slope: float) -> float:
    return float(np.sqrt(np.mean((outputs - zero - slope * angles) ** 2)))


def _standard_error(values: FloatArray) -> FloatArray:
    return values.std(axis=0, ddof=1) / math.sqrt(values.shape[0])
