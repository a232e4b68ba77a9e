"""A log: what actuators were commanded and what sensors measured, each with its own stamps.

A file holds fields; a mapping makes signals of them.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Literal

import numpy as np

from perception.geometry.arrays import FloatArray

Role = Literal["actuator", "sensor"]


class LogError(ValueError):
    """A log, or its mapping, that cannot be used; in one line, which names the file."""

    def __init__(self, text: str) -> None:
        super().__init__(" ".join(text.split()))


@dataclasses.dataclass(frozen=True)
class Field:
    """One column of numbers.

    Attributes:
        stamps: (n,) times [s]; one array for all fields of a topic or table.
        values: (n,) numbers in the file's unit; NaN where there is none.
        notes: What the file says of the field's topic or table, by name.
    """

    stamps: FloatArray
    values: FloatArray
    notes: Mapping[str, str] = dataclasses.field(default_factory=dict[str, str])


@dataclasses.dataclass(frozen=True)
class Signal:
    """The samples of one actuator's command or one sensor.

    Attributes:
        role: What it is of.
        stamps: (n,) times of the samples [s], as recorded.
        values: (n, k) samples in SI units.
        unit: Unit of the values, such as "rad/s"; empty where it is not known.
        frame: Frame in which vectors are given; empty for scalars or where it is not known.
        noise: Standard deviation of a sensor's noise, in the unit of the values; NaN if not known.
    """

    role: Role
    stamps: FloatArray
    values: FloatArray
    unit: str = ""
    frame: str = ""
    noise: float = math.nan

    def __post_init__(self) -> None:
        """Refuse samples that do not fit their stamps.

        Raises:
            LogError: Naming the shapes.
        """
        stamps, values = np.shape(self.stamps), np.shape(self.values)
        if len(stamps) != 1 or len(values) != 2 or stamps[0] != values[0]:
            raise LogError(
                f"stamps of shape {stamps} and values of {values}: expected (n,), (n, k)"
            )


@dataclasses.dataclass(frozen=True)
class Log:
    """Signals of one run.

    Attributes:
        signals: Signals by the name of their actuator or sensor.
    """

    signals: Mapping[str, Signal]

    @property
    def span(self) -> tuple[float, float]:
        """Times of the first and the last sample [s]; NaN if there is none."""
        stamps = np.concatenate([each.stamps for each in self.signals.values()] or [np.empty(0)])
        good = stamps[np.isfinite(stamps)]
        return (float(good.min()), float(good.max())) if len(good) else (math.nan, math.nan)

    def until(self, time: float) -> "Log":
        """Return what was recorded before a time [s], of signals that have any."""
        cut: dict[str, Signal] = {}
        for name, each in self.signals.items():
            early = each.stamps < time
            if early.any():
                cut[name] = dataclasses.replace(
                    each, stamps=each.stamps[early], values=each.values[early]
                )
        return Log(cut)
