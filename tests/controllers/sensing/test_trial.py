"""Changes that are tried out beside robots whose readings are linear in what they deviate by."""

import numpy as np
import pytest

from controllers.sensing.changes import KINDS, Change, Learned
from controllers.sensing.diagnosis import UNKNOWN
from controllers.sensing.trial import Trial, TrialConfig, mean_size

READINGS, COUNT = 6, 4
SIGMA = np.array([0.1, 1.0, 0.5, 2.0, 0.02, 3.0])
BEFORE = np.array([0.2, -0.1, 0.05, 0.0])
"""What the robot deviates by before anything happens."""
LEARNED = Learned(BEFORE, 1e-6 * np.eye(COUNT), np.zeros(READINGS), np.ones((KINDS, READINGS)))
CHANGES = [
    Change("load", "kg", np.eye(COUNT)[0], 1.0, 1),
    Change("spring", "1", np.eye(COUNT)[1], 0.5, -1, most=1.0),
    Change("zero", "rad", np.eye(COUNT)[2], 0.3),
    Change("stuck", "1", np.eye(COUNT)[3], 0.2, whole=True),
]
SUPPLY = Change("supply", "1", np.eye(COUNT)[1], 0.3, 1, most=0.9, wholly="blocked")


def slopes(tick):
    wave = np.sin(0.02 * tick * np.arange(1, COUNT + 1)[:, None] + np.arange(READINGS))
    return 2.0 * wave * SIGMA


def tried(trial, true, seed=1, knocked=0.0, strength=1.0):
    """Run a trial beside a robot that deviates by so much; returns what came of it, and when."""
    rng = np.random.default_rng(seed)
    for tick in range(1000):
        noise = SIGMA * rng.standard_normal(READINGS)
        strange = knocked * SIGMA * np.sign(np.sin(0.11 * tick + np.arange(READINGS) ** 2))
        told = strength * slopes(tick)
        missed = noise + strange + (true - trial.rows) @ told
        missed[:, 2] = np.nan if tick % 2 else missed[:, 2]
        trial.step(missed, SIGMA, told, tick % KINDS)
        if trial.over:
            return trial.finding, tick
    raise AssertionError("it does not end")


@pytest.mark.parametrize(("index", "size"), [(0, 1.3), (1, -0.7), (2, 0.5), (2, -0.4), (3, 1.0)])
def test_what_happened_is_named_with_its_size_among_others(index, size):
    inside, ticks = [], []
    for seed in range(12):
        trial = Trial(CHANGES, LEARNED)
        found, tick = tried(trial, BEFORE + size * CHANGES[index].direction, seed)
        assert found is not None and found.name == CHANGES[index].name
        inside.append(abs(found.size - size) <= 1.96 * found.sigma + 1e-12)
        assert abs(found.size - size) < 0.1, found
        ticks.append(tick)
    assert np.mean(inside) >= 0.75, inside  # noqa: PLR2004
    config = TrialConfig()
    soonest = config.block * (config.first + config.least)
    assert soonest - 1 == min(ticks) <= max(ticks) < config.block * (config.first + config.most)


def test_what_earlier_parts_told_counts_in_the_later_ones():
    """Eight times fainter than usual, and larger than any size of the second part."""
    config, blocks = TrialConfig(needed=0.3), list[float]()
    for seed in range(10):
        true = BEFORE + 1.5 * CHANGES[2].direction
        found, tick = tried(Trial(CHANGES, LEARNED, config), true, seed, strength=0.13)
        blocks += [tick / config.block] if found is not None else []
    assert len(blocks) >= 8  # noqa: PLR2004
    # What the second part takes its time for, the third and fourth need not show anew.
    assert np.mean(blocks) < config.first + 3.5 * config.least, blocks


def test_what_is_larger_than_all_that_was_tried_out_is_tried_out_larger():
    """What it does grows with the cube of its size: sizes below it explain little of it."""
    config, change = TrialConfig(needed=35.0), CHANGES[2]
    rng, trial, tick = np.random.default_rng(3), Trial([change], LEARNED, config), 0
    while not trial.over:
        sizes = (trial.rows - BEFORE) @ change.direction
        missed = SIGMA * rng.standard_normal(READINGS) + (1.0 - sizes[:, None] ** 3) * 4.0 * SIGMA
        trial.step(missed, SIGMA, slopes(tick), 0)
        tick += 1
    assert trial.finding is not None
    assert trial.finding.size == pytest.approx(1.0, abs=0.1)


def test_what_is_larger_than_all_that_was_tried_out_is_left_while_others_explain_more():
    """A load of seven kilograms, of which five are tried out first; the other explains six."""
    far = Change("spring", "1", CHANGES[0].direction, 1.5, 1, most=6.0)
    found, _ = tried(Trial([CHANGES[0], far], LEARNED), BEFORE + 7.0 * CHANGES[0].direction)
    assert found is not None and found.name == "load"
    assert found.size == pytest.approx(7.0, abs=0.2)


@pytest.mark.parametrize(("lost", "name"), [(0.7, "supply"), (1.0, "blocked")])
def test_what_is_lost_wholly_has_a_name_of_its_own(lost, name):
    found, _ = tried(Trial([SUPPLY], LEARNED), BEFORE + lost * SUPPLY.direction)
    assert found is not None and found.name == name
    assert found.size == (1.0 if name == "blocked" else pytest.approx(lost, abs=0.05))


@pytest.mark.parametrize(("before", "named"), [(0.13, True), (0.25, False)])
def test_what_may_as_well_be_as_it_was_is_not_named(before, named):
    """Half a unit, of a robot that is known to an eighth of one or to a quarter."""
    learned = LEARNED._replace(covariance=before**2 * np.eye(COUNT))
    found, _ = tried(Trial(CHANGES[2:3], learned), BEFORE + 0.5 * CHANGES[2].direction)
    assert (found is not None) == named


def test_an_encoder_that_rests_has_not_stuck():
    """What sticks would expect its reading to the bit, which the unchanged robot has noise in."""
    for seed in range(5):
        rng, trial = np.random.default_rng(seed), Trial(CHANGES[3:], LEARNED)
        while not trial.over:
            missed = np.tile(SIGMA * rng.standard_normal(READINGS), (len(trial.rows), 1))
            missed[1:, :3] = 0.0
            trial.step(missed, SIGMA, slopes(0), 0)
        assert trial.finding is None


def test_what_sticks_explains_all_that_is_no_noise():
    """Another change explains all but a twenty-fifth of it, which is more than noise."""
    near = Change("supply", "1", CHANGES[3].direction, 0.5, 1, most=0.96)
    true = BEFORE + CHANGES[3].direction
    found, _ = tried(Trial([near, CHANGES[3]], LEARNED), true, strength=10.0)
    assert found is not None and found.name == "stuck"


def test_where_the_unchanged_robot_explains_what_is_measured_nothing_is_named():
    for seed in range(8):
        trial = Trial(CHANGES, LEARNED)
        found, tick = tried(trial, BEFORE, seed)
        assert found is None
        assert 25 * (3 + 16) - 1 <= tick < 25 * (3 + 16 + 2 * 4)


def test_what_explains_each_second_a_little_better_only_is_not_named():
    """However long it does, as no model is a robot."""
    true = BEFORE + 1.5 * CHANGES[2].direction
    for needed, named in ((0.3, True), (7.5, False)):
        config = TrialConfig(needed=needed)
        found, _ = tried(Trial(CHANGES, LEARNED, config), true, seed=1, strength=0.1)
        assert (found is not None) is named


@pytest.mark.parametrize(
    ("missed", "left", "name"),
    [(0.8, 0.6, "load"), (0.8, 0.8, None), (1.0, 0.8, None), (1.2, 0.8, UNKNOWN)],
)
def test_what_explains_less_than_half_of_what_is_missed_is_not_named(missed, left, name):
    """And is unknown where what it leaves is strange; a load of 1 leaves this share of it."""
    trial = Trial(CHANGES[:1], LEARNED, TrialConfig(needed=1.0))
    while not trial.over:
        loads = (trial.rows - BEFORE)[:, :1]
        by = missed * np.minimum(1.0, left + np.abs(loads - 1.0))
        trial.step(by * SIGMA * np.ones(READINGS), SIGMA, slopes(0), 0)
    assert (trial.finding and trial.finding.name) == name


def test_a_change_that_is_hardly_any_is_learned_and_not_named():
    """A tenth of how large it may well be, though it is seen beyond doubt."""
    for share, named in ((0.1, False), (1.0, True)):
        trial = Trial(CHANGES[:1], LEARNED, TrialConfig(needed=0.5))
        found, _ = tried(trial, BEFORE + [share, 0.0, 0.0, 0.0], seed=2)
        assert (found is not None) is named
        assert trial._likely.max() > trial._likely[0] + 4.0


def test_what_none_of_them_explains_is_unknown():
    names = list[str]()
    for seed in range(10):
        trial = Trial(CHANGES, LEARNED, TrialConfig(needed=1.0))
        found, _ = tried(trial, BEFORE + [0.8, 0.0, 0.0, 0.0], seed, knocked=3.0)
        names += [found.name] if found is not None else []
    assert set(names) == {UNKNOWN} and len(names) >= 8  # noqa: PLR2004


def test_what_is_strange_for_a_while_only_was_a_stone():
    """All that is tried out misses by 6 deviations, a load of 1 by 4.5, for six blocks or more."""
    for blocks, name in ((6, None), (100, UNKNOWN)):
        trial, tick = Trial(CHANGES[:1], LEARNED, TrialConfig(needed=1.0)), 0
        while not trial.over:
            loads = (trial.rows - BEFORE)[:, :1]
            by = np.where(loads > 0.0, 4.5 + 0.2 * np.abs(loads - 1.0), 6.0)
            missed = by * SIGMA * (tick < 25 * blocks)
            trial.step(missed, SIGMA, slopes(tick), 0)
            tick += 1
        assert (trial.finding and trial.finding.name) == name


def test_a_size_is_known_no_better_than_what_looks_like_it_was_before():
    """Two deviations that no reading tells apart: what is not known of one is not of the other."""
    known = LEARNED.covariance.copy()
    known[1, 1] = 0.2**2
    alike = Change("alike", "1", np.eye(COUNT)[0], 1.0)
    sigmas = []
    for covariance in (LEARNED.covariance, known):
        trial = Trial([alike], LEARNED._replace(covariance=covariance))
        rng = np.random.default_rng(3)
        while not trial.over:
            row = SIGMA * rng.uniform(0.5, 1.0, READINGS)
            same = np.vstack([row, row, 0.0 * row, 0.0 * row])
            missed = (BEFORE + [1.0, 0.0, 0.0, 0.0] - trial.rows) @ same
            trial.step(missed + SIGMA * rng.standard_normal(READINGS), SIGMA, same, 0)
        assert trial.finding is not None
        sigmas.append(trial.finding.sigma)
    assert sigmas[1] == pytest.approx(np.hypot(sigmas[0], 0.2), rel=0.01)
    assert sigmas[0] > 0.09  # By what models miss.  # noqa: PLR2004


def test_sizes_are_of_the_changes_sign_and_no_larger_than_there_may_be():
    trial = Trial(CHANGES[1:], LEARNED)
    sizes = (trial.rows - BEFORE)[:, 1]
    assert np.all(sizes <= 0.0) and sizes.min() == pytest.approx(-1.0)
    assert np.sign((trial.rows - BEFORE)[:, 2].round(9)).sum() == 0.0
    np.testing.assert_allclose((trial.rows - BEFORE)[-1], [0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(trial.rows[0], BEFORE)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_mean_size_of_a_lognormal_likelihood_is_its_mean_and_deviation(sign):
    sizes = np.geomspace(0.1, 10.0, 400)
    likely = 3.0 - 0.5 * (np.log(sizes / 1.3) / 0.2) ** 2
    mean = 1.3 * np.exp(0.5 * 0.2**2)
    sigma = mean * np.sqrt(np.exp(0.2**2) - 1.0)
    assert mean_size(sign * sizes, likely) == pytest.approx((sign * mean, sigma), rel=1e-3)
    assert mean_size(np.array([sign]), np.array([-4.0])) == (sign, 0.0)


def test_a_size_between_two_that_are_tried_out_misses_what_lies_between():
    """Half way between the first part's sizes: both miss 8 deviations, to either side."""
    trial, tick = Trial(CHANGES[:1], LEARNED), 0
    first = trial.rows
    while trial.rows is first:
        missed = 16.0 * SIGMA * (1.5 - (trial.rows - BEFORE)[:, :1]) * np.ones(READINGS)
        trial.step(missed, SIGMA, slopes(tick), 0)
        tick += 1
    found = (trial.rows - BEFORE)[1:, 0]
    assert found[1] == pytest.approx(1.5, rel=0.03)


def test_what_the_copies_miss_as_they_begin_counts_for_nothing():
    """All copies with a load miss 60 deviations in the first block; a spring explains some."""
    trial, tick = Trial(CHANGES[:2], LEARNED), 0
    while not trial.over:
        loads, springs = (trial.rows - BEFORE).T[:2, :, None]
        by = 1.5 * (1.0 - loads) + springs - 60.0 * (loads > 0.0) * (tick < 25)
        trial.step(by * SIGMA * np.ones(READINGS), SIGMA, slopes(tick), 0)
        tick += 1
    assert trial.finding is not None and trial.finding.name == "load"
    assert trial.finding.size == pytest.approx(1.0, abs=0.05)


def test_a_first_part_that_counts_nothing_is_refused():
    with pytest.raises(ValueError, match="trial first = 2: expected more blocks than the 2"):
        TrialConfig(first=2, settling=2)


def test_what_readings_are_off_by_for_good_is_no_change():
    off = np.array([0.0, 4.0, 0.0, -3.0, 0.0, 0.0])
    learned = LEARNED._replace(offsets=off)
    for size, name in ((0.0, None), (1.3, "load")):
        trial, rng = Trial(CHANGES, learned), np.random.default_rng(4)
        tick = 0
        while not trial.over:
            true = BEFORE + size * CHANGES[0].direction
            missed = (true - trial.rows) @ slopes(tick) + off * SIGMA
            noise = SIGMA * rng.standard_normal(READINGS)
            trial.step(missed + noise, SIGMA, slopes(tick), 0)
            tick += 1
        assert (trial.finding and trial.finding.name) == name


def test_a_later_part_begins_where_the_nearest_copy_of_the_same_change_was():
    trial, rng = Trial(CHANGES[:2], LEARNED), np.random.default_rng(5)
    first, true = trial.rows, BEFORE + [1.3, 0.0, 0.0, 0.0]
    assert trial.begin is None
    tick = 0
    while trial.rows is first:
        missed = (true - trial.rows) @ slopes(tick) + SIGMA * rng.standard_normal(READINGS)
        trial.step(missed, SIGMA, slopes(tick), 0)
        tick += 1
    begun, later = first[trial.begin] - BEFORE, trial.rows - BEFORE
    np.testing.assert_array_equal(begun[0], 0.0)
    # Sizes of the first part are 0.2, 0.5, 1, 2 and 5.
    assert np.all(begun[later[:, 0] > 0.0][:, 0] == pytest.approx(1.0))
    assert np.all((begun[1:] != 0.0) == (later[1:] != 0.0))
