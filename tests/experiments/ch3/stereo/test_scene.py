"""The cluttered stereo scene: its truth, its pictures, and what stereo makes of them."""

import os

os.environ.setdefault("MUJOCO_GL", "egl")

import cv2
import mujoco
import numpy as np
import pytest

from experiments.ch3.stereo.noise import (
    StereoNoise,
    StereoNoiseTrial,
    binned_sigma,
    log_slope,
    measure_scene,
    report,
    robust_sigma,
)
from experiments.ch3.stereo.scene import RIG, StereoScene, draw_layout, look_at
from experiments.harness.contract import RepeatedOptions
from experiments.harness.output import Output
from models.datasheets import CAMERA
from perception.stereo.matching import StereoMatcher
from twin.camera import renderer

EYE = look_at([-0.45, -0.35, 0.35], [0.0, 0.35, 0.1])


@pytest.fixture(scope="module")
def scene() -> StereoScene:
    return StereoScene(3, texture_pixels=1024)


def test_geometry_is_that_of_the_datasheet(scene):
    g = scene.geometry
    assert (g.width, g.height, g.baseline) == (CAMERA.width, CAMERA.height, CAMERA.baseline)
    np.testing.assert_allclose(
        [g.fx, g.fy, g.cx, g.cy],
        [CAMERA.pinhole.fx, CAMERA.pinhole.fy, CAMERA.pinhole.cx, CAMERA.pinhole.cy],
        rtol=1e-6,
    )


def test_rays_agree_with_the_rendered_depth(scene):
    scene.set_rig(EYE)
    pixels = np.random.default_rng(0).integers([0, 0], [CAMERA.width, CAMERA.height], (2000, 2))
    exact = scene.true_depths(RIG, pixels)
    renderer().close()  # one context at a time
    with mujoco.Renderer(scene.model, CAMERA.height, CAMERA.width) as other:
        other.enable_depth_rendering()
        other.update_scene(scene.data, f"{RIG}/stereo_left")
        drawn = other.render()[pixels[:, 1], pixels[:, 0]]
    seen = np.isfinite(exact)
    error = np.abs(drawn[seen] - exact[seen])
    assert np.median(error) < 1e-3
    assert np.mean(error > 0.02) < 0.03  # a pixel on an edge may show either side


def test_points_of_a_rendered_pair_are_as_certain_as_they_say(scene):
    scene.set_rig(EYE)
    found = StereoMatcher(scene.geometry).match(scene.capture(RIG).pair)
    some = np.random.default_rng(0).permutation(len(found))[:2000]
    depths = scene.true_depths(RIG, found.pixels[some])
    squares = (found.points[some, 2] - depths) ** 2 / found.covariances[some, 2, 2]
    assert len(found) > 10_000
    assert 0.5 < np.nanmean(squares) < 2.0
    assert np.nanmean(squares > 25.0) < 0.005
    assert np.mean(np.isnan(depths)) < 0.005  # points where there is only sky
    errors = found.disparities[some] - scene.geometry.fx * scene.geometry.baseline / depths
    assert robust_sigma(errors[np.isfinite(errors)]) < 0.04  # [px]


def test_markers_appear_where_the_cad_and_the_true_poses_put_them(scene):
    scene.set_rig(EYE)
    view = scene.capture(RIG)
    world = scene.transform_panel_to_world.apply(scene.panel.marker_points)
    local = view.transform_camera_to_world.inv().apply(world)
    expected = scene.geometry.project(local)
    # A rock may stand before a marker.
    depths = scene.true_depths(RIG, np.round(expected[:, :2]).astype(int))
    expected = expected[np.abs(depths - local[:, 2]) < 0.01]
    assert len(expected) > 0
    for u, v, disparity in expected:
        for image, column in zip(view.pair, (u, u - disparity)):
            around = image[int(v) - 40 : int(v) + 41, int(column) - 40 : int(column) + 41]
            count, _, stats, centres = cv2.connectedComponentsWithStats(
                (around < 25).astype(np.uint8)
            )
            middle = centres[1:] + [int(column) - 40, int(v) - 40]
            nearest = np.linalg.norm(middle - [column, v], axis=1).min()
            assert count > 1 and nearest < 0.7


def test_free_rig_takes_the_pose_that_it_is_set_to(scene):
    eye, target = np.array([0.2, -0.4, 0.5]), np.array([0.0, 0.3, 0.0])
    scene.set_rig(look_at(eye, target))
    pose = scene.transform_camera_to_world(RIG)
    np.testing.assert_allclose(pose.translation, eye, atol=1e-9)
    seen = scene.geometry.project(pose.inv().apply(target))
    np.testing.assert_allclose(seen[:2], [scene.geometry.cx, scene.geometry.cy], atol=1e-6)
    assert pose.rotation.apply([1.0, 0.0, 0.0])[2] == pytest.approx(0.0, abs=1e-12)
    assert pose.rotation.apply([0.0, 1.0, 0.0])[2] < 0.0


def test_both_rovers_start_free_and_see_the_panel_or_the_ground_before_it(scene):
    for name in scene.robot_names:
        assert not scene.arm_touches(name)
        pixels = np.stack(np.meshgrid(np.arange(5, 510, 50), np.arange(5, 492, 50)), -1)
        depths = scene.true_depths(name, pixels.reshape(-1, 2))
        assert 0.25 < np.nanmin(depths) and np.nanmedian(depths) < 2.0


def test_arm_takes_the_angles_that_it_is_set_to_and_moves_the_camera(scene):
    name = scene.robot_names[0]
    before = scene.transform_camera_to_world(name)
    start = scene.joints(name)
    scene.set_joints(name, start + [0.3, 0.0, 0.0, 0.0])
    moved = scene.transform_camera_to_world(name) * before.inv()
    up = scene.data.body(f"{name}/turret").xmat[[2, 5, 8]]
    np.testing.assert_allclose(moved.rotation.as_rotvec(), 0.3 * up, atol=1e-9)
    np.testing.assert_allclose(scene.joints(name), start + [0.3, 0.0, 0.0, 0.0])
    scene.set_joints(name, start)


def test_bad_names_and_angles_are_refused_with_what_is_valid(scene):
    with pytest.raises(ValueError, match="'rover9'.*rover1, rover2, rig"):
        scene.capture("rover9")
    with pytest.raises(ValueError, match="arm of rover1: got .*needs angles within"):
        scene.set_joints("rover1", [9.0, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="arm of rover1"):
        scene.set_joints("rover1", [np.nan, 0.0, 0.0, 0.0])


def test_layouts_of_many_seeds_can_be_built_and_differ():
    layouts = [draw_layout(seed) for seed in range(50)]
    assert len({panel.position for panel, _ in layouts}) == 50
    for panel, robots in layouts:
        for robot in robots:
            away = np.subtract(robot.position, panel.position)
            assert 1.0 <= np.hypot(*away) <= 1.2
            assert np.abs(robot.position).max() + 0.3 <= 1.6
        assert np.hypot(*np.subtract(robots[0].position, robots[1].position)) > 0.7


def synthetic(seed: int) -> StereoNoise:
    """Return what `measure_scene` would of a head with 0.03 px of noise at all ranges."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.35, 2.0, 6000)
    noise = {m: 0.03 * rng.standard_normal(6000) for m in ("refined", "bm", "sgbm")}
    scale = 25.7
    return StereoNoise(
        focal_baseline=scale,
        depth=depth,
        predicted=depth**2 / scale * 0.03,
        arm=depth < 0.6,
        errors=noise,
        matched=dict.fromkeys(noise, 0.8),
        bare=0,
    )


def test_report_finds_slope_2_and_unit_nees_of_constant_disparity_noise(tmp_path):
    output = Output("noise", RepeatedOptions(out=tmp_path))
    report([synthetic(0), synthetic(1)], output)
    output.finish()
    measured = output.metrics()["measured"]
    assert measured["depth_sigma_slope"]["median"] == pytest.approx(2.0, abs=0.05)
    assert measured["depth_nees"] == pytest.approx(1.0, abs=0.05)
    assert measured["disparity_sigma_px/robust/refined"] == pytest.approx(0.03, rel=0.05)
    assert measured["eq_3-6_ratio/worst"] < 1.1
    assert all(check["ok"] for check in output.metrics()["checks"])
    assert (tmp_path / "noise" / "figures" / "depth_sigma.png").is_file()


def test_log_slope_of_binned_sigma_is_the_exponent():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.35, 2.0, 40_000)
    middle, sigma = binned_sigma(depth, depth**1.5 * rng.standard_normal(40_000))
    assert log_slope(middle, sigma) == pytest.approx(1.5, abs=0.05)


@pytest.mark.slow
def test_ours_is_at_least_twice_as_accurate_as_block_matching_on_a_rendered_scene():
    found = measure_scene(StereoNoiseTrial(11, (0.5, 1.0)))
    both = np.isfinite(found.errors["bm"])
    ours, theirs = (robust_sigma(found.errors[m][both]) for m in ("refined", "bm"))
    assert ours < 0.5 * theirs
    assert ours < 0.04
    assert robust_sigma(found.errors["sgbm"][np.isfinite(found.errors["sgbm"])]) > theirs
