import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from perception.geometry import files
from tests.hostile_files import png_of_zeros, run_and_weigh
from tests.twin.scene import SERVO, compile_scene
from twin.camera import StereoConfig
from twin.hardware.cameras import camera
from twin.hardware.cameras.camera import StereoCapture
from twin.hardware.serial_link import LinkError
from twin.sensors import IDEAL
from twin.simulation import Simulation

HEIGHT, WIDTH = 48, 64


def flat(level, height=HEIGHT, width=WIDTH):
    return np.full((height, width, 3), level, np.uint8)


def written(path, images, rate=10.0):
    """A video file of (h, w, 3) images."""
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, (width, height))
    assert writer.isOpened()
    for image in images:
        writer.write(image)
    writer.release()
    return str(path)


def sequence(folder, name, images):
    """An image sequence without loss."""
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / f"{name}_{k:04d}.png"), image)
    return str(folder / f"{name}_%04d.png")


class Device:
    """A camera that gives an image a period, until it is switched off."""

    def __init__(self, level, period=0.01):
        self.level, self.period = level, period
        self.image = flat(level)
        self.plugged = True
        self.released = False
        self.hold = threading.Event()
        self.hold.set()

    def isOpened(self):  # noqa: N802
        return True

    def grab(self):
        self.hold.wait(3.0)
        time.sleep(self.period)
        return self.plugged

    def retrieve(self):
        return self.image is not None, self.image

    def get(self, _):
        return 30.0

    def release(self):
        self.released = True


@pytest.fixture
def devices(monkeypatch):
    made = {0: Device(50), 1: Device(200)}
    monkeypatch.setattr(camera.cv2, "VideoCapture", made.__getitem__)
    return made


def until_frame(source, longest=2.0):
    end = time.monotonic() + longest
    while time.monotonic() < end:
        now = time.monotonic()
        frame = source.read(now)
        if frame is not None:
            return frame, now
        time.sleep(0.002)
    raise AssertionError("no frame")


def test_two_video_files_give_pairs_at_their_rate(tmp_path):
    left = written(tmp_path / "left.avi", [flat(20 + 10 * k) for k in range(5)])
    right = written(tmp_path / "right.avi", [flat(120 + 10 * k) for k in range(5)])
    source = StereoCapture((left, right))
    seen = [(t, source.read(t)) for t in np.round(np.arange(100.0, 100.6, 0.01), 9)]
    frames = [(t, frame) for t, frame in seen if frame is not None]
    np.testing.assert_allclose([t for t, _ in frames], 100.0 + 0.1 * np.arange(5), atol=1e-6)
    np.testing.assert_allclose([f.stamp for _, f in frames], 100.0 + 0.1 * np.arange(5), atol=1e-9)
    for k, (_, frame) in enumerate(frames):
        assert frame.value.shape == (2, HEIGHT, WIDTH) and frame.value.dtype == np.uint8
        means = frame.value.mean(axis=(1, 2))
        np.testing.assert_allclose(means, [20 + 10 * k, 120 + 10 * k], atol=2)
        with pytest.raises(ValueError):
            frame.value[0, 0, 0] = 1
    assert len(frames) == 5 and source.read(200.0) is None
    source.close()


def test_side_by_side_stream_is_split_left_first(tmp_path):
    images = [np.hstack([flat(30), flat(220)]) for _ in range(2)]
    source = StereoCapture(sequence(tmp_path, "both", images), rate=4.0)
    pair = source.read(0.0).value
    assert np.all(pair[0] == 30) and np.all(pair[1] == 220)
    assert pair.shape == (2, HEIGHT, WIDTH)
    assert source.read(0.2) is None
    assert source.read(0.25).stamp == 0.25
    source.close()


def test_twins_own_frames_come_back_bit_for_bit(tmp_path):
    simulation = Simulation(
        compile_scene(), ["rover1"], suite=IDEAL, servo=SERVO, stereo=StereoConfig(10.0), seed=3
    )
    pairs = []
    for _ in range(3):
        pairs.append(simulation.robots["rover1"].observe().stereo.value)
        for _ in range(10):
            simulation.tick()
    left = sequence(tmp_path, "left", [pair[0] for pair in pairs])
    right = sequence(tmp_path, "right", [pair[1] for pair in pairs])
    source = StereoCapture((left, right), rate=10.0)
    for k, pair in enumerate(pairs):
        np.testing.assert_array_equal(source.read(0.1 * k).value, pair)
    source.close()


def test_frames_missed_in_a_pause_are_skipped_and_old_ones_refused(tmp_path):
    video = sequence(tmp_path, "both", [flat(10 * k) for k in range(10)])
    source = StereoCapture(video, max_age=0.15, rate=10.0)
    assert source.read(0.0) is not None
    frame = source.read(0.55)
    assert frame.stamp == pytest.approx(0.5) and frame.value.max() == 50
    assert source.read(5.0) is None
    source.close()


def test_devices_give_the_newest_pair_stamped_on_the_callers_clock(devices):
    source = StereoCapture((0, 1), max_skew=1.0)
    offset = 1000.0 - time.monotonic()
    time.sleep(0.15)
    frame = source.read(time.monotonic() + offset)
    age = time.monotonic() + offset - frame.stamp
    assert 0.0 <= age < 0.15
    np.testing.assert_array_equal(frame.value.max(axis=(1, 2)), [50, 200])
    assert source.read(time.monotonic() + offset) is None
    source.close()
    assert devices[0].released and devices[1].released


def test_reading_never_waits_for_a_camera_and_its_last_pair_grows_too_old(devices):
    source = StereoCapture((0, 1), max_age=0.05, max_skew=1.0)
    until_frame(source)
    devices[0].hold.clear()
    time.sleep(0.15)
    start = time.monotonic()
    assert source.read(start) is None
    assert source.read(start) is None
    assert time.monotonic() - start < 0.05
    devices[0].hold.set()
    until_frame(source)
    source.close()


def test_pair_of_images_too_far_apart_in_time_is_refused(devices):
    devices[1].period = 0.03
    source = StereoCapture((0, 1), max_skew=0.02)
    time.sleep(0.15)
    assert source.read(time.monotonic()) is None
    source.close()


def test_unplugged_camera_is_named(devices):
    source = StereoCapture((0, 1), max_skew=1.0)
    until_frame(source)
    devices[1].plugged = False
    with pytest.raises(LinkError, match="camera 0 and camera 1: no more images"):
        until_frame_after_failure(source)
    with pytest.raises(LinkError):
        source.read(time.monotonic())
    source.close()
    assert devices[0].released


def until_frame_after_failure(source):
    end = time.monotonic() + 2.0
    while time.monotonic() < end:
        source.read(time.monotonic())
        time.sleep(0.005)


@pytest.mark.parametrize("empty", [None, np.empty((0, 0, 3), np.uint8)])
def test_empty_image_is_refused_with_its_cameras_name(devices, empty):
    devices[1].image = empty
    with pytest.raises(LinkError, match="camera 1: empty image"):
        StereoCapture((0, 1))
    assert devices[0].released and devices[1].released


def test_file_with_a_damaged_image_says_so_once_and_repeats_nothing(devices):
    devices.update({"left.avi": Device(1, 0.0), "right.avi": Device(2, 0.0)})
    source = StereoCapture(("left.avi", "right.avi"), rate=1.0)
    devices["right.avi"].image = flat(2, 10, 10)
    with pytest.raises(LinkError, match="differ in size"):
        source.read(0.0)
    assert source.read(1.0) is source.read(9.0) is None
    source.close()


def test_images_of_16_bits_are_refused(devices):
    devices[0].image = flat(1).astype(np.uint16)
    with pytest.raises(LinkError, match="camera 0: images of uint16"):
        StereoCapture((0, 1))


def test_sizes_that_differ_are_named(tmp_path):
    left = sequence(tmp_path, "left", [flat(1)])
    right = sequence(tmp_path, "right", [flat(1, 24, 32)])
    with pytest.raises(LinkError, match=r"differ in size .*64 x 48 and .*32 x 24"):
        StereoCapture((left, right), rate=1.0)
    odd = sequence(tmp_path, "odd", [flat(1, 24, 33)])
    with pytest.raises(LinkError, match="33 columns are not two views"):
        StereoCapture(odd, rate=1.0)


def test_what_cannot_be_opened_is_named(tmp_path):
    missing = str(tmp_path / "missing.avi")
    with pytest.raises(LinkError, match="missing.avi: cannot be opened"):
        StereoCapture((missing, missing))
    with pytest.raises(LinkError, match="camera 63: cannot be opened"):
        StereoCapture(63)
    text = tmp_path / "text.avi"
    text.write_text("no video")
    with pytest.raises(LinkError, match="text.avi"):
        StereoCapture(text)


def test_picture_of_many_pixels_anywhere_in_a_sequence_is_refused(tmp_path):
    names = sequence(tmp_path, "left", [flat(9), flat(9)])
    bomb = tmp_path / "left_0002.png"
    bomb.write_bytes(png_of_zeros(12_000, 12_000))
    for source in (names, str(bomb)):
        said, grown = run_and_weigh(
            "from twin.hardware.cameras.camera import LinkError, StereoCapture",
            f"try: StereoCapture({source!r}, rate=10.0)\nexcept LinkError as error: print(error)",
        )
        size = "144,000,000 pixels (12000 x 12000), the limit is 33,554,432"
        assert said == f"{bomb}: too large: {size}"
        assert grown < 50.0  # Decoded it takes 969 MB.


def test_video_of_large_images_is_refused(tmp_path, monkeypatch):
    path = written(tmp_path / "large.avi", [flat(9)])
    monkeypatch.setattr(files, "PIXELS", WIDTH * HEIGHT)
    StereoCapture(path).close()
    monkeypatch.setattr(files, "PIXELS", WIDTH * HEIGHT - 1)
    with pytest.raises(LinkError, match=r"large.avi: too large: 3,072 pixels \(64 x 48\)"):
        StereoCapture(path)


def test_folder_with_signs_of_a_pattern_in_its_name_plays(tmp_path):
    folder = tmp_path / "run [1] 50%d"
    folder.mkdir()
    path = written(folder / "both[1].avi", [flat(9)])
    assert camera._pictures(path) == [Path(path)]
    assert camera._pictures("rtsp://host/stream") == []


def test_unusable_arguments_are_named():
    with pytest.raises(ValueError, match="make no pair"):
        StereoCapture((0, "left.avi"))
    with pytest.raises(ValueError, match="rate must be positive"):
        StereoCapture("left.avi", rate=0.0)
