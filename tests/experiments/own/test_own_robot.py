"""Foreign robots: how they are logged, how results are scored, and a peer on the same log."""

import dataclasses
import json

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.own.hidden import own_robot
from experiments.own.hidden.hidden_robots import KINDS, PERIOD, drawn_coordinates, logged
from experiments.own.hidden.motions import Chirp, fitted, series_of
from experiments.own.hidden.own_robot import Found, RobotResult, RobotTrial
from experiments.own.hidden.peer import fit_by_peer
from twin.prediction.limits import Limits


def test_a_delay_shifts_what_a_robot_reads():
    kind = dataclasses.replace(KINDS["cart"], parameters=("delay",), planted=())
    stamps = np.arange(0.0, 2.0, 0.002)
    push = 5.0 * np.sin(9.0 * stamps)[:, None] * np.minimum(stamps, 1.0)[:, None]
    early, late = (
        logged(kind, np.array([at]), push, np.random.default_rng(4)).signals["rail_encoder"]
        for at in (0.0, 0.5)
    )
    assert np.all(np.diff(early.stamps) > 0.007) and np.ptp(np.diff(early.stamps)) > 1e-3
    shifted = np.interp(late.stamps - 0.01, early.stamps, early.values[:, 0])
    np.testing.assert_allclose(late.values[3:, 0], shifted[3:], atol=6e-4)
    assert np.abs(late.values[3:, 0] - early.values[3:, 0]).max() > 5e-3


def test_compared_motions_are_as_large_as_the_limits_allow_and_begin_at_rest():
    kind = KINDS["arm"]
    model = kind.spec().compile()
    limits = Limits.of_model(model)
    series = series_of(kind, 4.0)
    chirp = Chirp(series.home, 4.0, kind.highest)
    shapes = (series, series.random(np.random.default_rng(1))), (chirp, np.ones(1))
    for motion, shape in shapes:
        found = fitted(kind, motion, shape)[:: round(model.opt.timestep / PERIOD)]
        np.testing.assert_allclose(found[0], model.key_ctrl[0])
        assert 0.9 < limits.excess(model, found) <= 1.001


def result(off, covariance, doubts=()):
    count = len(off)
    found = Found(
        np.array(off), np.array(covariance), np.ones(count, bool), np.ones(count, bool), doubts,
        0.1, 1.0, 1.0,
    )  # fmt: skip
    trial = RobotTrial("cart", 0, 4.0, (), ("designed",), False)
    names = tuple(f"p{index}" for index in range(count))
    return RobotResult(trial, names, 0, np.zeros(count), (found,), np.zeros(0), 0.0), found


def test_false_confidence_counts_directions_and_what_is_called_good():
    """Two parameters of which the sum is known to 0.1 and the difference to 10."""
    covariance = [[25.0, -24.995], [-24.995, 25.0]]
    along, found = result([7.0, -7.0], covariance)
    assert not along.false(found)
    across, found = result([0.5, 0.5], covariance)
    assert across.false(found)
    doubted, found = result([0.5, 0.5], covariance, ("no run was held out",))
    assert not doubted.false(found)


def test_pooled_coverage_resamples_robots():
    rows = [np.array([True] * 9 + [False])] * 5 + [np.array([True] * 8 + [False] * 2)] * 5
    found = own_robot._clustered(rows, np.random.default_rng(0))
    assert found["mean"] == pytest.approx(0.85)
    sigma = 0.05 / np.sqrt(10.0)
    assert found["high"] - found["low"] == pytest.approx(2.0 * 1.96 * sigma, rel=0.35)


@pytest.mark.slow
def test_peer_finds_what_we_find_on_a_short_log():
    kind = KINDS["leg"]
    generator = np.random.default_rng(5)
    truth = drawn_coordinates(kind, generator)
    series = series_of(kind, 2.5)
    log = logged(kind, truth, fitted(kind, series, series.random(generator)), generator)
    asked = [each for each in kind.selected() if each.name not in kind.planted]
    found = fit_by_peer(kind.spec(), asked, log)
    told = [index for index, each in enumerate(asked) if "gain" in each.name]
    assert np.abs(found - truth[: len(asked)])[told].max() < 0.05


@pytest.mark.slow
def test_quick_run_scores_one_cart(tmp_path):
    assert main(["own-robot", "--quick", "--jobs", "1", "--out", str(tmp_path)]) == 0
    metrics = json.loads((tmp_path / "own-robot" / "metrics.json").read_text())["measured"]
    assert metrics["named_unidentifiable_fraction"]["mean"] == 1.0
    assert metrics["coverage95"]["n"] == 11
    assert metrics["hold_out_ratio"]["median"] < 0.2
    assert metrics["delay_error_ms"]["median"] < 0.5
    assert metrics["formats_agree"]["mean"] == 1.0
    assert (tmp_path / "own-robot" / "figures" / "deviations.png").stat().st_size > 10_000
    files = {each.name for each in (tmp_path / "own-robot" / "rover").iterdir()}
    assert files == {"drawn.xml", "servo.xml", "limits.toml", "mapping.toml"}
