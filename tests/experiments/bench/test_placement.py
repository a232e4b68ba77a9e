"""The benchmark of placing a camera again, on a map of the scene of chapter 3."""

import json

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.bench.placement import ground_below
from experiments.ch3.stereo.scene import StereoScene
from experiments.ch4.spatial.placement_scene import head_lens, map_scene, panel_targets
from perception.voxels.occupancy import State


def test_map_of_the_scene_has_its_surfaces_and_no_rovers():
    scene = StereoScene(seed=0, texture_pixels=64)
    voxels = map_scene(scene, 2, np.random.default_rng(0), resolution=0.02)
    cells, _ = voxels.occupied_cells()
    centres = voxels.grid.centres(cells)
    assert len(centres) > 500
    for name in scene.robot_names:
        middle = scene.data.body(f"{name}/chassis").xpos
        near = np.linalg.norm(centres - middle, axis=1) < 0.1
        assert np.count_nonzero(near & (centres[:, 2] > 0.04)) < 3
    assert voxels.counts()[State.FREE] > 5 * len(cells)


def test_targets_are_the_panel_s_markers():
    scene = StereoScene(seed=0, texture_pixels=64)
    for target in panel_targets(scene):
        assert np.linalg.norm(target.outline, axis=1).min() > 0.018
        np.testing.assert_allclose(target.outline @ target.normal, 0.0, atol=1e-12)
    assert head_lens().near == pytest.approx(0.127)


@pytest.mark.slow
def test_stations_are_found_on_the_map_and_the_search_is_exact(tmp_path):
    assert main(["bench", "--only", "placement", "--quick", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "bench" / "metrics.json").read_text())
    measured = found["measured"]
    # The speed is a figure of the report; that the search is exact is a fact.
    exact = [check["ok"] for check in found["checks"] if "exhaustive" in check["name"]]
    assert exact == [True]
    assert measured["search_speedup/map"] > 0.0
    assert measured["replan/station_s"]["median"] > 0.0
    assert 0 < measured["replan/stations_found"] <= measured["replan/rounds"]


def test_ground_below_a_target_faces_as_it_does():
    target = panel_targets(StereoScene(seed=0, texture_pixels=64))[0]
    ground = ground_below(target)
    x, y, z = ground.inv().apply(np.array(target.position))
    assert (x, y) == pytest.approx((0.0, 0.0)) and z == pytest.approx(target.position[2])
    ahead = ground.inv().rotation.apply(np.array(target.normal))
    assert ahead[1] == pytest.approx(0.0, abs=1e-12) and ahead[0] > 0.0
