"""Motors and encoders: conversion between counts and duty codes of the boards and SI units."""

import dataclasses
import functools
import math
from typing import Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.geometry.arrays import FloatArray, IntArray
from twin.hardware.calibration.section import (
    CalibrationError,
    Section,
    read_only,
    require,
    require_positive,
)
from twin.hardware.roboclaw.codec import FULL_DUTY
from twin.robot import ARM_JOINTS, AXES

Number = TypeVar("Number", np.int64, np.float64)

ADDRESSES: Final = (0x80, 0x81, 0x82, 0x83)
"""Valid addresses of the motor boards on the bus."""
START: Final = 2**30
"""Counts at angle zero: no shaft comes from here to the 0 of a reset board within a cycle."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AxisCalibration:
    """One motor with its encoder, at one channel of one motor board.

    Attributes:
        address: Address of the board, one of `ADDRESSES`.
        channel: Channel of the board, 1 or 2.
        direction: 1 if positive duty and rising counts mean the positive direction of the robot
            contract (forward for wheels), -1 if they mean the negative one.
        counts_per_turn: Encoder counts in one turn of the output shaft.
        current_limit: Largest motor current [A].
    """

    address: int
    channel: int
    direction: int
    counts_per_turn: float
    current_limit: float

    def __post_init__(self) -> None:
        """Reject impossible addresses, channels and constants.

        Raises:
            CalibrationError: Naming the key and its value.
        """
        require(self.address in ADDRESSES, "address", self.address, "128, 129, 130 or 131")
        require(self.channel in (1, 2), "channel", self.channel, "1 or 2")
        require(self.direction in (-1, 1), "direction", self.direction, "1 or -1")
        require_positive("counts_per_turn", self.counts_per_turn, "counts")
        require_positive("current_limit", self.current_limit, "A")


@dataclasses.dataclass(frozen=True, kw_only=True)
class JointCalibration(AxisCalibration):
    """A motor that moves an arm joint.

    Attributes:
        lower: Lower joint limit [rad].
        upper: Upper joint limit [rad].
    """

    lower: float
    upper: float

    def __post_init__(self) -> None:
        """Reject impossible motor constants or joint limits.

        Raises:
            CalibrationError: Naming the key and its value.
        """
        super().__post_init__()
        require(
            math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper,
            "lower and upper",
            (self.lower, self.upper),
            "finite angles [rad], lower below upper",
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class DriveCalibration(Section):
    """The eight motors on their boards; arrays are in the order of `AXES`."""

    front_left: AxisCalibration
    front_right: AxisCalibration
    rear_left: AxisCalibration
    rear_right: AxisCalibration
    base_yaw: JointCalibration
    shoulder: JointCalibration
    elbow: JointCalibration
    wrist: JointCalibration

    def __post_init__(self) -> None:
        """Reject two motors on one channel.

        Raises:
            CalibrationError: Naming both motors.
        """
        taken: dict[tuple[int, int], str] = {}
        for name, axis in zip(AXES, self.axes):
            place = (axis.address, axis.channel)
            first = taken.setdefault(place, name)
            if first != name:
                raise CalibrationError(
                    f"{name} and {first} are both on address {place[0]:#04x}, channel {place[1]}"
                )

    @functools.cached_property
    def axes(self) -> tuple[AxisCalibration, ...]:
        """The eight motors, in the order of `AXES`."""
        return tuple(getattr(self, name) for name in AXES)

    @functools.cached_property
    def boards(self) -> dict[int, tuple[int, int]]:
        """Axis numbers at the two channels of each motor board, by address; -1 without a motor."""
        found: dict[int, list[int]] = {}
        for number, axis in enumerate(self.axes):
            found.setdefault(axis.address, [-1, -1])[axis.channel - 1] = number
        return {address: (one, two) for address, (one, two) in sorted(found.items())}

    def at_board(self, address: int, values: NDArray[Number]) -> NDArray[Number]:
        """Return the entries of `values` (8,) at the two channels of a board; 0 without a motor."""
        return np.append(values, values.dtype.type(0))[list(self.boards[address])]

    @functools.cached_property
    def joints(self) -> tuple[JointCalibration, ...]:
        """The four arm joints, in the order of `ARM_JOINTS`."""
        return tuple(getattr(self, name) for name in ARM_JOINTS)

    @functools.cached_property
    def directions(self) -> FloatArray:
        """(8,) directions of the axes, 1 or -1."""
        return read_only([axis.direction for axis in self.axes])

    @functools.cached_property
    def counts_per_radian(self) -> FloatArray:
        """(8,) encoder counts per radian, with the direction as sign."""
        turn = 2.0 * math.pi
        return read_only([axis.direction * (axis.counts_per_turn / turn) for axis in self.axes])

    @functools.cached_property
    def ranges(self) -> FloatArray:
        """(4, 2) lower and upper limits of the arm joints [rad]."""
        return read_only([[joint.lower, joint.upper] for joint in self.joints])

    def angles(self, counts: ArrayLike) -> FloatArray:
        """Return shaft angles (..., 8) [rad] of unwrapped encoder counts (..., 8)."""
        return (np.asarray(counts, dtype=float) - START) / self.counts_per_radian

    def counts(self, angles: ArrayLike) -> IntArray:
        """Return the encoder counts (..., 8) nearest to shaft angles (..., 8) [rad], unwrapped."""
        turned = np.rint(np.asarray(angles, dtype=float) * self.counts_per_radian)
        return turned.astype(np.int64) + START

    def rates(self, counts_per_second: ArrayLike) -> FloatArray:
        """Return shaft speeds (..., 8) [rad/s] of counting rates (..., 8) [1/s]."""
        return np.asarray(counts_per_second, dtype=float) / self.counts_per_radian

    def duty_codes(self, duties: ArrayLike) -> IntArray:
        """Return the boards' duty codes (..., 8) nearest to duties (..., 8).

        Raises:
            ValueError: If a duty is not within [-1, 1]: a code out of range would reverse a motor.
        """
        values = np.asarray(duties, dtype=float)
        if not np.all(np.abs(values) <= 1.0):
            raise ValueError(f"duty outside of [-1, 1]: {values}")
        return np.rint(values * self.directions * FULL_DUTY).astype(np.int64)

    def duties(self, codes: ArrayLike) -> FloatArray:
        """Return duties (..., 8) in [-1, 1] of the boards' duty codes (..., 8)."""
        return np.asarray(codes, dtype=float) * self.directions / FULL_DUTY
