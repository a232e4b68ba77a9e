"""The open-loop drive heats the right bundles, in groups, and lets them cool."""

import numpy as np
import pytest

from controllers.braid.bus.drive import (
    EXTEND,
    RETRACT,
    DriveConfig,
    WireDrive,
    word_bits,
)


def test_bits_of_a_word_are_its_binary_digits_lowest_first():
    words = np.arange(8)
    assert (word_bits(words) @ [1, 2, 4]).tolist() == words.tolist()
    assert word_bits(np.array([5])).tolist() == [[True, False, True]]


@pytest.mark.parametrize("at_once", [1, 2, 3, 15])
def test_over_a_change_each_leg_that_differs_is_heated_once_in_its_direction(at_once):
    rng = np.random.default_rng(at_once)
    before, after = rng.integers(0, 8, 5), rng.integers(0, 8, 5)
    config = DriveConfig(heating=1.0, cooling=2.0, at_once=at_once)
    drive = WireDrive(before, config)
    drive.change(after)
    changed = int(np.count_nonzero(word_bits(before) != word_bits(after)))
    assert drive.duration == -(-changed // at_once) * 1.0 + 2.0
    total = np.zeros((5, 3, 2))
    for turn in range(int(drive.duration)):
        levels = drive.levels(turn + 0.5)
        assert np.count_nonzero(levels) <= at_once
        total += levels
    rises = word_bits(after) & ~word_bits(before)
    falls = word_bits(before) & ~word_bits(after)
    np.testing.assert_array_equal(total[..., EXTEND], rises)
    np.testing.assert_array_equal(total[..., RETRACT], falls)


def test_the_tip_is_switched_before_the_base_and_nothing_is_heated_while_cooling():
    drive = WireDrive(np.zeros(4, dtype=int))
    drive.change(np.array([7, 0, 0, 7]))
    assert np.flatnonzero(drive.levels(0.1).any(axis=(1, 2))).tolist() == [3]
    assert np.flatnonzero(drive.levels(1.2).any(axis=(1, 2))).tolist() == [0]
    assert not drive.levels(-0.1).any()
    assert not drive.levels(2.3).any()


def test_no_change_takes_no_time():
    drive = WireDrive(np.array([3, 4]))
    drive.change(np.array([3, 4]))
    assert drive.duration == 0.0
    assert not drive.levels(0.0).any()


@pytest.mark.parametrize("word", [[8], [-1], []])
def test_words_of_other_than_eight_states_are_refused(word):
    with pytest.raises(ValueError, match="expected states 0 to 7"):
        WireDrive(np.array(word, dtype=int))


def test_words_of_another_length_are_refused():
    with pytest.raises(ValueError, match="word of 3 stages: expected 2"):
        WireDrive(np.array([0, 0])).change(np.array([1, 2, 3]))


@pytest.mark.parametrize(
    ("name", "value"), [("heating", 0.0), ("cooling", -1.0), ("heating", np.nan), ("at_once", 0)]
)
def test_times_that_would_never_switch_a_leg_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        DriveConfig(**{name: value})
