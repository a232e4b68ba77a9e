"""Checks of configurations, for every room."""

import dataclasses
import math
from collections.abc import Collection
from typing import Any


def check_numbers(what: str, config: Any, *names: str, zero: bool = False) -> None:
    """Refuse fields of a configuration that are not finite and positive.

    Args:
        what: Name of the thing configured; begins the error message.
        config: Dataclass to check.
        names: Fields to check; all unless given.
        zero: Whether 0 is valid too.

    Raises:
        ValueError: Naming the field, its value and what is valid.
    """
    for name in names or [field.name for field in dataclasses.fields(config)]:
        value = getattr(config, name)
        if not (0.0 < value < math.inf or (zero and value == 0.0)):
            valid = "0 or a positive number" if zero else "a positive number"
            raise ValueError(f"{what} {name} = {value}: expected {valid}")


def check_choice(name: str, value: str, valid: Collection[str]) -> None:
    """Refuse a choice that there is not.

    Args:
        name: Name of the option, for the error message.
        value: Value chosen.
        valid: All valid choices.

    Raises:
        ValueError: Naming the choice and the valid ones.
    """
    if value not in valid:
        raise ValueError(f"{name} {value!r}: expected one of {', '.join(valid)}")
