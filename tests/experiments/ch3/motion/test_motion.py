"""How motion error accumulates: geometry, sweep and figures, and a short rendered sequence."""

import json

import numpy as np
import pytest

from experiments.ch3.motion.figures import tracking_figure
from experiments.ch3.motion.motion import (
    DEPTH_SHARE,
    PERSISTENT,
    CameraTrial,
    accumulate,
    draw_motion,
    follow_by_map,
    follow_by_motions,
    measure_motion,
    points_in_both_views,
)
from experiments.ch3.stereo.scene import HEAD
from experiments.harness import contract
from experiments.harness.output import Output
from perception.registration.motion import SOLVERS


def test_fiducials_are_in_both_views_at_the_range():
    rng = np.random.default_rng(1)
    path = draw_motion(rng, 10, 1.1)
    for last, pose in zip(path[:-1], path[1:]):
        motion = last.inv() * pose
        points = points_in_both_views(rng, motion, 1.1, 6)
        assert points.shape == (6, 3)
        assert np.abs(points[:, 2] / 1.1 - 1.0).max() <= DEPTH_SHARE + 1e-9
        for view in (points, motion.apply(points, inverse=True)):
            seen = HEAD.project(view)
            assert ((seen[:, 0] > 0) & (seen[:, 0] < HEAD.width)).all()
            assert ((seen[:, 1] > 0) & (seen[:, 1] < HEAD.height)).all()


def test_without_noise_nothing_accumulates():
    rng = np.random.default_rng(2)
    path = draw_motion(rng, 3, 1.1)
    chained = follow_by_motions(path, 1.1, 8, 1e-7, rng)
    mapped = follow_by_map(path, 1.1, 8, 1e-7, rng)
    for errors in (*(chained.errors[solver] for solver in SOLVERS), mapped.errors[PERSISTENT]):
        assert errors.max() < 0.01  # [mm]


def test_same_seed_same_errors_and_ml_beats_linear():
    config = CameraTrial(5, "1100mm", 6, 0.25, steps=8)
    first, second = accumulate(config), accumulate(config)
    for name, values in first.errors.items():
        np.testing.assert_array_equal(values, second.errors[name])
    assert first.errors["ml"].mean() < 0.2 * first.errors["linear"].mean()
    assert first.errors[PERSISTENT][-3:].mean() < first.errors["kabsch"][-3:].mean()


@pytest.mark.slow
def test_run_measures_what_the_contract_names(tmp_path):
    output = Output(
        "ch3-motion", options := contract.RepeatedOptions(out=tmp_path, seeds=2, jobs=1, quick=True)
    )
    measure_motion(options, output)
    output.finish()
    metrics = json.loads((tmp_path / "ch3-motion" / "metrics.json").read_text())
    measured = metrics["measured"]
    for solver in (*SOLVERS, PERSISTENT):
        for name in ("1100mm", "350mm"):
            for steps in (1, 5, 15):
                assert measured[f"motion_error_mm/{solver}/{name}/{steps}"]["n"] == 2
    assert 0.0 < measured["motion_error_ratio/ml_over_linear"] < 1.0
    assert len(metrics["checks"]) == 3
    assert (tmp_path / "ch3-motion" / "figures" / "figure_3-24.png").exists()


@pytest.mark.slow
def test_rendered_fiducials_are_tracked_and_give_the_motion():
    from experiments.ch3.motion.rendered import RenderedTrial, follow_rendered  # noqa: PLC0415

    result = follow_rendered(RenderedTrial(3, "350mm", steps=2))
    assert len(result.tracking) >= 0.6 * result.sought
    assert np.median(np.abs(result.tracking)) < 0.06
    assert result.errors["ml"].max() < 2.0  # [mm]
    assert result.errors[PERSISTENT].max() < 2.0
    figure = tracking_figure(list(result.images), result.with_previous, result.with_next)
    squares = [line for axes in figure.axes for line in axes.lines if line.get_marker() == "s"]
    circles = [line for axes in figure.axes for line in axes.lines if line.get_marker() == "o"]
    assert len(squares) == len(circles) == 2
