"""What passes between the rovers of a mission, and what each does while nothing passes."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mission.radio import (
    FRAME_BYTES,
    PATIENCE,
    PERIOD,
    SILENT,
    STATUS,
    MissionRadio,
    RadioPort,
    SlotPose,
    Status,
)
from controllers.mission.stage import StageError
from tests.controllers.mission.hand_made import hand_links
from twin.hardware.radio.frames import Frame, encode_frame
from twin.link import MESSAGE_LIMIT, RadioError

POSE = RigidTransform.from_components([-5.2, 3.1, 0.2], Rotation.from_euler("ZXY", [2.9, 0.1, 0.0]))
SIGMA = np.array([0.01, 0.02, 0.03, 0.004, 0.005, 0.006])


def drawn_covariance() -> np.ndarray:
    mixed = np.random.default_rng(3).normal(size=(6, 6)) * SIGMA
    return mixed.T @ mixed


def test_a_status_carries_the_slot_within_its_steps_and_its_covariance_to_half_precision() -> None:
    sent = Status(3, True, SlotPose(POSE, drawn_covariance()))
    message = sent.pack()
    assert message[0] == STATUS and len(message) <= MESSAGE_LIMIT
    got = Status.unpack(message)
    assert (got.done, got.ready) == (3, True) and got.slot is not None
    off = got.slot.transform_slot_to_robot * POSE.inv()
    assert off.rotation.magnitude() < 2e-4
    moved = np.abs(got.slot.transform_slot_to_robot.translation - POSE.translation)
    assert moved.max() <= 2.5e-4 + 1e-12
    np.testing.assert_allclose(got.slot.covariance, drawn_covariance(), rtol=1e-3)
    for status in (Status(1), Status(1, near=True), Status(1, ready=True), Status(1, sighted=True)):
        assert Status.unpack(status.pack()) == status


def test_a_status_that_cannot_be_sent_says_why() -> None:
    far = RigidTransform.from_translation([0.0, 17.0, 0.0])
    with pytest.raises(RadioError, match="farther than 16 m"):
        Status(1, slot=SlotPose(far, np.eye(6))).pack()
    with pytest.raises(RadioError, match="not finite"):
        Status(1, slot=SlotPose(POSE, np.full((6, 6), np.nan))).pack()
    with pytest.raises(RadioError, match="2 bytes"):
        Status.unpack(b"\x19\x00")


@pytest.mark.parametrize("length", [1, 17, MESSAGE_LIMIT])
def test_bytes_on_the_air_are_those_of_the_links_frames(length: int) -> None:
    link, _ = hand_links()
    radio = MissionRadio(link, "rover2")
    radio.stage = "search"
    body = bytes(range(1, length + 1))
    radio.send(body)
    assert radio.bytes_sent == {("search", 1): length + FRAME_BYTES}
    assert len(encode_frame(Frame(2, 0, 7, 9, body))) == length + FRAME_BYTES


def both_radios() -> tuple[MissionRadio, MissionRadio]:
    links = hand_links()
    return MissionRadio(links[0], "rover2"), MissionRadio(links[1], "rover1")


def test_a_status_is_sent_once_a_second_and_at_once_when_a_part_is_done() -> None:
    link, _ = hand_links()
    radio = MissionRadio(link, "rover2")
    times: list[float] = []
    asked: list[int] = []

    def slot() -> None:
        asked.append(len(link.sent))

    for tick in range(500):
        radio.begin_tick(0.01 * tick)
        before = len(link.sent)
        radio.tell(0 if tick < 250 else 1, slot)
        times += [0.01 * tick] * (len(link.sent) - before)
    np.testing.assert_allclose(times, [0.0, 1.0, 2.0, 2.5, 3.5, 4.5], atol=1e-9)
    assert np.diff(times).max() <= PERIOD
    # Where the rover stands is found for what is sent alone: it takes longer than a tick's rest.
    assert len(asked) == len(times)


def test_a_rover_that_believes_itself_out_of_range_still_says_what_it_has_done() -> None:
    one, other = both_radios()
    far = SlotPose(RigidTransform.from_translation([0.0, 90.0, 0.0]), np.eye(6))
    one.begin_tick(0.0)
    one.tell(2, lambda: far)
    other.begin_tick(0.0)
    assert other.partner == Status(2)


def test_each_kind_of_message_goes_to_whom_it_is_for() -> None:
    one, other = both_radios()
    for message in (b"\x14guidance", b"\x17map", b"\x14more"):
        one.send(message)
    one.begin_tick(0.0)
    one.tell(2, lambda: None)
    other.begin_tick(0.0)
    assert other.partner == Status(2)
    assert other.take((0x17,)) == [b"\x17map"]
    guidance = RadioPort(other, (0x14, 0x15))
    assert guidance.poll().messages == [b"\x14guidance", b"\x14more"]
    assert guidance.poll().messages == [] == other.take((0x17,))


def test_silence_is_noted_when_it_begins_and_ends_and_a_rover_that_has_done_its_part_waits() -> (
    None
):
    links = hand_links()
    radio, other = MissionRadio(links[0], "rover2"), MissionRadio(links[1], "rover1")
    radio.stage = "approach"
    links[1].silent = True
    begun = 12.0
    for tick in range(int(30.0 / 0.1)):
        now = begun + 0.1 * tick
        links[1].silent = now < begun + 20.0
        other.begin_tick(now)
        other.tell(1, lambda: None)
        radio.begin_tick(now)
        if now > begun + 10.0:
            radio.wait()
    (first, begins), (second, waits), (third, hears) = radio.notices
    assert "has not heard rover2 for 4 s in approach" in begins and first == pytest.approx(
        begun + SILENT, abs=0.11
    )
    assert "waits for rover2 in approach" in waits and second == pytest.approx(22.1, abs=0.11)
    assert "hears rover2 again" in hears and third == pytest.approx(begun + 20.0, abs=1.1)


def test_a_silence_that_does_not_end_ends_the_stage_of_a_rover_that_waits() -> None:
    radio, _ = both_radios()
    radio.stage = "place"
    for now in np.arange(0.0, PATIENCE, 0.5):
        radio.begin_tick(float(now))
        radio.wait()
    radio.begin_tick(PATIENCE + 0.5)
    with pytest.raises(StageError, match="place: nothing heard from rover2 for 60 s"):
        radio.wait()
