"""Analogue inputs, inclinometer and force/torque sensor: counts into SI units and back."""

import dataclasses
import functools
import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray, IntArray
from twin.hardware.calibration.section import Section, read_only, require, require_positive

ANALOGUE_PINS: Final = 16
"""Analogue inputs that an analogue board may have."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AngleSensor:
    """A sensor whose voltage rises linearly with an angle (Thesis eq. D-1).

    Attributes:
        pin: Analogue input of the board.
        zero_volts: Output at angle zero [V].
        volts_per_radian: Slope, negative where the sensor is mounted the other way round [V/rad].
    """

    pin: int
    zero_volts: float
    volts_per_radian: float

    def __post_init__(self) -> None:
        """Refuse a sensor that says nothing.

        Raises:
            CalibrationError: Naming the key and its value.
        """
        require(0 <= self.pin < ANALOGUE_PINS, "pin", self.pin, f"0 to {ANALOGUE_PINS - 1}")
        require(math.isfinite(self.zero_volts), "zero_volts", self.zero_volts, "finite volts")
        slope = self.volts_per_radian
        require(math.isfinite(slope) and slope != 0.0, "volts_per_radian", slope, "finite, not 0")

    def angle(self, volts: ArrayLike) -> FloatArray:
        """Return angles (...) [rad] of voltages (...) [V] (Thesis eq. D-1)."""
        return (np.asarray(volts, dtype=float) - self.zero_volts) / self.volts_per_radian

    def volts(self, angle: ArrayLike) -> FloatArray:
        """Return voltages (...) [V] of angles (...) [rad]."""
        return np.asarray(angle, dtype=float) * self.volts_per_radian + self.zero_volts


@dataclasses.dataclass(frozen=True, kw_only=True)
class AnalogueCalibration(Section):
    """The analogue board and the potentiometer in the rover's centre.

    Attributes:
        bits: Resolution of its converter.
        reference: Voltage of a full scale [V].
        centre: The potentiometer.
    """

    bits: int
    reference: float
    centre: AngleSensor

    def __post_init__(self) -> None:
        """Refuse an impossible converter.

        Raises:
            CalibrationError: Naming the key and its value.
        """
        require(1 <= self.bits <= 16, "bits", self.bits, "1 to 16")
        require_positive("reference", self.reference, "V")

    @property
    def step(self) -> float:
        """Voltage of one count [V]."""
        return self.reference / 2**self.bits

    def volts(self, codes: ArrayLike) -> FloatArray:
        """Return voltages (...) [V] of converter codes (...)."""
        return np.asarray(codes, dtype=float) * self.step

    def codes(self, volts: ArrayLike) -> IntArray:
        """Return the converter codes (...) nearest to voltages (...) [V], within its range.

        The last code is one count below the reference, as in converters that give
        V 2^bits / reference.

        Raises:
            ValueError: If a voltage is NaN.
        """
        values = np.asarray(volts, dtype=float)
        if np.any(np.isnan(values)):
            raise ValueError("a NaN voltage has no converter code")
        scaled = np.rint(np.clip(values, 0.0, self.reference) / self.step)
        return np.minimum(scaled, 2**self.bits - 1).astype(np.int64)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TiltCalibration(Section):
    """The two axes of the inclinometer (Thesis Table D-1)."""

    roll: AngleSensor
    pitch: AngleSensor


@dataclasses.dataclass(frozen=True, kw_only=True)
class ForceTorqueCalibration(Section):
    """The force/torque sensor under the arm; its origin is the arm base frame's.

    Attributes:
        counts_per_newton: Counts of each of the three force components [1/N].
        counts_per_newton_metre: Counts of each of the three torque components [1/(N m)].
        direction: -1 for a sensor that reports the load on its face, the makers' convention; 1 for
            one that reports the reaction to the load, the convention of the contract.
        rotation: (3, 3) rows of the rotation from the sensor's frame to the arm base frame.
        bias: (6,) reading without load, sensor frame [N, N m].
    """

    counts_per_newton: float
    counts_per_newton_metre: float
    direction: int
    rotation: tuple[tuple[float, float, float], ...]
    bias: tuple[float, float, float, float, float, float]

    def __post_init__(self) -> None:
        """Refuse what is no mounted sensor.

        Raises:
            CalibrationError: Naming the key and its value.
        """
        require_positive("counts_per_newton", self.counts_per_newton, "counts/N")
        require_positive("counts_per_newton_metre", self.counts_per_newton_metre, "counts/(N m)")
        require(self.direction in (-1, 1), "direction", self.direction, "1 or -1")
        square = len(self.rotation) == 3 and all(len(row) == 3 for row in self.rotation)
        require(square, "rotation", self.rotation, "three rows of three numbers")
        matrix = np.array(self.rotation)
        proper = np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=1e-6)
        proper = proper and np.linalg.det(matrix) > 0.0
        require(bool(proper), "rotation", self.rotation, "a right-handed rotation matrix")
        finite = len(self.bias) == 6 and all(math.isfinite(value) for value in self.bias)
        require(finite, "bias", self.bias, "six finite numbers")

    @functools.cached_property
    def _scale(self) -> FloatArray:
        return read_only([self.counts_per_newton] * 3 + [self.counts_per_newton_metre] * 3)

    @functools.cached_property
    def _turn(self) -> FloatArray:
        """(6, 6) sensor frame to arm base frame."""
        return read_only(self.direction * np.kron(np.eye(2), np.array(self.rotation)))

    def wrench(self, counts: ArrayLike) -> FloatArray:
        """Return forces and moments (..., 6) of counts (..., 6).

        Returns:
            By the rover on the arm, arm base frame [N, N m].
        """
        sensed = np.asarray(counts, dtype=float) / self._scale - np.array(self.bias)
        return sensed @ self._turn.T

    def counts(self, wrench: ArrayLike) -> IntArray:
        """Return the counts (..., 6) nearest to a wrench (..., 6) as `wrench` returns it.

        Counts are 32-bit numbers on the wire; the sensor saturates there.
        """
        sensed = np.asarray(wrench, dtype=float) @ self._turn + np.array(self.bias)
        counts = np.rint(sensed * self._scale)
        return np.clip(counts, -(2.0**31), 2.0**31 - 1).astype(np.int64)
