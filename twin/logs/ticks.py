"""A log of one of our rovers as the ticks that its controller saw."""

from collections.abc import Iterator

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.logs.log import Log, LogError, Signal
from twin.logs.writing import SENSORS
from twin.robot import MISSING, Channel, Command, Observation, Validity, applied_command

_SLACK = 1e-9  # [s]


def robots_of(log: Log) -> list[str]:
    """Return the names of the rovers whose commands a log has."""
    names = [name.removesuffix("/wheels") for name in log.signals if name.endswith("/wheels")]
    return [name for name in names if f"{name}/arm" in log.signals]


def ticks_of(log: Log, robot: str) -> Iterator[tuple[Observation, Command]]:
    """Yield what a rover measured at each tick, and what was applied from then on.

    Args:
        log: Log that `twin.logs.writing.LogWriter` wrote.
        robot: Name of the rover.

    Raises:
        LogError: If the log has no such rover, naming those that it has.
    """
    if robot not in (there := robots_of(log)):
        raise LogError(f"no rover {robot!r} in the log; there are {', '.join(there) or 'none'}")
    wheels, arm = log.signals[f"{robot}/wheels"], log.signals[f"{robot}/arm"]
    times = wheels.stamps[: len(arm.stamps)]
    channels = {
        name: (signal, _latest(signal, times))
        for name in SENSORS
        if (signal := log.signals.get(f"{robot}/{name}")) is not None
    }
    for tick, time in enumerate(times.tolist()):
        seen = {
            name: _channel(signal, int(latest[tick])) for name, (signal, latest) in channels.items()
        }
        yield Observation(time, **seen), applied_command(wheels.values[tick], arm.values[tick])


def _latest(signal: Signal, times: FloatArray) -> np.ndarray:
    """Return which sample is the latest at each time; -1 before the first."""
    return np.searchsorted(signal.stamps, times + _SLACK, side="right") - 1


def _channel(signal: Signal, sample: int) -> Channel:
    if sample < 0:
        return MISSING
    return Channel(signal.values[sample], float(signal.stamps[sample]), Validity.MEASURED)
