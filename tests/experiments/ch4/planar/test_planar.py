"""Placement on the plane: its scenes, its measures, and a small run end to end."""

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image

from controllers.placement.planar.search import best_view, rating_field
from experiments.ch4.planar import planar as ch4_planar
from experiments.ch4.planar.motion import MotionTrial, approach, map_site
from experiments.ch4.planar.scenes import random_task, two_instances
from experiments.ch4.planar.trials import (
    HullTrial,
    PlanarSearchTrial,
    compare_searches,
    compare_sights,
    occluded_angles,
)
from experiments.harness.contract import OptionError
from experiments.harness.output import Output


def test_random_obstacles_cover_what_they_should_and_not_the_targets():
    task = random_task(0.2, np.random.default_rng(1))
    covered = np.mean(task.space.probability > 0.5)
    assert 0.2 <= covered < 0.23
    for target in task.targets:
        column, row = target.position.astype(int)
        assert task.space.probability[row, column] <= 0.5
    assert best_view(task).rating > 0.0


def test_fast_search_matches_on_the_experiments_scenes():
    result = compare_searches(PlanarSearchTrial(0.05, 3, 2, 8, 64))
    assert result.matches.tolist() == [1.0, 1.0]
    assert np.all(result.gain >= 1.0 - 1e-12)


def test_hulls_never_see_what_is_hidden():
    counts = compare_sights(HullTrial(2, 150))
    assert counts.false_visible.tolist() == [0, 0]
    assert 0 < counts.given_up.sum() < 0.3 * counts.visible.sum()


def test_occluded_angles_are_those_of_the_corners():
    """A box 8 m wide and 2 m of target: sight from 40 m touches the target's other end."""
    true, hull = occluded_angles(np.array([10.0]), 40.0)[0]
    assert hull == pytest.approx(2.0 * np.arctan2(5.0, 10.0))
    # The line from the target's lower end past the box's upper near corner, on to the circle.
    line = np.array([10.0, 5.0]) / np.hypot(10.0, 5.0)
    start = np.array([0.0, -1.0])
    along = -start @ line + np.sqrt((start @ line) ** 2 - start @ start + 40.0**2)
    end = start + along * line
    assert true == pytest.approx(2.0 * np.arctan2(end[1], end[0]))


def test_first_instance_watches_the_primary_and_second_the_secondary_target():
    assert [best_view(task).target for task in two_instances()] == ["primary", "secondary"]


def test_best_view_is_no_worse_than_any_place_of_the_plane():
    task = two_instances()[1]
    places = np.random.default_rng(3).uniform(0.0, 100.0, (2000, 2))
    assert rating_field(task, places).max() <= best_view(task).rating


@pytest.mark.parametrize(
    ("bad", "text"), [({"factor": 0.9}, "--factor 0.9"), ({"directions": 2}, "directions 2")]
)
def test_bad_options_are_refused(bad, text):
    with pytest.raises(OptionError, match=text):
        ch4_planar.Options(**bad)


@pytest.mark.slow
def test_approaching_panel_turns_the_camera_to_the_secondary_target_without_losing_sight():
    site = map_site(5)
    trial = MotionTrial(5, 1.2)
    result = approach(trial, site)
    assert result.target[0] == 0
    assert result.target[-1] == 1
    assert result.placed == len(result.target)
    assert result.watched == result.placed
    again = approach(dataclasses.replace(trial, factor=1.0), site)
    assert result.moves <= again.moves


@pytest.mark.slow
def test_a_small_run_is_measured(tmp_path):
    options = ch4_planar.Options(
        quick=True, seeds=1, jobs=1, rings=8, directions=64, record=True, out=tmp_path
    )
    output = Output("ch4-planar", options)
    ch4_planar.run(options, output)
    output.finish()
    folder = tmp_path / "ch4-planar"
    measured = json.loads((folder / "metrics.json").read_text())["measured"]
    assert measured["search_match_fraction"] == 1.0
    assert measured["hull_false_visible"] == 0
    assert measured["watched/second_instance"] == "secondary"
    for name in ("figure_4-6", "figure_4-8", "figure_4-10", "figure_4-11", "searches"):
        assert (folder / "figures" / f"{name}.png").is_file()
    assert (folder / "run.rrd").stat().st_size > 1e4
    with Image.open(folder / "approach.gif") as film:
        assert getattr(film, "n_frames", 1) == 25
