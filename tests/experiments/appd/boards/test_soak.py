"""The soak finds wrong values, false words and processes that grow, and a short one finds none."""

import types

import numpy as np
import pytest

from experiments.appd.boards import soak
from experiments.appd.boards.soak import WITHIN, SoakTrial, _Soak, growth, run_soak
from tests.twin.hardware.board_tables import CALIBRATION
from twin.robot import MISSING, Channel, Validity

COUNT = 1.0 / np.abs(CALIBRATION.drive.counts_per_radian)


def test_growth_is_from_when_the_process_was_warm_to_the_end():
    memory = np.concatenate([np.linspace(50.0, 100.0, 100), np.full(800, 100.0), np.full(100, 103)])
    assert growth(memory) == pytest.approx(0.03)
    assert growth(np.linspace(100.0, 110.0, 1000)) == pytest.approx(8.0 / 101.5, rel=0.01)
    assert growth(np.array([1.0, *[2.0] * 9])) == 0.0


@pytest.mark.parametrize(("off", "wrong"), [(0.0, 0), (1.9, 0), (2.1, 1), (-300.0, 1)])
def test_angle_that_is_off_by_more_than_two_counts_is_wrong(off, wrong):
    looked = _Soak(None, np.random.default_rng(0), 0.0)
    angles = np.zeros((3, 8))
    angles[:, 6] = 0.1, 0.2, 0.3
    read = np.array([0.0, 0.0, 0.2 + off * COUNT[6], 0.0])
    looked._compare(Channel(read, 0.0, Validity.MEASURED), MISSING, angles, COUNT)
    looked._compare(Channel(read + 1.0, 0.0, Validity.STALE), MISSING, angles, COUNT)
    assert looked._wrong.total() == wrong


def test_speed_that_no_two_readings_give_is_wrong():
    looked = _Soak(None, np.random.default_rng(0), 0.0)
    angles = 0.05 * np.arange(4.0)[:, None] * np.ones(8)
    for speed in (5.0, 7.0):
        wheels = Channel(np.array([5.0, speed, 5.0, 5.0]), 0.0, Validity.MEASURED)
        looked._compare(MISSING, wheels, angles, COUNT)
    assert looked._wrong == {"none": 1}


@pytest.mark.parametrize(
    ("fault", "false"),
    [
        ("lost; boards 0x80, 0x82: zero confirmed; 0x81: sent, not answered", 0),
        ("lost; boards 0x80, 0x81: zero confirmed; 0x82: sent, not answered", 1),
        ("lost; boards 0x81: not reached; stops by its own timeout", 0),
    ],
)
def test_words_of_boards_that_drive_are_counted(fault, false):
    codes = [0] * 8
    codes[CALIBRATION.drive.boards[0x81][0]] = 9000
    looked = _Soak(types.SimpleNamespace(codes=codes), np.random.default_rng(0), 0.0)
    looked._judge_words(types.SimpleNamespace(fault=fault, calibration=CALIBRATION))
    assert looked._false == false


@pytest.mark.real_time
@pytest.mark.slow
def test_short_soak_finds_nothing(monkeypatch):
    monkeypatch.setattr(soak, "APART", 1.0)
    result = run_soak(SoakTrial(12.0, 5))
    assert not result.wrong and result.false == result.opened == 0
    assert result.zero <= WITHIN and result.cycles > 500 and result.damaged > 0
    assert set(result.faults) & {kind.value for kind in soak.LASTING}
