"""Pulse trains as the master puts them on the power line, and the faults that befall them (E.4)."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from controllers.braid.bus.code import AddressCode, PulseTiming
from perception.geometry.arrays import FloatArray

FAULT_KINDS = ("missed", "extra", "missed_flag")

_MISSED, _PULSE, _DOUBLE = 0, 1, 2
_QUIET, _ADDRESS, _FLAG = 0.0, 1.0, 2.0
_EXTRA = (0.3, 0.4, 0.3)  # Shares of a pulse's rest: before, within and after an extra pulse.


@dataclasses.dataclass(frozen=True)
class Train:
    """Address pulses and the flag that ends them.

    Attributes:
        pulses: Number of times that each pulse sent appears on the line: 0 (missed), 1 or 2 (an
            extra pulse follows in its rest).
        flag: Whether the flag appears.
    """

    pulses: tuple[int, ...]
    flag: bool = True


Disturbance = Callable[[Train], Train]


def trains_of(code: AddressCode, commands: Iterable[int]) -> list[Train]:
    """Return the trains of a sequence of commands."""
    return [Train((_PULSE,) * code.pulses(command)) for command in commands]


def random_faults(
    rng: np.random.Generator, missed: float = 0.0, extra: float = 0.0, missed_flag: float = 0.0
) -> Disturbance:
    """Return faults that hit each pulse and each flag independently.

    Args:
        rng: Random generator for the faults.
        missed: Probability that a pulse is missed.
        extra: Probability that an extra pulse follows one.
        missed_flag: Probability that a flag is missed.

    Raises:
        ValueError: If a probability is out of range.
    """
    for name, rate in {"missed": missed, "extra": extra, "missed_flag": missed_flag}.items():
        if not 0.0 <= rate <= 1.0:
            raise ValueError(f"{name}: expected a probability, got {rate}")
    if missed + extra > 1.0:
        raise ValueError(f"missed + extra: expected at most 1, got {missed + extra}")

    def disturb(train: Train) -> Train:
        drawn = rng.random(len(train.pulses))
        kinds = np.where(drawn < missed, _MISSED, np.where(drawn < missed + extra, _DOUBLE, _PULSE))
        flag = train.flag and not rng.random() < missed_flag
        return Train(tuple(kinds.tolist()), flag)

    return disturb


class OneFault:
    """One fault in all that is sent: at one pulse, or at one flag, counted from the first train."""

    def __init__(self, kind: str, index: int) -> None:
        """Choose the fault.

        Args:
            kind: Kind of the fault.
            index: Index of the pulse (or flag) that is hit, from 0.

        Raises:
            ValueError: If there is no such fault.
        """
        if kind not in FAULT_KINDS:
            raise ValueError(f"fault {kind!r}: expected one of {', '.join(FAULT_KINDS)}")
        if index < 0:
            raise ValueError(f"index: expected 0 or more, got {index}")
        self._kind, self._left = kind, index

    def __call__(self, train: Train) -> Train:
        """Return the train as it appears on the line."""
        number = 1 if self._kind == "missed_flag" else len(train.pulses)
        place, self._left = self._left, self._left - number
        if not 0 <= place < number:
            return train
        if self._kind == "missed_flag":
            return dataclasses.replace(train, flag=False)
        pulses = list(train.pulses)
        pulses[place] = _MISSED if self._kind == "missed" else _DOUBLE
        return dataclasses.replace(train, pulses=tuple(pulses))


def segments(train: Train, timing: PulseTiming) -> list[tuple[float, float]]:
    """Return the pieces of constant level that make a train on the line.

    Returns:
        Level and length [s] of each piece; level 0 is rest, 1 an address pulse, 2 the flag.

    Raises:
        ValueError: If the train does not fit into the quiet time of the RC buffer.
    """
    pieces: list[tuple[float, float]] = []
    rest = timing.period - timing.high
    for kind in train.pulses:
        if kind == _MISSED:
            pieces.append((_QUIET, timing.period))
            continue
        pieces.append((_ADDRESS, timing.high))
        if kind == _DOUBLE:
            levels = (_QUIET, _ADDRESS, _QUIET)
            pieces += [(level, share * rest) for level, share in zip(levels, _EXTRA)]
        else:
            pieces.append((_QUIET, rest))
    if timing.quiet is None:
        pieces += [(_FLAG if train.flag else _QUIET, timing.flag), (_QUIET, timing.gap)]
        return pieces
    left = timing.quiet - len(train.pulses) * timing.period
    if left <= 0.0:
        raise ValueError(f"{len(train.pulses)} pulses do not fit into {timing.quiet} s")
    return [*pieces, (_QUIET, left)]


def sampled_segments(
    trains: Sequence[Train], timing: PulseTiming, sample: float
) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
    """Return the pieces of several trains in samples.

    Args:
        trains: Trains in the order in which they are sent.
        timing: Pulse timing of the master.
        sample: Time of one sample [s].

    Returns:
        (k,) levels; (k,) lengths in samples, 1 or more; (m + 1,) the piece at which each train
        starts, and the number of pieces.
    """
    pieces = [segments(train, timing) for train in trains]
    starts = np.cumsum([0, *map(len, pieces)])
    levels, seconds = np.array([*itertools.chain(*pieces)]).reshape(-1, 2).T
    return levels, np.maximum(np.rint(seconds / sample), 1).astype(np.int64), starts
