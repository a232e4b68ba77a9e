"""Changes in innovations that are linear in them, against likelihoods by brute force."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate
import scipy.signal
import scipy.stats

from controllers.sensing.changes import (
    Change,
    ChangeConfig,
    ChangeDetector,
    _joined,
)

SPREADS = np.array([0.5, 2.0, 0.1])
CONFIG = ChangeConfig(
    block=10, windows=(2, 4, 8), learning=60, settling=2, walk=0.0, memory=1e9, between=1e4,
    offset=0.0, lags=0, freedom=1e9,
)  # fmt: skip
"""For innovations that are as they are modelled: white, around what deviations explain."""
ROBUST = dataclasses.replace(CONFIG, offset=2.0, lags=8, freedom=4.0)
CHANGES = [
    Change(name, "1", row, spread)
    for name, row, spread in zip("abc", np.eye(3), (2.0, 6.0, 0.5), strict=True)
]
READINGS = 6
SIGMA = np.array([0.1, 1.0, 0.5, 2.0, 0.02, 3.0])


def innovations(rng, ticks, deviations, noise=1.0):
    """What a robot with these deviations shows: sensitivities that change, and white noise."""
    for tick in range(ticks):
        wave = np.sin(0.05 * tick * np.arange(1, 4)[:, None] + np.arange(READINGS))
        slopes = wave * SIGMA / SPREADS[:, None]
        values = deviations(tick) @ slopes + noise * SIGMA * rng.standard_normal(READINGS)
        yield values, slopes


def watched(detector, rng, ticks, deviations, noise=1.0):
    """Findings, by tick; the twin has each from then on."""
    found, known = [], np.zeros(3)
    left = innovations(rng, ticks, lambda tick: deviations(tick) - known, noise)
    for tick, (values, slopes) in enumerate(left):
        finding = detector.step(values, SIGMA, slopes)
        if finding is not None:
            found.append((tick, finding))
            change = [each for each in CHANGES if each.name == finding.name]
            if change:
                known += change[0].direction * finding.size
                detector.accept(change[0], finding)
            else:
                detector.reset()
    return found


def test_the_robot_is_learned_as_least_squares_learns_it():
    true = np.array([0.4, -1.5, 0.05])
    config = dataclasses.replace(CONFIG, learning=10**6, forgetting=1e9, windows=(1,))
    detector = ChangeDetector(SPREADS, CHANGES, config)
    rows, values = [], []
    for seen, slopes in innovations(np.random.default_rng(1), 4000, lambda tick: true):
        detector.step(seen, SIGMA, slopes)
        rows.append(slopes / SIGMA), values.append(seen / SIGMA)
    # Blocks that it has left out: those at first, and the last, which may be changed already.
    first, last = CONFIG.settling * CONFIG.block, 4000 - CONFIG.block
    means = [
        np.array(each[first:last]).reshape(-1, CONFIG.block, *np.shape(each[0])).mean(axis=1)
        for each in (rows, values)
    ]
    slopes, seen = means[0].transpose(0, 2, 1).reshape(-1, 3), means[1].ravel()
    prior = np.diag(SPREADS**-2.0)
    information = CONFIG.block * slopes.T @ slopes + prior
    expected = np.linalg.solve(information, CONFIG.block * slopes.T @ seen)
    # The variances of the readings are learned, so that neither is exact.
    sigma = np.sqrt(np.diag(np.linalg.inv(information)))
    assert np.abs(detector.deviations - expected).max() < 0.3 * sigma.max()
    assert np.sqrt(np.diag(detector.covariance)) == pytest.approx(sigma, rel=0.15)
    assert np.all(np.abs(detector.deviations - true) < 4.0 * sigma)


@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_ratio_is_that_of_the_likelihoods_integrated_over_the_size(offset):
    rng = np.random.default_rng(2)
    changes = [dataclasses.replace(each, sign=sign) for sign in (0, 1, -1) for each in CHANGES]
    config = dataclasses.replace(CONFIG, learning=10**6, offset=offset)
    detector = ChangeDetector(SPREADS, changes, config)
    for tick, (values, slopes) in enumerate(innovations(rng, 200, lambda tick: np.zeros(3))):
        kind = tick // CONFIG.block % 2
        detector.step((1.0 + kind) * values, SIGMA, slopes, kind)
    blocks = _joined(detector._recent).last(4)
    assert set(blocks.kinds) == {0, 1}
    ratios = detector._compare(blocks, np.linalg.inv(detector._covariance)).ratios
    # By brute force: all block means as one Gaussian vector, whose mean the change moves.
    variances = detector._variances
    offsets = [np.diag(row) for row in blocks.offsets]
    slopes = np.vstack([np.vstack([*pair]).T for pair in zip(blocks.slopes, offsets)])
    values = np.concatenate(blocks.values)
    noise = np.concatenate(variances[blocks.kinds] / blocks.ticks)
    known = detector._covariance
    covariance = np.diag(noise) + slopes @ known @ slopes.T
    off = values - slopes @ detector._mean
    for change, ratio in zip(changes, ratios, strict=True):
        along = slopes[:, :3] @ (change.direction / SPREADS)

        none = scipy.stats.multivariate_normal.logpdf(off, np.zeros(len(off)), covariance)

        def likelihood(size, along=along, change=change, none=none):
            moved = scipy.stats.multivariate_normal.logpdf(off, size * along, covariance)
            return np.exp(moved - none) * scipy.stats.norm.pdf(size, 0.0, change.spread)

        reach = 8.0 * change.spread
        sizes = {0: (-reach, reach), 1: (0.0, reach), -1: (-reach, 0.0)}[change.sign]
        expected, _ = scipy.integrate.quad(likelihood, *sizes, limit=400)
        expected *= 2.0 if change.sign else 1.0
        assert ratio == pytest.approx(np.log(expected), abs=1e-3)


@pytest.mark.parametrize("config", [CONFIG, ROBUST])
def test_unchanged_robots_raise_hardly_an_alarm(config):
    config = dataclasses.replace(config, between=1e3)
    blocks, alarms = 0, 0
    for seed in range(4):
        rng = np.random.default_rng([3, seed])
        true = SPREADS * rng.standard_normal(3)
        detector = ChangeDetector(SPREADS, CHANGES, config)
        alarms += len(watched(detector, rng, 10_000, lambda tick, true=true: true, noise=0.5))
        blocks += 1000 - config.learning
    # As many as one in a thousand blocks would be 3.8 in the mean.
    assert alarms <= scipy.stats.poisson.ppf(0.999, blocks / config.between)


@pytest.mark.parametrize("config", [CONFIG, ROBUST])
@pytest.mark.parametrize(("kind", "size"), [(0, 1.5), (1, -5.0), (2, 0.3)])
def test_change_is_named_soon_with_its_size(kind, size, config):
    delays, inside = [], 0
    for seed in range(6):
        rng = np.random.default_rng([4, kind, seed])
        true = SPREADS * rng.standard_normal(3)
        change = size * np.eye(3)[kind]

        def deviations(tick, true=true, change=change):
            return true + (change if tick >= 1200 else 0.0)  # noqa: PLR2004

        found = watched(ChangeDetector(SPREADS, CHANGES, config), rng, 2000, deviations)
        assert [each.name for _, each in found] == ["abc"[kind]]
        tick, finding = found[0]
        delays.append(tick - 1200)
        inside += abs(finding.size - size) < 1.96 * finding.sigma
    assert min(delays) > 0 and np.median(delays) <= 100  # noqa: PLR2004
    assert inside >= 3  # Of six 95 % bands; fewer would hold once in ten thousand.


def test_what_is_over_before_it_is_confirmed_is_not_named():
    config = dataclasses.replace(CONFIG, confirming=10)
    for end, count in ((1230, 0), (2000, 1)):
        detector = ChangeDetector(SPREADS, CHANGES, config)
        most, found = -np.inf, 0

        def deviations(tick, end=end):
            return np.array([4.0, 0.0, 0.0]) * (1200 <= tick < end)  # noqa: PLR2004

        for values, slopes in innovations(np.random.default_rng(9), 2000, deviations):
            finding = detector.step(values, SIGMA, slopes)
            most = np.nanmax([most, detector.odds])
            if finding is not None:
                found += 1
                break
        assert most > np.log(config.between) and found == count


def test_what_is_not_measured_counts_for_nothing():
    rng = np.random.default_rng(6)
    whole, without = (ChangeDetector(SPREADS, CHANGES, CONFIG) for _ in range(2))
    for values, slopes in innovations(rng, 700, lambda tick: np.array([0.3, 0.0, 0.1])):
        values[2] = np.nan
        whole.step(values, SIGMA, slopes)
        rows = [k for k in range(READINGS) if k != 2]  # noqa: PLR2004
        without.step(values[rows], SIGMA[rows], slopes[:, rows])
    assert whole.deviations == pytest.approx(without.deviations, rel=1e-12)
    assert whole.evidence == pytest.approx(without.evidence, rel=1e-9)


def stony(config):
    """Alarms of six unchanged robots that each drive over stones for half a second."""
    alarms = 0
    for seed in range(6):
        rng = np.random.default_rng([7, seed])
        detector = ChangeDetector(SPREADS, CHANGES, config)
        true = SPREADS * rng.standard_normal(3)
        off = np.zeros((3000, READINGS))
        off[2000:2050] = np.repeat(rng.normal(0.0, 1.5, (5, READINGS)), 10, axis=0)
        for tick, (values, slopes) in enumerate(innovations(rng, 3000, lambda _, true=true: true)):
            if detector.step(values + SIGMA * off[tick], SIGMA, slopes) is not None:
                alarms += 1
                break
    return alarms


def test_seconds_that_are_rougher_than_others_count_for_less():
    assert stony(ROBUST) + 2 <= stony(dataclasses.replace(ROBUST, freedom=1e9))


def test_what_a_reading_is_off_by_for_a_while_counts_by_its_long_run_variance():
    rng = np.random.default_rng(9)
    noise = scipy.signal.lfilter(
        [0.3], [1.0, -0.96], rng.standard_normal((40_000, READINGS)), axis=0
    )
    config = dataclasses.replace(ROBUST, learning=10**6, forgetting=1e9, memory=1e9)
    detector = ChangeDetector(SPREADS, CHANGES, config)
    for row in noise:
        detector.step(row * SIGMA, SIGMA, np.zeros((3, READINGS)))
    # By brute force: sums over times that are long beside those for which it lasts.
    sums = noise.reshape(-1, 800, READINGS).sum(axis=1)
    expected = np.mean(sums**2) / 800
    assert np.mean(detector._variances[0]) == pytest.approx(expected, rel=0.35)
    assert expected > 10.0 * np.mean(noise**2)


def shaken(told, change, seed):
    """Ticks from a change until one is named, on a robot that is shaken 5 of 10 s; NaN for never.

    It comes as the robot stands; `told` says whether the detector knows when that is.
    """
    rng = np.random.default_rng([12, seed])
    ticks, begins = 5_450, 5_050
    config = dataclasses.replace(ROBUST, learning=200, between=1e6)
    detector = ChangeDetector(SPREADS, CHANGES, config)
    off = np.repeat(rng.normal(0.0, 2.0, (ticks // 20 + 1, READINGS)), 20, axis=0)

    def deviations(tick):
        return np.array([change if tick >= begins else 0.0, 0.0, 0.0])

    for tick, (values, slopes) in enumerate(innovations(rng, ticks, deviations)):
        kind = tick // 500 % 2
        seen = values + kind * off[tick] * SIGMA
        if detector.step(seen, SIGMA, slopes, kind if told else 0) is not None:
            return tick - begins
    return np.nan


def test_what_shakes_a_rover_that_drives_hides_no_change_while_it_stands():
    unchanged = [shaken(True, 0.0, seed) for seed in range(4)]
    assert np.isnan(unchanged).all()
    told = [shaken(True, 1.5, seed) for seed in range(4)]
    untold = [shaken(False, 1.5, seed) for seed in range(4)]
    assert max(told) < min(untold)


def test_what_a_reading_is_off_by_for_good_is_learned_beside_the_deviations():
    rng = np.random.default_rng(10)
    true, off = np.array([0.4, -1.5, 0.05]), rng.normal(0.0, 1.5, READINGS)
    config = dataclasses.replace(ROBUST, learning=10**6)
    detector, blind = (ChangeDetector(SPREADS, CHANGES, each) for each in (config, CONFIG))
    for values, slopes in innovations(rng, 4000, lambda _: true):
        for each in (detector, blind):
            each.step(values + SIGMA * off, SIGMA, slopes)
    sigma = np.sqrt(np.diag(detector.covariance))
    assert np.all(np.abs(detector.deviations - true) < 4.0 * sigma)
    assert config.offset * detector.memory.mean[3:] == pytest.approx(off, abs=0.15)
    assert np.all(detector.memory.products[0] < 1.3)  # noqa: PLR2004
    assert np.all(blind.memory.products[0] > detector.memory.products[0] + 4.0 * off**2)


def test_it_goes_on_with_what_it_has_learned():
    rng = np.random.default_rng(8)
    true = np.array([0.4, -1.5, 0.05])
    ticks = list(innovations(rng, 1400, lambda tick: true))
    detector = ChangeDetector(SPREADS, CHANGES, ROBUST)
    for values, slopes in ticks[:1000]:
        detector.step(values, SIGMA, slopes)
    again = ChangeDetector(SPREADS, CHANGES, ROBUST)
    again.remember(detector.memory)
    detector.pause()
    for each in (detector, again):
        assert np.isnan(each.odds)
        for values, slopes in ticks[1000:]:
            assert each.step(values, SIGMA, slopes) is None
    assert again.deviations == pytest.approx(detector.deviations, rel=1e-12)
    assert again.evidence == pytest.approx(detector.evidence, rel=1e-12)
    assert np.isfinite(again.odds)
    with pytest.raises(ValueError, match=r"expected .4, 9, 7.: begin anew"):
        ChangeDetector(SPREADS[:2], [], ROBUST).remember(detector.memory)


def test_a_twin_that_takes_in_what_was_learned_misses_what_is_left():
    rng, true = np.random.default_rng(4), np.array([0.4, -1.5, 0.05])
    detector = ChangeDetector(SPREADS, CHANGES, ROBUST)
    for values, slopes in innovations(rng, 1000, lambda tick: true):
        detector.step(values, SIGMA, slopes)
    blocks = detector.blocks
    taken = detector.take_in(np.array([True, True, False]))
    sigma = np.sqrt(np.diag(detector.covariance))
    assert np.all(np.abs(taken - true)[:2] < 4.0 * sigma[:2])
    assert taken[2] == 0.0
    assert detector.deviations[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert abs(detector.deviations[2] - true[2]) < 4.0 * sigma[2]
    assert detector.blocks == blocks
    for values, slopes in innovations(rng, 1000, lambda tick: true - taken):
        assert detector.step(values, SIGMA, slopes) is None
    assert np.all(np.abs(taken + detector.deviations - true) < 4.0 * sigma)


def test_a_block_of_fewer_ticks_than_there_are_windows_is_refused():
    with pytest.raises(ValueError, match="block = 3: expected more ticks than the 3 windows"):
        dataclasses.replace(CONFIG, block=3)


def alarmed(config=CONFIG, walks=None):
    """The detector at its alarm after the second of three deviations changed; None for none."""
    rng, detector = np.random.default_rng(8), ChangeDetector(SPREADS, CHANGES, config, walks)
    change = np.array([0.0, -5.0, 0.0])
    for tick, (values, slopes) in enumerate(
        innovations(rng, 1600, lambda tick: change * (tick >= 1200))  # noqa: PLR2004
    ):
        if detector.step(values, SIGMA, slopes, 0) is not None:
            assert tick > 1200  # noqa: PLR2004
            return detector
    return None


def test_an_alarm_suspects_the_likeliest_changes_first():
    detector = alarmed()
    assert [each.name for each in detector.suspects][0] == "b"
    order = np.argsort(-detector.evidence)
    assert [each.name for each in detector.suspects] == ["abc"[k] for k in order]
    assert detector.suspects[0].size == pytest.approx(-5.0, abs=4.0 * detector.suspects[0].sigma)


def test_what_wanders_by_itself_has_not_changed():
    assert alarmed(walks=np.array([0.0, 0.1, 0.0])) is not None
    detector = alarmed(walks=np.array([0.0, 5.0, 0.0]))
    assert detector is None or detector.suspects[0].name != "b"


def test_what_is_learned_is_told_for_a_trial():
    detector = ChangeDetector(SPREADS, CHANGES, dataclasses.replace(CONFIG, offset=2.0))
    true, off = np.array([0.4, -1.5, 0.05]), np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    for values, slopes in innovations(np.random.default_rng(1), 4000, lambda tick: true):
        detector.step(values + off * SIGMA, SIGMA, slopes)
    learned = detector.learned
    sigma = np.sqrt(np.diag(learned.covariance))
    assert np.all(np.abs(learned.deviations - true) < 4.0 * sigma)
    assert learned.offsets == pytest.approx(off, abs=0.3)
    assert learned.variances[0] == pytest.approx(np.ones(READINGS), rel=0.5)
