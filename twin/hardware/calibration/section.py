"""Base class of calibration sections, and conversion of TOML tables to dataclasses."""

import dataclasses
import datetime
import math
import reprlib
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray

T = TypeVar("T")
LONGEST = 80
"""Characters of an unknown key that an error shows."""


class CalibrationError(ValueError):
    """A calibration is invalid, stale or of another robot; the message gives the reason."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Section:
    """Date and source of the numbers of a section.

    Attributes:
        calibrated_on: Date on which the numbers were last confirmed.
        source: Description of the measurement that gave the numbers.
    """

    calibrated_on: datetime.date
    source: str


def require(condition: bool, key: str, value: object, valid: str) -> None:
    """Reject a value unless the condition holds.

    Raises:
        CalibrationError: Naming the key, its value and the valid values.
    """
    if not condition:
        raise CalibrationError(f"{key} is {reprlib.repr(value)}, needs {valid}")


def require_positive(key: str, value: float, unit: str) -> None:
    """Reject a number that is not positive and finite.

    Raises:
        CalibrationError: Naming the key and its value.
    """
    require(math.isfinite(value) and value > 0.0, key, value, f"a positive number [{unit}]")


def read_only(values: ArrayLike) -> FloatArray:
    """Return numbers as a read-only array."""
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


def from_table(kind: type[T], table: Mapping[str, object], where: str = "") -> T:
    """Return a dataclass from a table of TOML or JSON.

    Args:
        kind: Dataclass; the table may omit fields with a default value.
        table: Table from the file.
        where: Prefix of the keys in error messages.

    Raises:
        CalibrationError: Naming the key and its value.
    """
    hints = typing.get_type_hints(kind)
    fields = {field.name: field for field in dataclasses.fields(typing.cast("Any", kind))}
    unknown = [name for name in table if name not in fields]
    if unknown:
        raise CalibrationError(
            f"{where}{unknown[0][:LONGEST]} is unknown (value {reprlib.repr(table[unknown[0]])}); "
            f"valid keys are {', '.join(fields)}"
        )
    for name, field in fields.items():
        if name not in table and field.default is dataclasses.MISSING:
            raise CalibrationError(f"{where}{name} is missing; needed are {', '.join(fields)}")
    values = {name: _value(hints[name], table[name], f"{where}{name}") for name in table}
    try:
        return kind(**values)
    except CalibrationError as error:
        raise CalibrationError(f"{where}{error}") from None


def _value(hint: Any, value: Any, key: str) -> Any:
    """Convert a value to the type of its field, or reject it."""
    if typing.get_origin(hint) is types.UnionType:  # A type or None.
        return None if value is None else _value(typing.get_args(hint)[0], value, key)
    if dataclasses.is_dataclass(hint):
        require(isinstance(value, dict), key, value, "a table")
        return from_table(typing.cast("type[Any]", hint), value, f"{key}.")
    if hint is float:
        # A bool is an int too, and not every int is a float.
        number = isinstance(value, float) or (type(value) is int and value.bit_length() < 1024)
        require(number, key, value, "a number")
        return float(value)
    if typing.get_origin(hint) is tuple:
        require(isinstance(value, list), key, value, "a list")
        item = typing.get_args(hint)[0]
        return tuple(_value(item, entry, key) for entry in value)
    require(type(value) is hint, key, value, _WORDS[hint])
    return value


_WORDS: Mapping[type, str] = types.MappingProxyType(
    {
        int: "a whole number",
        bool: "true or false",
        str: "a text",
        datetime.date: "a date (as 2026-01-31)",
    }
)
