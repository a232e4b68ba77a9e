"""Planar worlds, whole runs, and the experiment end to end."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
from scipy import ndimage

from experiments.__main__ import main
from experiments.ch3.planar import planar as ch3_planar
from experiments.ch3.planar import record as ch3_planar_record
from experiments.ch3.planar.explain import merge
from experiments.ch3.planar.trial import PlanarRun, PlanarTrial, build_world, first_at, run_trial
from experiments.ch3.planar.worlds import image_world, indoor_world, make_world, unstructured_world
from experiments.harness.contract import OptionError
from perception.planar.raycast import RangeSensor, scan
from perception.voxels.occupancy import State
from tests.hostile_files import png_of_zeros, run_and_weigh

NARROW = {"fov_deg": 75.0, "depth": 10.0}


@pytest.mark.parametrize("make", [unstructured_world, indoor_world])
def test_worlds_follow_their_seed_and_start_free(make):
    worlds = [make(seed) for seed in (1, 1, 2)]
    assert (worlds[0].occupied == worlds[1].occupied).all()
    assert worlds[0].start == worlds[1].start
    assert (worlds[0].occupied != worlds[2].occupied).any()
    for world in worlds:
        assert world.occupied.shape == (200, 200)
        assert not world.occupied[world.start]
        assert world.visible.mean() > 0.8


def test_all_rooms_of_a_floor_are_connected():
    for seed in range(6):
        _, count = ndimage.label(~indoor_world(seed).occupied)
        assert count == 1


def test_visible_cells_are_those_of_scans_from_everywhere():
    occupied = np.random.default_rng(3).random((24, 25)) < 0.3
    world = make_world(occupied, np.random.default_rng(4))
    reachable, _ = ndimage.label(~occupied)
    reachable = reachable == reachable[world.start]
    seen = np.zeros_like(occupied)
    for r, c in np.argwhere(reachable):
        found = scan(occupied, world.grid, (int(r), int(c)), 0.0, RangeSensor(2 * np.pi, 20.0))
        seen |= found.passed | found.hit
    np.testing.assert_array_equal(seen, world.visible)


@pytest.mark.parametrize("world", ["unstructured", "indoor"])
def test_a_run_without_noise_never_unlearns_and_calls_no_obstacle_free(world):
    trial = PlanarTrial(world, 5, "information", limit=30, **NARROW)
    truth = build_world(trial)
    result = run_trial(trial, truth)
    assert (np.diff(result.fraction) >= 0).all()
    assert (np.diff(result.metres) >= 0).all()
    free, hit = result.states == State.FREE, result.states == State.OCCUPIED
    assert not (free & truth.occupied).any()
    assert not (hit & ~truth.occupied).any()
    assert not ((free | hit) & ~truth.visible).any()
    assert result.fraction[-1] > 0.08
    assert result.called_wrong == 0.0 and result.bumps == 0
    cells = result.paths[:, 1:]
    assert not truth.occupied[cells[:, 0], cells[:, 1]].any()


def test_same_seed_gives_the_same_run():
    trial = PlanarTrial("indoor", 6, "information", limit=8, robots=2, noise=0.001, **NARROW)
    first, again = (run_trial(trial, build_world(trial)) for _ in range(2))
    for key in ("fraction", "metres", "states", "paths", "stops"):
        np.testing.assert_array_equal(getattr(first, key), getattr(again, key))


def test_noisy_ranges_mistake_cells_and_robots_still_keep_out_of_obstacles():
    trial = PlanarTrial("indoor", 7, "information", limit=25, noise=0.003, **NARROW)
    world = build_world(trial)
    result = run_trial(trial, world)
    assert 0.0 < result.called_wrong < 0.2
    cells = result.paths[:, 1:]
    assert not world.occupied[cells[:, 0], cells[:, 1]].any()


def test_information_moves_far_less_than_max_new():
    found = {}
    for method in ("information", "max_new"):
        trial = PlanarTrial("unstructured", 8, method, limit=35)
        found[method] = run_trial(trial, build_world(trial))
    ours, theirs = found["information"], found["max_new"]
    assert ours.metres[-1] < 0.4 * theirs.metres[-1]
    assert ours.fraction[-1] > 0.6 * theirs.fraction[-1]


def test_a_small_room_is_mapped_completely_and_the_run_ends(tmp_path):
    world = image_world(picture(tmp_path, np.pad(np.full((30, 40), 255), 1)), 1)
    trial = PlanarTrial("room", 1, "information", limit=200)
    result = run_trial(trial, world)
    assert result.fraction[-1] == 1.0
    assert len(result.fraction) < 30
    assert first_at(result)[0] <= len(result.fraction)


def picture(folder, pixels):
    path = folder / "floor.png"
    cv2.imwrite(str(path), np.asarray(pixels, dtype=np.uint8))
    return path


def test_a_picture_is_a_world_with_its_top_far_away(tmp_path):
    pixels = np.full((60, 80), 255)
    pixels[:10] = 0
    world = image_world(picture(tmp_path, pixels), 1)
    assert world.occupied.shape == (60, 80)
    assert world.occupied[-10:].all() and not world.occupied[:-10].any()


def test_thin_walls_survive_shrinking(tmp_path):
    pixels = np.full((800, 800), 255)
    pixels[:, 400:402] = 0
    world = image_world(picture(tmp_path, pixels), 1, pixel=0.05)
    assert world.occupied.shape == (200, 200)
    assert world.grid.columns * world.grid.cell == pytest.approx(800 * 0.05)
    assert world.occupied.any(axis=1).all()


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (np.zeros((50, 50)), "no free start"),
        (np.indices((50, 50)).sum(axis=0) % 2 * 255, "no free start: the largest .* 1 cells"),
        (np.full((5, 50), 255), "50 x 5 pixels"),
    ],
)
def test_pictures_that_cannot_be_mapped_are_refused(tmp_path, pixels, message):
    with pytest.raises(OptionError, match=message):
        image_world(picture(tmp_path, pixels), 1)


def test_files_that_are_no_picture_are_refused(tmp_path):
    with pytest.raises(OptionError, match="No such file"):
        image_world(tmp_path / "none.png", 1)
    (tmp_path / "text.png").write_text("not a picture")
    with pytest.raises(OptionError, match="not a picture"):
        image_world(tmp_path / "text.png", 1)


def test_picture_of_many_pixels_is_refused_before_it_takes_their_memory(tmp_path):
    path = tmp_path / "bomb.png"
    path.write_bytes(png_of_zeros(12_000, 12_000))
    said, grown = run_and_weigh(
        "from pathlib import Path\nfrom experiments.ch3.planar.worlds import image_world",
        f"try: image_world(Path({str(path)!r}), 1)\nexcept ValueError as error: print(error)",
    )
    size = "144,000,000 pixels (12000 x 12000), the limit is 33,554,432"
    assert said == f"--world {path}: too large: {size}"
    assert grown < 50.0  # Decoded it takes 826 MB.


def test_bad_options_are_refused():
    for change, message in (
        ({"methods": ("greedy",)}, "--methods greedy"),
        ({"reading": "grey"}, "--reading 'grey'"),
        ({"utility": "free"}, "--utility 'free'"),
        ({"fov": 400.0}, "--fov"),
        ({"depth": -1.0}, "--depth"),
        ({"noise": -1.0}, "--noise"),
    ):
        with pytest.raises(OptionError, match=message):
            dataclasses.replace(ch3_planar.Options(), **change)


def test_merging_is_the_product_of_gaussians():
    generator = np.random.default_rng(9)
    covariances = [a @ a.T + np.eye(2) for a in generator.normal(size=(2, 2, 2))]
    means = generator.normal(size=(2, 2))
    mean, covariance = merge(means[0], covariances[0], means[1], covariances[1])
    weights = [np.linalg.inv(s) for s in covariances]
    expected = np.linalg.inv(weights[0] + weights[1])
    np.testing.assert_allclose(covariance, expected, rtol=1e-10)
    np.testing.assert_allclose(
        mean, expected @ (weights[0] @ means[0] + weights[1] @ means[1]), rtol=1e-10
    )


def test_runs_that_never_arrive_count_as_infinite():
    none = np.empty(0)
    fraction, metres = np.array([0.2, 0.5]), np.array([0.0, 3.0])
    result = PlanarRun(fraction, metres, none, none, none, none, 0.0, 0)
    assert first_at(result) == (np.inf, np.inf)
    assert first_at(result, 0.5) == (2.0, 3.0)


def test_a_recording_holds_the_run(tmp_path):
    trial = PlanarTrial("indoor", 9, "information", limit=3, robots=2, **NARROW)
    ch3_planar_record.record_trial(trial, tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").stat().st_size > 5_000


@pytest.mark.slow
def test_a_picture_is_mapped_from_the_command_line(tmp_path):
    pixels = np.full((60, 80), 255)
    pixels[:, 40] = 0
    pixels[20:24, 40] = 255
    words = ["ch3-planar", "--world", str(picture(tmp_path, pixels)), "--seeds", "1", "--jobs", "1"]
    words += ["--methods", "information", "--explain", "--record"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    folder = tmp_path / "ch3-planar"
    measured = json.loads((folder / "metrics.json").read_text())["measured"]
    assert measured["scans_to_90_picture/information"]["median"] < 60
    assert measured["called_wrong_fraction"]["median"] == 0.0
    names = {path.stem for path in (folder / "figures").glob("*.png")}
    assert names >= {"picture_curves", "picture_maps", "picture_paths", "figure_3-6", "figure_3-8"}
    assert (folder / "run.rrd").stat().st_size > 5_000


def test_a_missing_picture_ends_with_status_2(tmp_path, capsys):
    words = ["ch3-planar", "--world", str(tmp_path / "none.png"), "--out", str(tmp_path)]
    assert main(words) == 2
    assert "No such file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--pixel", "0.1"], "--pixel: needs --world"),
        (["--fov", "60"], "--fov: needs --world"),
        (["--depth", "4"], "--depth: needs --world"),
        (["--world", "plan.png", "--pixel", "0"], "--pixel: expected 0.001 to 100 m"),
        (["--world", "plan.png", "--pixel", "nan"], "--pixel: expected 0.001 to 100 m"),
        (["--world", "plan.png", "--fov", "0"], "--fov: expected more than 0"),
        (["--world", ".", "--seeds", "1"], "--world .: Is a directory"),
    ],
)
def test_what_cannot_be_mapped_is_one_line_and_status_2(words, message, tmp_path, capsys):
    assert main(["ch3-planar", *words, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and message in error


def test_a_large_plan_is_said_to_be_shrunk_and_how_large_its_cells_are(tmp_path, capsys):
    (seed,) = ch3_planar.Options(seeds=1).job_seeds(1, 1)
    for size, said in (
        (60, "60 x 60 cells of 0.05 m\n"),
        (400, "200 x 200 cells of 0.1 m (shrunk: it has more pixels)\n"),
    ):
        plan = picture(tmp_path, np.full((size, size), 255))
        ch3_planar._examine_plan(ch3_planar.Options(world=plan, pixel=0.05), seed)
        assert capsys.readouterr().err == f"{plan}: {said}"
