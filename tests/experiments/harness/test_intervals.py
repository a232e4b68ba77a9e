import numpy as np
import pytest

from experiments.harness.intervals import distribution, fraction, holm, mcnemar, sign_test


@pytest.mark.parametrize("n", [6, 9, 20, 51])
def test_interval_of_the_median_covers_it_95_percent_of_the_time(n):
    generator = np.random.default_rng(n)
    trials = 2000
    samples = generator.lognormal(size=(trials, n))  # true median 1, skewed
    found = [distribution(row) for row in samples]
    share = np.mean([each["low"] <= 1.0 <= each["high"] for each in found])
    assert share >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / trials)
    assert share <= 0.985 if n > 10 else True


@pytest.mark.parametrize("n", range(6, 60))
def test_interval_is_the_narrowest_pair_of_order_statistics_that_reaches_95_percent(n):
    # Exact coverage of (x_k, x_(n+1-k)), by counting all outcomes of n coins.
    counts = np.array([1.0])
    for _ in range(n):
        counts = np.convolve(counts, [0.5, 0.5])
    coverage = [counts[k : n - k + 1].sum() for k in range(1, n // 2 + 1)]
    best = 1 + max(index for index, share in enumerate(coverage) if share >= 0.95)
    found = distribution(np.arange(1, n + 1))
    assert (found["low"], found["high"]) == (best, n + 1 - best)


def test_few_samples_give_their_range():
    found = distribution([3.0, 1.0, 2.0])
    assert (found["low"], found["median"], found["high"], found["n"]) == (1.0, 2.0, 3.0, 3)


def test_a_run_that_never_got_there_counts_as_the_worst():
    found = distribution([1.0, 2.0, np.inf])
    assert found["median"] == 2.0 and found["p95"] == np.inf


def test_no_samples_and_nan_are_refused():
    with pytest.raises(ValueError, match="no samples"):
        distribution([])
    with pytest.raises(ValueError, match="1 of 2 are NaN"):
        distribution([1.0, np.nan])


def test_wilson_interval_agrees_with_its_closed_form():
    z, n, p = 1.959963984540054, 40, 0.25
    middle, half = p + z * z / 2 / n, z * np.sqrt(p * (1 - p) / n + z * z / 4 / n**2)
    found = fraction(10, 40)
    scale = 1 + z * z / n
    assert found["low"] == pytest.approx((middle - half) / scale, rel=1e-12)
    assert found["high"] == pytest.approx((middle + half) / scale, rel=1e-12)
    assert fraction(0, 5)["low"] == 0.0
    with pytest.raises(ValueError, match="not a fraction"):
        fraction(6, 5)


def test_mcnemar_is_the_exact_binomial_of_the_pairs_that_differ():
    """By hand: b = 6 and c = 1 of 7, two-sided 2 * (1 + 7) / 2**7."""
    first = [True] * 6 + [False] + [True] * 5 + [False] * 3
    second = [False] * 6 + [True] + [True] * 5 + [False] * 3
    assert mcnemar(first, second) == pytest.approx(2 * 8 / 128)
    assert mcnemar(second, first) == pytest.approx(2 * 8 / 128)
    assert mcnemar([True, False, True], [True, False, True]) == 1.0
    assert mcnemar([True] * 5, [False] * 5) == pytest.approx(2 / 32)
    with pytest.raises(ValueError, match="zip"):
        mcnemar([True], [True, False])


def test_sign_test_counts_the_pairs_that_differ():
    assert sign_test([1, 2, 5, 0, 1, 3, 0]) == pytest.approx(2 / 32)
    assert sign_test([1, -2, 0]) == 1.0 == sign_test([0, 0])


def test_holm_multiplies_by_the_tests_left_and_keeps_their_order():
    # The example of Holm's procedure with four tests: 0.005, 0.01, 0.03, 0.04.
    found = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005})
    assert found == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})
    assert holm({"a": 0.9}) == {"a": 0.9} and holm({}) == {}
