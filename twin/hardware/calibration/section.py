"""What every section of a calibration shares."""

import dataclasses
import datetime
import math

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray


class CalibrationError(ValueError):
    """A calibration is wrong, stale or another robot's; one sentence says which and why."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Section:
    """What every section of a calibration says of itself.

    Attributes:
        calibrated_on: When its numbers were last found to hold.
        source: How they were found.
    """

    calibrated_on: datetime.date
    source: str


def require(condition: bool, key: str, value: object, valid: str) -> None:
    """Refuse a value unless the condition holds.

    Raises:
        CalibrationError: Naming the key, its value and what would be valid.
    """
    if not condition:
        raise CalibrationError(f"{key} is {value!r}, needs {valid}")


def require_positive(key: str, value: float, unit: str) -> None:
    """Refuse a number that is not positive and finite.

    Raises:
        CalibrationError: Naming the key and its value.
    """
    require(math.isfinite(value) and value > 0.0, key, value, f"a positive number [{unit}]")


def read_only(values: ArrayLike) -> FloatArray:
    """Return numbers as an array that nobody can change."""
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array
