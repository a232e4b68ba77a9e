"""Appendix C: Table C-1 on real pictures, and pictures that a map expects."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")

import json

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from experiments.__main__ import main
from experiments.appc.compression import TABLE_C_1
from experiments.appc.pictures import (
    DRAWINGS,
    SIZES,
    bundled_pictures,
    ratios,
    resampled,
    smoothed,
)
from experiments.appc.views import expected_pictures
from perception.compression.image_predictors import PREDICTORS
from perception.voxels.occupancy import State
from perception.voxels.views import PlanningGrid

REACH = (0.25, 2.0)


def mean_ratios(pictures, size):
    return np.mean([ratios(resampled(picture, size)) for picture in pictures], axis=0)


def best(means):
    return PREDICTORS[int(np.argmax(means[: len(PREDICTORS)]))]


def test_bundled_pictures_agree_with_the_thesis_at_both_ends_of_its_table():
    pictures = bundled_pictures()
    assert len(pictures) == 20 and DRAWINGS < set(pictures)
    small = mean_ratios(pictures.values(), 16)
    assert np.abs(small - np.array(TABLE_C_1)[:, 0]).max() <= 0.05
    assert best(mean_ratios(pictures.values(), 256)) == 5


def test_method_5_wins_on_photographs_only_without_their_noise():
    """It adds up the noise of three pixels, method 8 halves that of two."""
    photographs = [image for name, image in bundled_pictures().items() if name not in DRAWINGS]
    fine = [resampled(image, 256) for image in photographs]
    assert best(mean_ratios(fine, 256)) != 5
    assert best(mean_ratios([smoothed(image) for image in fine], 256)) == 5


def looking_along_y() -> RigidTransform:
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return RigidTransform.from_matrix(matrix)


def test_a_wall_is_expected_where_it_is():
    states = np.full((40, 40, 40), State.FREE, np.int8)
    grid = PlanningGrid(np.array([-1.0, -0.5, -1.0]), 0.05, states)
    states[:, 30, :] = State.OCCUPIED  # from y = 1.0
    occupancy = (states == State.OCCUPIED).astype(float)
    rays = np.array([[0.0, 0.0, 1.0]] * 4)
    depth, unknown = expected_pictures(grid, occupancy, looking_along_y(), rays, REACH)
    assert depth.shape == (2, 2) and not unknown.any()
    assert np.abs(depth / 255.0 * REACH[1] - 1.0).max() < 0.05


def test_rays_end_in_the_unknown_as_often_as_its_cells_are_full():
    states = np.full((40, 40, 40), State.UNKNOWN, np.int8)
    grid = PlanningGrid(np.array([-1.0, -0.5, -1.0]), 0.05, states)
    rays = np.array([[0.0, 0.0, 1.0]])
    _, unknown = expected_pictures(
        grid, np.full(states.shape, 0.02), looking_along_y(), rays, REACH
    )
    cells = (1.5 - REACH[0]) / 0.05
    assert unknown[0, 0] / 255.0 == pytest.approx(1.0 - 0.98**cells, abs=0.02)


def test_too_few_views_are_named(capsys, tmp_path):
    assert main(["appc-compression", "--views", "3", "--out", str(tmp_path)]) == 2
    assert "--views 3: expected at least 8" in capsys.readouterr().err


@pytest.mark.slow
def test_predictors_are_timed_beside_numpy_and_tiles_coded_beside_zlib(tmp_path):
    assert main(["bench", "--only", "compression", "--quick", "--out", str(tmp_path)]) == 0
    measured = json.loads((tmp_path / "bench" / "metrics.json").read_text())["measured"]
    assert all(measured[f"predictor_ratio/{method}"]["n"] == 21 for method in PREDICTORS)
    assert measured["tile_silent_damages"] == 0
    assert measured["tile_bytes/coded"] < 0.65 * measured["tile_bytes/plain/zlib"]


@pytest.mark.slow
def test_whole_experiment(tmp_path):
    words = ["appc-compression", "--quick", "--views", "5", "--jobs", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    metrics = json.loads((tmp_path / "appc-compression" / "metrics.json").read_text())
    measured = metrics["measured"]
    assert measured["round_trip_failures"] == 0
    # 20 bundled, 5 rendered and 20 of noise; nine methods in four codes, and Huffman's alone.
    assert measured["round_trips"] == (20 + 5 + 20) * len(SIZES) * 37
    assert metrics["thesis"]["ratio/5/256"] == 1.723
    assert measured["view_decisions"] == 2
    for name in ("figure_C-2", "predictors", "views"):
        assert (tmp_path / "appc-compression" / "figures" / f"{name}.png").stat().st_size > 10000
