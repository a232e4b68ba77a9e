"""Stereo mapping end to end: two rovers find the target, build one map, and are scored."""

import json

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from controllers.mapping.stereo_view import MapperConfig
from experiments.__main__ import main
from experiments.ch3.stereo import record
from experiments.ch3.stereo.scene import StereoScene
from experiments.ch3.stereo.trial import MappingTrial, map_scene
from experiments.ch3.stereo.truth import mapped_share, surface_errors, true_surface
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import Surface, VoxelMap
from perception.voxels.occupancy import State
from twin.logs.mapping import read_log


@pytest.fixture(scope="module")
def scene() -> StereoScene:
    return StereoScene(seed=3, texture_pixels=64)


@pytest.mark.slow
def test_two_rovers_share_one_map_whose_surface_is_where_it_truly_is():
    scored = map_scene(MappingTrial(1, "information", 2))
    mapper = scored.mapper
    assert set(mapper.localizations) == {"rover1", "rover2"} and mapper.done
    assert len({(view.robot, view.number) for view in mapper.views}) == len(mapper.views) == 4
    shares = [share for share, _ in scored.curve]
    assert len(shares) == 4 and np.all(np.diff(shares) >= 0.0) and shares[-1] > 0.02
    errors, lost = surface_errors(
        mapper.shared.voxels.surface(),
        scored.scene,
        scored.transform_scene_to_map,
        np.random.default_rng(0),
    )
    assert lost < 0.01 and np.mean(errors) < 4.0
    for view in mapper.views:
        check_camera(view, scored.cameras[view.robot, view.time])
    # The robots' own arms are left out of the map.
    for localization in mapper.localizations.values():
        arm = localization.arm.cover_points(np.zeros((1, 4)))[0]
        world = localization.transform_level_to_world.apply(arm)
        assert not np.any(mapper.shared.voxels.states(world) == State.OCCUPIED)


def check_camera(view, true):
    """Hold the camera of a view to the truth, by the covariance that it claims."""
    assert view.correction is not None
    camera = view.correction.camera
    xi = (camera.transform_camera_to_world * true.inv()).as_exp_coords()
    assert xi @ np.linalg.solve(camera.covariance, xi) < chi2.ppf(0.999, 6)
    # Near enough to map from: the claim is no excuse.
    assert np.sqrt(np.diag(camera.covariance)).max() < 0.02


@pytest.mark.slow
def test_rovers_on_emulated_boards_map_as_well():
    scored = map_scene(MappingTrial(3, "information", 1, robot="emulated"))
    assert set(scored.mapper.localizations) == {"rover1", "rover2"} and scored.mapper.done
    assert len(scored.curve) == 2 and scored.curve[-1][0] > 0.005
    for view in scored.mapper.views:
        # The pair was taken while the arm was at rest, and the emulator reported the camera's pose.
        stamps = [stamp for robot, stamp in scored.cameras if robot == view.robot]
        check_camera(view, scored.cameras[view.robot, max(s for s in stamps if s <= view.time)])


@pytest.mark.slow
def test_quick_run_of_the_mapping_writes_figures_recording_points_and_mesh(tmp_path, monkeypatch):
    maps = []

    def map_and_keep(*args):
        scored = map_scene(*args)
        maps.append(scored.mapper.shared.voxels)
        return scored

    monkeypatch.setattr(record, "map_scene", map_and_keep)
    words = ["ch3-stereo", "--parts", "mapping", "--quick", "--scans", "1", "--record", "--log"]
    assert main([*words, "--jobs", "1", "--out", str(tmp_path)]) == 0
    folder = tmp_path / "ch3-stereo"
    measured = json.loads((folder / "metrics.json").read_text())["measured"]
    assert measured["surface_ratio/information_over_raster"]["n"] == 1
    assert measured["nees"] > 0.0
    names = {path.name for path in (folder / "figures").iterdir()}
    assert {"figure_3-22.png", "figure_3-25.png", "figure_3-27a.png", "figure_3-27b.png"} <= names
    assert (folder / "run.rrd").stat().st_size > 100_000
    signals = read_log(folder / "run.mcap").signals
    # Both heads looked elsewhere before their views.
    for robot in ("rover1", "rover2"):
        assert np.ptp(signals[f"{robot}/arm_angles"].values, axis=0).max() > 0.1
    (voxels,) = maps
    surface = voxels.surface()
    cloud = trimesh.load(folder / "map_points.ply")
    np.testing.assert_allclose(cloud.vertices, surface.means, atol=1e-6)
    certain = np.clip(2.0 * surface.probabilities - 1.0, 0.0, 1.0)
    np.testing.assert_array_equal(cloud.colors[:, 0], (255 * certain).astype(np.uint8))
    mesh = trimesh.load(folder / "map_mesh.stl")
    cells, _ = voxels.occupied_cells()
    # The faces enclose the occupied voxels and nothing else.
    assert mesh.volume == pytest.approx(len(cells) * voxels.grid.resolution**3, rel=1e-3)
    centres = voxels.grid.centres(cells)
    half = voxels.grid.resolution / 2.0
    bounds = [centres.min(axis=0) - half, centres.max(axis=0) + half]
    np.testing.assert_allclose(mesh.bounds, bounds, atol=1e-6)


@pytest.mark.parametrize(
    "words, message",
    [
        (["--parts", "dreams"], "cooperation"),
        (["--scans", "0"], "--scans"),
        (["--parts", "noise", "--record"], "--record"),
        (["--robot", "dreams"], "Expected one of ('sim', 'quantised', 'emulated')"),
        (["--robot", "emulated", "--parts", "noise"], "add mapping to --parts"),
    ],
)
def test_bad_options_are_refused_in_one_line(words, message, capsys):
    assert main(["ch3-stereo", *words]) == 2
    assert message in capsys.readouterr().err


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="information, raster, random"):
        MapperConfig(method="magic")


def test_error_of_a_surface_is_its_height_over_its_deviation(scene):
    """On bare ground, estimates that are 4 mm too high with a deviation of 2 mm."""
    truth = true_surface(scene, (0.3, 1.5), np.random.default_rng(0))
    heights = truth[:, 2]
    ground = truth[np.abs(heights - np.median(heights)) < 1e-6]
    assert len(ground) > 500
    means = ground + [0.0, 0.0, 0.004]
    covariances = np.broadcast_to(np.diag([1.0, 1.0, 0.002**2]), (len(means), 3, 3))
    surface = Surface(means, covariances, np.ones(len(means)))
    same = RigidTransform.identity()
    errors, lost = surface_errors(surface, scene, same, np.random.default_rng(1))
    # Beside a rock or a block another surface may be nearer.
    assert np.median(errors) == pytest.approx(4.0, rel=1e-6) and lost < 0.01


def test_share_counts_true_surface_with_an_occupied_voxel_nearby():
    voxels = VoxelMap(VoxelGrid(0.005, (-0.2, -0.2, -0.2), (0.2, 0.2, 0.2)))
    assert mapped_share(voxels, np.zeros((4, 3))) == (0.0, 0)
