"""Stereo pairs of an emulator's own scene, on their way to a robot in another process."""

import contextlib
import dataclasses
import threading
import time

import numpy as np
import pytest

from models.clutter import PanelConfig, PanelMarker
from models.compose import FieldConfig, PayloadConfig, RobotPlacement
from twin.camera import StereoConfig, renderer
from twin.connect import connect
from twin.hardware.cameras import frames
from twin.hardware.cameras.camera import StereoCapture
from twin.hardware.cameras.frames import FrameReader, FrameWriter
from twin.hardware.emulator.__main__ import Emulator
from twin.hardware.emulator.scene import SceneConfig
from twin.hardware.serial_link import LinkError
from twin.optics.realism import CAMERA_SETS
from twin.robot import ArmMode, Command, Lifecycle, RobotError, Validity

ROBOT = "rover1"
FIELD = FieldConfig(texture_pixels=64)


def pairs(target, cycles, turn=0.0, **options):
    """What a robot saw in each cycle while its arm turned; all of it is read at the end."""
    seen = []
    with connect(target, field=FIELD, seed=3, **options) as link:
        robot = link.robots[ROBOT]
        robot.activate()
        start = robot.observe().arm_angles.value.copy()
        for cycle in range(cycles):
            seen.append(robot.observe().stereo)
            goal = start + turn * cycle * np.array([1.0, 0.0, 0.0, 0.0])
            robot.command(Command(arm=goal, arm_mode=ArmMode.POSITION))
            link.clock.tick()
        for pair in reversed(seen):
            _ = pair.value
    return seen


@pytest.mark.chosen_seed  # The same as in the process of the boards, where nothing shifts it.
@pytest.mark.parametrize("realism", ["ideal", "default"])
def test_emulated_robot_has_the_quantised_ones_pairs_and_the_first_of_the_simulation(realism):
    """Noise included. Later pairs of the simulation differ: its motors get finer voltages."""
    stereo = StereoConfig(rate=4.0, realism=CAMERA_SETS[realism])
    emulated, quantised, plain = (
        pairs(target, 30, 0.005, stereo=stereo) for target in ("emulated", "quantised", "sim")
    )
    np.testing.assert_array_equal(emulated[0].value, plain[0].value)
    assert [pair.stamp for pair in emulated] == [pair.stamp for pair in plain]
    assert len({pair.stamp for pair in emulated}) == 2
    for one, other in zip(emulated, quantised, strict=True):
        assert one.stamp == other.stamp and one.validity is other.validity
        np.testing.assert_array_equal(one.value, other.value)
    assert np.any(emulated[0].value != emulated[-1].value)


def test_pair_of_slow_cameras_is_good_until_two_more_should_have_come():
    seen = pairs("quantised", 130, stereo=StereoConfig(rate=0.8))
    assert all(pair.usable for pair in seen) and len({pair.stamp for pair in seen}) == 2


@pytest.mark.slow
def test_camera_that_is_frozen_or_unplugged_stops_the_robot_with_one_clear_error():
    faults = {
        "camera_frozen": r"'rover1' is error, not active: stereo is stale; boards",
        "camera_unplugged": r"stale \(.*rover1.frames: no more images; is it plugged in\?\); b",
    }
    with connect("emulated", field=FIELD, stereo=StereoConfig(rate=2.0)) as link:
        robot = link.robots[ROBOT]
        for fault, message in faults.items():
            robot.activate()
            last = robot.observe().stereo.stamp
            link.emulator.inject(ROBOT, fault, 1.5)
            with pytest.raises(RobotError, match=message):
                for _ in range(200):
                    robot.observe()
                    robot.command(Command())
                    link.clock.tick()
            assert link.clock.time - last == pytest.approx(1.01, abs=0.02)
            assert robot.lifecycle is Lifecycle.ERROR
            while link.clock.time < last + 2.05:
                link.clock.tick()
            assert robot.observe().stereo.stamp == pytest.approx(last + 2.0)


def test_scene_config_is_unchanged_by_its_json_form():
    panel = PanelConfig((0.1, 0.2), 0.3, markers=(PanelMarker(0.0, 0.01),))
    scene = SceneConfig(
        (RobotPlacement("a", (0.1 / 3.0, 1.0), payload=PayloadConfig(0.2)), RobotPlacement("b")),
        FieldConfig(panel=panel, rocks=3, sun_elevation=(0.3, 0.7)),
        stereo=StereoConfig(0.5, None, (0.1, 0.0, 0.0, 0.0, 0.0), CAMERA_SETS["harsh"]),
    )
    assert SceneConfig.from_json(scene.to_json()) == scene
    plain = dataclasses.replace(scene, stereo=None, field=FieldConfig())
    assert SceneConfig.from_json(plain.to_json()) == plain


@contextlib.contextmanager
def serving(writer):
    """Let a writer draw in a thread of its own, as the emulator does in its process."""
    over = threading.Event()

    def serve():
        while not over.is_set():
            writer.serve()
            time.sleep(1e-4)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def flat(level, drawn=None):
    """What draws a grey pair, and notes that it did."""

    def draw():
        if drawn is not None:
            drawn.append(level)
        return np.full((2, 3, 4), level, np.uint8)

    return draw


def test_capture_reads_the_newest_pair_on_either_clock(tmp_path):
    writer = FrameWriter(tmp_path / "rover1.frames", 3, 4)
    by_scene = StereoCapture(tmp_path / "rover1.frames", scene_time=True)
    by_wall = StereoCapture(str(tmp_path / "rover1.frames"), max_age=9.0)
    assert by_scene.read(0.0) is None
    for level in (10, 20, 30):
        writer.announce(0.1 * level, flat(level))
    frame = by_scene.read(3.0)
    with serving(writer):
        assert frame.stamp == 0.1 * 30 and np.all(frame.value == 30)
    assert by_scene.read(3.0) is None
    with pytest.raises(ValueError):
        frame.value[0, 0, 0] = 1
    offset = 100.0 - time.monotonic()
    assert by_wall.read(time.monotonic() + offset).stamp == pytest.approx(100.0, abs=0.3)
    writer.announce(3.0, flat(30), 5.0)
    assert by_wall.read(100.0).stamp == pytest.approx(95.0, abs=0.3)
    assert by_scene.read(3.0).stamp == 3.0
    writer.unplug()
    with pytest.raises(LinkError, match=r"rover1.frames: no more images"):
        by_scene.read(3.1)
    writer.unplug(False)
    writer.announce(3.2, flat(0))
    assert by_scene.read(3.2).stamp == 3.2


def test_only_the_pairs_that_the_host_reads_are_drawn_each_once_in_any_order(tmp_path):
    writer, drawn = FrameWriter(tmp_path / "a.frames", 3, 4), []
    capture, pairs = StereoCapture(tmp_path / "a.frames", scene_time=True), []
    with serving(writer):
        for level in range(10):
            writer.announce(0.1 * level, flat(level, drawn))
            pairs.append(capture.read(0.1 * level)._replace(validity=Validity.STALE))
        assert drawn == []
        for level in (7, 2, 7):
            assert np.all(pairs[level].value == level)
        # A camera that is unplugged takes no more pairs, but those that it took are there.
        writer.unplug()
        assert np.all(pairs[9].value == 9)
    assert drawn == [7, 2, 9]


def test_pair_that_is_too_old_or_of_a_closed_emulator_is_an_error_of_the_robot(tmp_path):
    writer = FrameWriter(tmp_path / "a.frames", 3, 4)
    capture, pairs = StereoCapture(tmp_path / "a.frames", scene_time=True), []
    for level in range(17):
        writer.announce(0.1 * level, flat(level))
        pairs.append(capture.read(0.1 * level))
    with serving(writer):
        assert np.all(pairs[1].value == 1)
        with pytest.raises(RobotError, match="pair 1 is too old"):
            _ = pairs[0].value
    writer.close()
    with pytest.raises(RobotError, match="the emulator is gone, and pair 17 with it"):
        _ = pairs[16].value


def test_host_does_not_wait_for_ever_for_a_pair(monkeypatch, tmp_path):
    monkeypatch.setattr(frames, "_PATIENCE", 0.05)
    writer = FrameWriter(tmp_path / "a.frames", 3, 4)
    writer.announce(0.0, flat(1))
    pair = StereoCapture(tmp_path / "a.frames", scene_time=True).read(0.0)
    with pytest.raises(RobotError, match="the emulator is gone"):
        _ = pair.value


def test_emulator_draws_no_pair_that_its_host_does_not_read(tmp_path):
    scene = SceneConfig((RobotPlacement(ROBOT),), FIELD, 3, stereo=StereoConfig(rate=50.0))
    emulator = Emulator(scene, 0.0, [], tmp_path)
    try:
        counted, render = [], renderer().render
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(renderer(), "render", lambda *a: counted.append(1) or render(*a))
            for _ in range(20):
                emulator.tick()
                emulator.serve(0.0)
            assert counted == []
            reader = FrameReader(emulator.rigs[ROBOT].frames.path)
            newest = reader.newest()
            thread = threading.Thread(target=reader.fetch, args=(newest.number,))
            thread.start()
            while thread.is_alive():
                emulator.serve(0.001)
            thread.join()
            assert len(counted) == 2
    finally:
        emulator.close()


def test_pair_is_never_read_half_written(tmp_path):
    writer = FrameWriter(tmp_path / "a.frames", 200, 300)
    reader = FrameReader(tmp_path / "a.frames")
    over = threading.Event()

    def write():
        level = 0
        while not over.is_set():
            level = (level + 1) % 256
            image = np.full((2, 200, 300), level, np.uint8)
            writer.announce(float(level), lambda image=image: image)
            writer.serve()
            time.sleep(0.0002)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        found, latest = [], time.monotonic() + 5.0
        while len(found) < 50 and time.monotonic() < latest:
            taken = reader.newest()
            found += [] if taken is None else [(taken.stamp, reader.fetch(taken.number))]
    finally:
        over.set()
        thread.join()
    assert len(found) == 50
    for stamp, images in found:
        assert images.min() == images.max() == stamp


def len_of(content):
    return "none" if content is None else f"{len(content)} bytes"


@pytest.mark.parametrize(
    "content", [None, b"", b"short", bytes(99), b"FTFRAMES" + bytes([1] * 92)], ids=len_of
)
def test_file_that_is_no_emulator_s_is_named(content, tmp_path):
    path = tmp_path / "other.frames"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LinkError, match=r"other.frames: (cannot be opened|no stereo pairs)"):
        StereoCapture(path)


def test_file_of_pairs_larger_than_any_cameras_is_refused(tmp_path):
    path = tmp_path / "large.frames"
    FrameWriter(path, 5800, 5800)
    with pytest.raises(LinkError, match=r"large.frames: too large: 33,640,000 pixels \(5800 x"):
        StereoCapture(path)
