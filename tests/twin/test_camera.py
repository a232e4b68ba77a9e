import os

import cv2
import mujoco
import numpy as np
import pytest

from perception.geometry.pinhole import DistortedPinhole
from tests.twin.scene import SERVO, compile_scene
from twin.camera import (
    StereoConfig,
    StereoRig,
    camera_model,
    camera_pose,
    renderer,
)
from twin.robot import Validity
from twin.sensors import IDEAL
from twin.simulation import Simulation

MODEL = compile_scene()
BALLS = """
<mujoco><visual><headlight ambient="1 1 1"/><map znear="0.01"/></visual>
<worldbody>
  <camera name="eye" pos="0.1 -1 0.4" xyaxes="1 0.1 0 0 0.2 1" focal="0.0085 0.0085"
    sensorsize="0.0064 0.0048" resolution="510 492" principal="0.0004 -0.0002"/>
  <site name="marker" pos="0.1 0 0.4" size="0.2" rgba="1 0 0 1"/>
  <geom name="truth" group="4" pos="0.1 -.2 0.4" size="0.2" rgba="1 0 0 1"/>
  %s
</worldbody></mujoco>
"""
SPOTS = np.array([[0.0, 0.3, 0.2], [0.15, 0.2, 0.3], [-0.15, 0.1, 0.25], [0.1, 0.5, -0.05]])


def rig(**changes):
    config = StereoConfig(**{"noise_db": None, **changes})
    return StereoRig(MODEL, "rover1/", config, np.random.default_rng(0))


def settled(model=MODEL):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def test_rendered_spots_stand_where_the_model_projects_them():
    geoms = "".join(
        f'<geom type="sphere" size="0.012" pos="{x} {y} {z}" rgba="1 1 1 1"/>' for x, y, z in SPOTS
    )
    model = mujoco.MjModel.from_xml_string(BALLS % geoms)
    data = settled(model)
    camera = camera_model(model, "eye")
    rotation, translation = camera_pose(data, 0)
    expected = camera.pixels((SPOTS - translation) @ rotation)
    image = renderer().render(model, data, "eye", 510, 492).astype(float).sum(axis=2)
    count, _, _, centres = cv2.connectedComponentsWithStats((image > 200).astype(np.uint8))
    assert count == 5
    for pixel in expected:
        nearest = centres[1:][np.argmin(np.linalg.norm(centres[1:] - pixel, axis=1))]
        # A ball off the axis is seen as an ellipse, whose centre is off by a few hundredths.
        np.testing.assert_allclose(nearest, pixel, atol=0.25)


def test_sites_and_truth_markers_are_not_drawn():
    model = mujoco.MjModel.from_xml_string(BALLS % "")
    image = renderer().render(model, settled(model), "eye", 64, 64)
    assert image.max() == 0


def test_projection_agrees_with_opencv_including_distortion():
    camera = DistortedPinhole(
        510, 492, 677.3, 871.2, 254.5, 245.5, (-0.2, 0.05, 0.001, -0.002, 0.01)
    )
    points = np.random.default_rng(3).uniform([-0.3, -0.3, 0.8], [0.3, 0.3, 2.0], (50, 3))
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    np.testing.assert_allclose(camera.pixels(points), expected.reshape(-1, 2), atol=1e-9)


def test_points_behind_the_camera_have_no_pixel():
    camera = DistortedPinhole(10, 10, 10.0, 10.0, 4.5, 4.5)
    assert np.isnan(camera.pixels(np.array([[0.1, 0.1, -1.0]]))).all()


def test_distorted_image_matches_distorted_projection():
    geoms = "".join(
        f'<geom type="sphere" size="0.012" pos="{x} {y} {z}" rgba="1 1 1 1"/>' for x, y, z in SPOTS
    )
    model = mujoco.MjModel.from_xml_string(
        (BALLS % geoms)
        .replace('name="eye"', 'name="stereo_left"')
        .replace(
            "<site",
            '<camera name="stereo_right" focal="0.0085 0.0085" '
            'sensorsize="0.0064 0.0048" resolution="510 492"/><site',
        )
    )
    data = settled(model)
    config = StereoConfig(noise_db=None, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))
    eyes = StereoRig(model, "", config, np.random.default_rng(0))
    image = eyes.capture(data)[0]
    rotation, translation = camera_pose(data, 0)
    expected = eyes.cameras[0].pixels((SPOTS - translation) @ rotation)
    _, _, _, centres = cv2.connectedComponentsWithStats((image > 70).astype(np.uint8))
    for pixel in expected:
        assert np.linalg.norm(centres[1:] - pixel, axis=1).min() < 0.4


def test_pair_is_grey_read_only_and_shows_the_baseline():
    pair = rig().capture(settled())
    assert pair.shape == (2, 98, 102) and pair.dtype == np.uint8
    assert pair.std() > 3 and np.any(pair[0] != pair[1])
    with pytest.raises(ValueError):
        pair[0, 0, 0] = 1


def test_image_noise_has_the_given_signal_to_noise_ratio():
    data = settled()
    clean = rig().capture(data).astype(float)
    noisy = rig(noise_db=30.0).capture(data).astype(float)
    inside = (clean > 40) & (clean < 215)
    measured = 20 * np.log10(255.0 / np.std((noisy - clean)[inside]))
    assert measured == pytest.approx(30.0, abs=0.3)


def test_pairs_come_at_their_rate_and_are_repeated_bit_for_bit():
    runs = []
    for _ in range(2):
        simulation = Simulation(
            MODEL, ["rover1"], suite=IDEAL, servo=SERVO, stereo=StereoConfig(4.0), seed=3
        )
        stamps, images = [], []
        for _ in range(60):
            stereo = simulation.robots["rover1"].observe().stereo
            assert stereo.validity is Validity.MEASURED
            stamps.append(stereo.stamp)
            images.append(stereo.value.tobytes())
            simulation.step()
        runs.append(images)
    np.testing.assert_allclose(np.unique(np.round(stamps, 9)), [0.0, 0.25, 0.5])
    assert runs[0] == runs[1]


def test_restored_run_sees_the_same_images():
    simulation = Simulation(
        MODEL, ["rover1"], suite=IDEAL, servo=SERVO, stereo=StereoConfig(20.0), seed=3
    )
    simulation.settle(0.2)
    saved = simulation.save()
    seen = []
    for _ in range(2):
        simulation.restore(saved)
        simulation.settle(0.1)
        seen.append(simulation.robots["rover1"].observe().stereo.value.tobytes())
    assert seen[0] == seen[1]


def test_one_renderer_serves_scenes_and_sizes_in_turn():
    other = mujoco.MjModel.from_xml_string(BALLS % '<geom size="0.1" pos="0.1 0 0.4"/>')
    first, second = settled(), settled(other)
    eye = "rover1/stereo_left"
    alone = renderer().render(MODEL, first, eye, 102, 98)
    between = renderer().render(other, second, "eye", 900, 700)
    again = renderer().render(MODEL, first, eye, 102, 98)
    assert between.shape == (700, 900, 3) and between.max() > 0
    np.testing.assert_array_equal(alone, again)
    renderer().close()
    np.testing.assert_array_equal(renderer().render(MODEL, first, eye, 102, 98), alone)
    assert renderer() is renderer()


def test_forked_process_refuses_to_render(monkeypatch):
    owned = renderer()
    owned.render(MODEL, settled(), "rover1/stereo_left", 32, 32)
    monkeypatch.setattr(os, "getpid", lambda: -1)
    with pytest.raises(RuntimeError, match="spawning"):
        owned.render(MODEL, settled(), "rover1/stereo_left", 32, 32)


def test_unknown_camera_is_named_with_what_there_is():
    with pytest.raises(ValueError, match="'third_eye'.*rover1/stereo_left"):
        renderer().render(MODEL, settled(), "third_eye", 32, 32)
    with pytest.raises(ValueError, match="'third_eye'.*rover1/stereo_left"):
        camera_model(MODEL, "third_eye")
