"""Analogue inputs, inclinometer and force/torque sensor: conversion of counts and SI units."""

import dataclasses
import functools
import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray, IntArray
from twin.hardware.calibration.section import Section, read_only, require, require_positive

ANALOGUE_PINS: Final = 16
"""Largest number of analogue inputs of a board."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AngleSensor:
    """A sensor whose voltage rises linearly with an angle (Thesis eq. D-1).

    Attributes:
        pin: Analogue input of the board.
        zero_volts: Output at angle zero [V].
        volts_per_radian: Slope [V/rad]; negative if the sensor is mounted reversed.
    """

    pin: int
    zero_volts: float
    volts_per_radian: float

    def __post_init__(self) -> None:
        """Reject an impossible input, offset or slope.

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
    """Analogue board and potentiometer of the rover's centre joint.

    Attributes:
        bits: Resolution of the converter [bits].
        reference: Full-scale voltage of the converter [V].
        centre: Potentiometer of the centre joint.
    """

    bits: int
    reference: float
    centre: AngleSensor

    def __post_init__(self) -> None:
        """Reject an impossible converter.

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
        """Return the converter codes (...) nearest to voltages (...) [V], saturated.

        The largest code is one count below the reference, as for converters that output
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
    """Roll and pitch axes of the inclinometer (Thesis Table D-1)."""

    roll: AngleSensor
    pitch: AngleSensor


@dataclasses.dataclass(frozen=True, kw_only=True)
class ForceTorqueCalibration(Section):
    """Force/torque sensor under the arm; its origin is that of the arm base frame.

    Attributes:
        counts_per_newton: Counts of each of the three force components [1/N].
        counts_per_newton_metre: Counts of each of the three torque components [1/(N m)].
        direction: -1 for a sensor that reports the load on its face, the convention of the
            manufacturers; 1 for one that reports the reaction to it, as the robot contract does.
        rotation: (3, 3) rows of the rotation from the sensor's frame to the arm base frame.
        bias: (6,) reading without load, sensor frame [N, N m].
    """

    counts_per_newton: float
    counts_per_newton_metre: float
    direction: int
    rotation: tuple[tuple[float, float, float], ...]
    bias: tuple[float, float, float, float, float, float]

    def __post_init__(self) -> None:
        """Reject impossible constants or a rotation that is not proper.

        Raises:
            CalibrationError: Naming the key and its value.
        """
        require_positive("counts_per_newton", self.counts_per_newton, "counts/N")
        require_positive("counts_per_newton_metre", self.counts_per_newton_metre, "counts/(N m)")
        require(self.direction in (-1, 1), "direction", self.direction, "1 or -1")
        square = len(self.rotation) == 3 and all(len(row) == 3 for row in self.rotation)
        require(square, "rotation", self.rotation, "three rows of three numbers")
        matrix = np.array(self.rotation)
        with np.errstate(over="ignore", invalid="ignore"):
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
        """(6, 6) transform of wrenches from the sensor frame to the arm base frame."""
        return read_only(self.direction * np.kron(np.eye(2), np.array(self.rotation)))

    def wrench(self, counts: ArrayLike) -> FloatArray:
        """Return wrenches (..., 6) of counts (..., 6).

        Returns:
            Forces and moments of the rover on the arm, arm base frame [N, N m].
        """
        sensed = np.asarray(counts, dtype=float) / self._scale - np.array(self.bias)
        return sensed @ self._turn.T

    def counts(self, wrench: ArrayLike) -> IntArray:
        """Return the counts (..., 6) nearest to wrenches (..., 6), the inverse of `wrench`.

        Counts are sent as 32-bit integers, to which they saturate.
        """
        sensed = np.asarray(wrench, dtype=float) @ self._turn + np.array(self.bias)
        counts = np.rint(sensed * self._scale)
        return np.clip(counts, -(2.0**31), 2.0**31 - 1).astype(np.int64)
