"""Medians and fractions with their 95 % intervals, in the form that metrics.json holds."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy import stats

from perception.geometry.arrays import FloatArray

CONFIDENCE = 0.95

Distribution = dict[str, float | int]


def distribution(samples: Iterable[float] | np.ndarray) -> Distribution:
    """Summarise repeated runs by the median, its 95 % interval and the 95th percentile.

    The interval is the narrowest symmetric pair of order statistics whose coverage is at least
    95 % for any continuous distribution: the number of samples below the true median is binomial
    (n, 1/2). With fewer than six samples no pair reaches 95 %; then the interval is the whole
    range, and its coverage is 1 - 2^(1 - n) only.

    Args:
        samples: (n,) values; infinity for a run that did not reach the goal.

    Returns:
        ``median``, ``mean``, ``low``, ``high``, ``p95`` and ``n``.

    Raises:
        ValueError: If there is no sample or one is NaN.
    """
    values = np.sort(np.asarray(list(samples), dtype=float).ravel())
    if values.size == 0:
        raise ValueError("distribution: no samples")
    if np.any(np.isnan(values)):
        raise ValueError(f"distribution: {int(np.isnan(values).sum())} of {values.size} are NaN")
    rank = max(int(stats.binom.ppf((1 - CONFIDENCE) / 2, values.size, 0.5)), 1)
    return {
        "median": float(np.median(values)),
        "mean": float(np.mean(values)),
        "low": float(values[rank - 1]),
        "high": float(values[values.size - rank]),
        "p95": float(np.percentile(values, 95, method="higher")),
        "n": int(values.size),
    }


def fraction(successes: int, n: int) -> Distribution:
    """Return a fraction of successes with its 95 % Wilson interval.

    Args:
        successes: Number of runs that succeeded.
        n: Number of runs.

    Returns:
        The keys of `distribution`; ``median``, ``mean`` and ``p95`` all hold the fraction.

    Raises:
        ValueError: If n is not positive or successes is not within 0..n.
    """
    if n < 1 or not 0 <= successes <= n:
        raise ValueError(f"fraction: {successes} of {n} is not a fraction")
    interval = stats.binomtest(successes, n).proportion_ci(CONFIDENCE, method="wilson")
    share = successes / n
    return {
        "median": share,
        "mean": share,
        "low": float(interval.low),
        "high": float(interval.high),
        "p95": share,
        "n": n,
    }


def success_fraction(successes: Iterable[bool]) -> Distribution:
    """Return `fraction` of runs.

    Args:
        successes: Whether each run succeeded.
    """
    flags = list(successes)
    return fraction(sum(flags), len(flags))


def error_bars(
    cells: Sequence[Distribution], centre: str = "mean"
) -> tuple[FloatArray, FloatArray]:
    """Return values and their intervals as matplotlib's ``errorbar`` takes them.

    Args:
        cells: n distributions or fractions.
        centre: Key of the value.

    Returns:
        (n,) values and (2, n) distances to the lower and to the upper end of the interval.
    """
    values, *ends = np.array([[cell[key] for cell in cells] for key in (centre, "low", "high")])
    return values, np.abs(np.array(ends) - values)


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> float:
    """Return the exact two-sided p of McNemar's test for paired successes.

    Args:
        first: Whether each run of one kind succeeded.
        second: Whether each run of the other kind succeeded, in the same order.
    """
    pairs = list(zip(first, second, strict=True))
    only_first, differ = sum(a and not b for a, b in pairs), sum(a != b for a, b in pairs)
    return float(stats.binomtest(only_first, differ, 0.5).pvalue) if differ else 1.0


def sign_test(differences: Iterable[float]) -> float:
    """Return the exact two-sided p of the sign test of paired differences; 1 where none differs.

    Args:
        differences: Difference of each pair; zeros are left out.
    """
    signs = [difference > 0 for difference in differences if difference != 0]
    return float(stats.binomtest(sum(signs), len(signs), 0.5).pvalue) if signs else 1.0


def holm(tests: Mapping[str, float]) -> dict[str, float]:
    """Return p of several tests, corrected for their number (Holm 1979).

    Args:
        tests: p of each test by its name.
    """
    corrected, largest = dict(tests), 0.0
    for rank, name in enumerate(sorted(tests, key=lambda each: tests[each])):
        largest = max(largest, min(1.0, (len(tests) - rank) * tests[name]))
        corrected[name] = largest
    return corrected
