"""Cooperative stereo: the drawn runs, what is stored, and one rendered scene."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")

import json

import numpy as np
import pytest

from experiments.ch3.motion import cooperative as ch3_cooperative
from experiments.ch3.motion import cooperative_rendered as ch3_cooperative_rendered
from experiments.ch3.motion.cooperative import (
    CASES,
    JOINT,
    NOISE,
    CooperativeTrial,
    report_cases,
    triangulate_drawn,
)
from experiments.ch3.motion.cooperative_rendered import (
    RenderedPair,
    triangulate_rendered,
)
from experiments.ch3.motion.scores import Triangulated
from experiments.harness.contract import RepeatedOptions
from experiments.harness.output import Output


@pytest.fixture(scope="module")
def drawn() -> dict[str, list[Triangulated]]:
    return {n: [triangulate_drawn(CooperativeTrial(s, n)) for s in range(12)] for n in NOISE}


def median(results: list[Triangulated], case: str) -> float:
    return float(np.median([result.errors[case] for result in results]))


def test_same_seed_same_errors():
    first, second = (triangulate_drawn(CooperativeTrial(3, "0.25px")) for _ in range(2))
    assert first.errors == second.errors


def test_depth_error_of_one_robot_agrees_with_equation_3_6(drawn):
    depth = 1.1**2 / (677.34 * 0.038) * 1000.0  # [mm/px]
    assert median(drawn["0.25px"], "single") == pytest.approx(0.25 * depth, rel=0.25)


@pytest.mark.parametrize("noise", NOISE)
def test_two_robots_are_better_and_the_relative_pose_is_what_limits_them(drawn, noise):
    error = {case: median(drawn[noise], case) for case in CASES}
    assert error["fused"] < 0.6 * error["single"]
    assert error["bundle_20"] < error["bundle_6"] < 0.6 * error["single"]
    assert error["perfect"] < min(error[case] for case in CASES if case != "perfect")


@pytest.mark.parametrize("case", JOINT)
def test_points_are_as_certain_as_they_say(drawn, case):
    values = [result.nees[case] for results in drawn.values() for result in results]
    assert 0.6 < np.mean(values) < 1.5


def test_failures_are_counted_and_checks_made(tmp_path):
    output = Output("cooperation", RepeatedOptions(out=tmp_path))
    runs = [
        Triangulated({"single": 10.0, "bundle_6": 4.0}, {"single": np.nan, "bundle_6": 3.0}),
        Triangulated({"single": 12.0, "bundle_6": np.inf}, {"single": np.nan, "bundle_6": np.nan}),
        Triangulated({"single": 11.0, "bundle_6": 5.0}, {"single": np.nan, "bundle_6": 2.0}),
    ]
    rows = report_cases(runs, "0.25px", output)
    measured = output.metrics()["measured"]
    assert measured["cooperative_failed_fraction/bundle_6/0.25px"]["median"] == pytest.approx(1 / 3)
    assert measured["cooperative_gain/bundle_6/0.25px"] == pytest.approx(11.0 / 5.0)
    (check,) = output.metrics()["checks"]
    assert check["value"] == 2.5 and not check["ok"]
    assert [row[:3] for row in rows] == [["0.25px", "single", 11.0], ["0.25px", "bundle_6", 5.0]]


@pytest.fixture(scope="module")
def rendered() -> RenderedPair:
    return triangulate_rendered(4)


@pytest.mark.slow
def test_natural_points_are_matched_across_two_robots_and_better_than_by_one(rendered):
    assert len(rendered.matches) > 60
    assert rendered.agreed.mean() > 0.85
    assert not rendered.gross.any()
    assert rendered.errors["bundle"] < 0.5 * rendered.errors["single"]
    assert rendered.errors["perfect"] < 0.3  # [mm]
    assert rendered.baseline_m > 0.5
    assert np.abs(rendered.marker_errors).max() < 0.3  # [px]


@pytest.mark.slow
def test_run_measures_what_the_contract_names(tmp_path, rendered, monkeypatch):
    options = RepeatedOptions(out=tmp_path, seeds=2, jobs=1, quick=True)
    real = ch3_cooperative_rendered.sweep

    def swept(function, configs, *rest, **named):
        if function is triangulate_rendered:
            return [rendered for _ in configs]  # Once is enough.
        return real(function, configs, *rest, **named)

    monkeypatch.setattr(ch3_cooperative_rendered, "sweep", swept)
    output = Output("cooperation", options)
    ch3_cooperative.measure_cooperation(options, output)
    output.finish()
    measured = json.loads((tmp_path / "cooperation" / "metrics.json").read_text())["measured"]
    for noise in NOISE:
        for case in CASES:
            assert measured[f"cooperative_error_mm/{case}/{noise}"]["n"] == 2
    for case in ch3_cooperative_rendered.CASES:
        assert measured[f"cooperative_error_mm/{case}/rendered"]["n"] == 2
    assert (tmp_path / "cooperation" / "figures" / "cooperative_stereo.png").is_file()
    assert (tmp_path / "cooperation" / "tables" / "cooperative_stereo.csv").is_file()
