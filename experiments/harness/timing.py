"""Processor time of a function, alone or against another in the same run."""

import time
from collections.abc import Callable

from experiments.harness.intervals import Distribution, distribution


def repeat(work: Callable[[], object], rounds: int) -> Distribution:
    """Time a function that has no peer, after one untimed call.

    Args:
        work: Function that is measured.
        rounds: Number of timed calls.

    Returns:
        Processor time of this process [s].
    """
    work()
    return distribution([timed(work) for _ in range(rounds)])


def compare(
    ours: Callable[[], object], peer: Callable[[], object], rounds: int
) -> dict[str, Distribution]:
    """Time two functions in alternation, so that a busy machine slows both.

    Each is called once before, untimed. Time is processor time of this process, so that other
    processes of the machine cost little accuracy.

    Args:
        ours: Function that is measured.
        peer: Function that it is measured against.
        rounds: Number of timed calls of each; the order is swapped every round.

    Returns:
        ``ours_s``, ``peer_s`` [s] and ``ratio`` (ours over peer, paired by round).
    """
    functions = {"ours": ours, "peer": peer}
    for function in functions.values():
        function()
    times: dict[str, list[float]] = {"ours": [], "peer": []}
    for index in range(rounds):
        order = ("ours", "peer") if index % 2 == 0 else ("peer", "ours")
        for name in order:
            times[name].append(timed(functions[name]))
    ratios = [a / b for a, b in zip(times["ours"], times["peer"])]
    return {
        "ours_s": distribution(times["ours"]),
        "peer_s": distribution(times["peer"]),
        "ratio": distribution(ratios),
    }


def timed(work: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    start = time.process_time()
    work()
    return time.process_time() - start
