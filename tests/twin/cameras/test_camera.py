import copy
import os
import pickle

import cv2
import mujoco
import numpy as np
import pytest

import twin.robot
from perception.geometry.pinhole import DistortedPinhole
from tests.twin.scene import SERVO, compile_scene
from twin.camera import (
    StereoConfig,
    StereoHead,
    StereoRig,
    camera_model,
    camera_pose,
    renderer,
)
from twin.loop import Tick
from twin.recording.record import Recorder
from twin.robot import ArmMode, Command, DeferredImages, ImageChannel, RobotError, Validity
from twin.sensors import IDEAL
from twin.simulation import Simulation

MODEL = compile_scene()
PAIR = compile_scene(("rover1", "rover2"))
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
    return StereoRig(MODEL, "rover1/", config)


def noise():
    rng = np.random.default_rng(0)
    return rng, rng


def settled(model=MODEL):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def test_rendered_spots_are_where_the_model_projects_them():
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
    eyes = StereoRig(model, "", config)
    image = eyes.capture(data, noise())[0]
    rotation, translation = camera_pose(data, 0)
    expected = eyes.cameras[0].pixels((SPOTS - translation) @ rotation)
    _, _, _, centres = cv2.connectedComponentsWithStats((image > 70).astype(np.uint8))
    for pixel in expected:
        assert np.linalg.norm(centres[1:] - pixel, axis=1).min() < 0.4


def test_pair_is_grey_read_only_and_shows_the_baseline():
    pair = rig().capture(settled(), noise())
    assert pair.shape == (2, 98, 102) and pair.dtype == np.uint8
    assert pair.std() > 3 and np.any(pair[0] != pair[1])
    with pytest.raises(ValueError):
        pair[0, 0, 0] = 1


def test_image_noise_has_the_given_signal_to_noise_ratio():
    data = settled()
    clean = rig().capture(data, noise()).astype(float)
    noisy = rig(noise_db=30.0).capture(data, noise()).astype(float)
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
            simulation.tick()
        runs.append(images)
    np.testing.assert_allclose(np.unique(np.round(stamps, 9)), [0.0, 0.25, 0.5])
    assert runs[0] == runs[1]


def test_restored_run_gives_the_same_images():
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


def simulated(names=("rover1",), model=MODEL, **changes):
    config = StereoConfig(**{"rate": 20.0, **changes})
    return Simulation(model, names, suite=IDEAL, servo=SERVO, stereo=config, seed=3)


@pytest.fixture
def drawn(monkeypatch):
    """Names of the cameras that were drawn, in their order."""
    cameras, render = [], renderer().render

    def counted(model, data, camera, width, height):
        cameras.append(camera)
        return render(model, data, camera, width, height)

    monkeypatch.setattr(renderer(), "render", counted)
    return cameras


def moved(simulation, frames):
    """Swing the arm, and return the pairs taken meanwhile, not read, and what was seen of them."""
    robot = simulation.robots["rover1"]
    robot.activate()
    eyes, pairs, eager = rig(), [], []
    for frame in range(frames):
        pairs.append(robot.observe().stereo)
        eager.append(eyes.capture(simulation.data, noise()))
        robot.command(Command(arm=np.full(4, 0.5 * (-1) ** (frame // 4)), arm_mode=ArmMode.RATE))
        simulation.settle(0.05)
    return pairs, eager


def test_pair_read_late_shows_the_scene_as_it_was_when_it_was_taken():
    simulation = simulated(noise_db=None)
    pairs, eager = moved(simulation, 8)
    for pair, seen in zip(reversed(pairs), reversed(eager), strict=True):
        np.testing.assert_array_equal(pair.value, seen)
    assert len({seen.tobytes() for seen in eager}) == 8


def test_free_bodies_and_mocap_bodies_are_drawn_where_they_were():
    model = mujoco.MjModel.from_xml_string(
        (BALLS % '<body mocap="true"><geom size="0.05" pos="0.1 0.1 0.4"/></body>')
        .replace('name="eye"', 'name="stereo_left"')
        .replace(
            "<site",
            '<camera name="stereo_right" pos="0.1 -1 0.4" xyaxes="1 0.1 0 0 0.2 1" '
            'focal="0.0085 0.0085" sensorsize="0.0064 0.0048" resolution="510 492"/>'
            '<body pos="-0.1 0 0.4"><freejoint/><geom size="0.05"/></body><site',
        )
    )
    data = settled(model)
    head = StereoHead(model, "", StereoConfig(noise_db=None), np.random.SeedSequence(0))
    eyes = StereoRig(model, "", StereoConfig(noise_db=None))
    before = head.poll(data, 0.0), eyes.capture(data, noise())
    for pose in (data.qpos, data.mocap_pos[0]):
        pose[:3] += 0.02
        mujoco.mj_forward(model, data)
        after = head.poll(data, head.state.due), eyes.capture(data, noise())
        np.testing.assert_array_equal(before[0].value, before[1])
        assert np.any(before[1] != after[1])
        before = after
    np.testing.assert_array_equal(before[0].value, before[1])


def test_nothing_is_drawn_that_nobody_reads(drawn, tmp_path):
    simulation = simulated()
    robot = simulation.robots["rover1"]
    pairs = []
    for _ in range(6):
        seen = robot.observe()
        assert seen.stereo.usable and seen.stereo.stamp == pytest.approx(simulation.time)
        aged = seen._replace(stereo=seen.stereo._replace(validity=Validity.STALE))
        assert not aged.stereo.usable
        pairs.append(copy.deepcopy(aged).stereo)
        saved = simulation.save()
        simulation.settle(0.05)
        simulation.restore(saved)
        simulation.settle(0.05)
    assert drawn == []
    first, again = pairs[2].value, pairs[2].value
    assert first is again and drawn == ["rover1/stereo_left", "rover1/stereo_right"]


def test_recorder_draws_at_its_own_rate(drawn, tmp_path):
    simulation = simulated()
    robot = simulation.robots["rover1"]
    with Recorder(tmp_path / "run.rrd") as recorder:
        for step in range(50):
            recorder.record(Tick(step, simulation.time, {"rover1": robot.observe()}, {}))
            simulation.tick()
    # Ten pairs in half a second, of which the recording takes those of 0 and 0.25 s.
    assert len(drawn) == 4


def test_noise_of_a_pair_is_its_own_whoever_reads_and_in_whatever_order():
    def pixels(chosen):
        simulation = simulated(("rover1", "rover2"), PAIR)
        taken = []
        for _ in range(4):
            for name, robot in simulation.robots.items():
                taken.append((name, len(taken) // 2, robot.observe().stereo))
            simulation.settle(0.05)
        return {(name, k): taken[i][2].value for i in chosen for name, k, _ in [taken[i]]}

    everything, backwards, few = pixels(range(8)), pixels(reversed(range(8))), pixels([5])
    assert len(everything) == 8
    for key, seen in everything.items():
        np.testing.assert_array_equal(backwards[key], seen)
    np.testing.assert_array_equal(few["rover2", 2], everything["rover2", 2])


def test_noise_differs_by_seed_robot_eye_and_frame():
    data = settled()
    clean = rig().capture(data, noise()).astype(float)
    inside = (clean[0] > 40) & (clean[0] < 215) & (clean[1] > 40) & (clean[1] < 215)
    parts = []
    for source in (np.random.SeedSequence(3).spawn(2)[0], *np.random.SeedSequence(4).spawn(2)):
        head = StereoHead(MODEL, "rover1/", StereoConfig(rate=10.0, noise_db=20.0), source)
        for frame in range(2):
            pair = head.poll(data, 0.1 * frame).value.astype(float)
            parts += [eye[inside] for eye in pair - clean]
    alike = np.corrcoef(parts)
    np.fill_diagonal(alike, 0.0)
    # Of independent noise over so many pixels; the same stream gives 1.
    assert inside.sum() > 2000 and np.abs(alike).max() < 0.12


def test_pair_that_was_not_read_before_its_simulation_was_closed_is_an_error():
    simulation = simulated()
    read = simulation.robots["rover1"].observe().stereo
    seen = read.value
    simulation.settle(0.05)
    unread = simulation.robots["rover1"].observe().stereo
    simulation.close()
    assert read.value is seen and unread.usable
    with pytest.raises(RobotError, match=r"stereo pair of 0.050 s was not read before"):
        _ = unread.value


def test_images_that_fail_are_asked_for_again_and_kept_once_they_are_there():
    asked = []

    def make():
        asked.append(1)
        if len(asked) == 1:
            raise RobotError("not yet")
        return np.zeros((2, 3, 4), np.uint8)

    channel = ImageChannel.deferred(make, 1.5)
    with pytest.raises(RobotError, match="not yet"):
        _ = channel.value
    assert channel._replace(stamp=2.0).value is channel.value and len(asked) == 2


def test_pickled_pair_holds_its_pixels():
    pair = simulated().robots["rover1"].observe().stereo
    again = pickle.loads(pickle.dumps(pair))
    np.testing.assert_array_equal(again.value, pair.value)
    assert again[1:] == pair[1:]


def test_what_draws_a_pair_is_given_up_with_it():
    simulation = simulated()
    waiting = len(twin.robot._MAKERS)
    simulation.settle(1.0)
    # One held by the robot, however many were taken.
    assert len(twin.robot._MAKERS) == waiting
    images = DeferredImages(lambda: np.zeros((2, 3, 4), np.uint8))
    assert len(twin.robot._MAKERS) == waiting + 1
    images.read()
    assert len(twin.robot._MAKERS) == waiting


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
