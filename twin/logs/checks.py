"""What is wrong with a log, found and named before anything is fitted to it."""

from collections.abc import Iterator

import numpy as np

from perception.geometry.arrays import BoolArray, FloatArray
from twin.logs.log import Log, Signal

GAP = 2.5
"""Samples are missing where two are further apart than so many median periods."""
UNEVEN = 0.1
"""Sampling is uneven if half of the periods spread by more than this, over their median."""
MOST = {"rad": 50.0, "rad/s": 500.0, "m": 1e3, "m/s": 50.0, "m/s^2": 200.0, "N m": 1e4, "N": 1e5}
"""Largest magnitude that a robot's signal of a unit has; beyond it the unit is doubted."""
IN_G = (0.9, 1.1)
"""Median length of an accelerometer's vector that speaks for g instead of m/s^2."""


def problems(log: Log) -> list[str]:
    """Return what is wrong with the signals, a line each; it begins with the signal's name.

    Found are too few samples, numbers that are none, stamps that go back or occur twice, missing
    samples, uneven sampling, sensors that never change (or all actuators), and values that a robot
    hardly has in the unit that they are said to be in.
    """
    found = [f"{name}: {text}" for name, each in log.signals.items() for text in _problems(each)]
    commands = {name: each for name, each in log.signals.items() if each.role == "actuator"}
    if commands and all(_is_still(each.values) for each in commands.values()):
        found.append(f"{', '.join(commands)}: no command ever changes")
    return found


def _problems(signal: Signal) -> Iterator[str]:
    stamps, values = signal.stamps, signal.values
    if len(stamps) < 2:
        yield f"{len(stamps)} samples; two or more are needed"
        return
    if not np.isfinite(stamps).all():
        yield f"{np.count_nonzero(~np.isfinite(stamps))} stamps are no numbers"
        return
    bad = np.logical_not(np.isfinite(values).all(axis=1))
    if bad.any():
        yield f"{bad.sum()} of {len(bad)} samples are no numbers, first {_at(stamps, bad)}"
    yield from _clock_problems(stamps)
    good = values[~bad]
    if not len(good):
        return
    if signal.role == "sensor" and _is_still(good):
        yield "never changes"
    yield from _unit_problems(signal.unit, good)


def _is_still(values: FloatArray) -> bool:
    """Return whether no sample of numbers differs from another."""
    good = values[np.isfinite(values).all(axis=1)]
    return not len(good) or bool(np.ptp(good, axis=0).max() == 0.0)


def _clock_problems(stamps: FloatArray) -> Iterator[str]:
    periods = np.diff(stamps)
    back, twice = periods < 0.0, periods == 0.0
    if back.any():
        count, most = back.sum(), -periods.min()
        yield f"its clock goes back {count} times, by up to {most:.3g} s, first {_at(stamps, back)}"
    if twice.any():
        yield f"{twice.sum()} stamps occur again, first {_at(stamps, twice)}"
    forward = periods[periods > 0.0]
    if not len(forward):
        return
    usual = float(np.median(forward))
    gap = periods > GAP * usual
    if gap.any():
        lost = np.round(periods[gap] / usual - 1.0).sum()
        yield (
            f"{gap.sum()} gaps, of {periods.max():.3g} s at most, where {lost:.0f} samples or so "
            f"are missing or the clock jumped, first {_at(stamps, gap)}"
        )
    low, high = np.percentile(forward, [25.0, 75.0])
    if high - low > UNEVEN * usual:
        yield f"sampled unevenly: half of the periods are {1e3 * low:.3g} to {1e3 * high:.3g} ms"


def _unit_problems(unit: str, values: FloatArray) -> Iterator[str]:
    largest = float(np.abs(values).max())
    if largest > MOST.get(unit, np.inf):
        yield f"values of up to {largest:.3g} {unit}: is the unit right?"
    if unit == "m/s^2" and values.shape[1] == 3:
        length = float(np.median(np.linalg.norm(values, axis=1)))
        if IN_G[0] < length < IN_G[1]:
            yield f"vectors of {length:.2f} m/s^2 in the median: are they in g?"


def _at(stamps: FloatArray, where: BoolArray) -> str:
    return f"at {stamps[int(np.argmax(where))]:.6g} s"
