"""Two emulated rovers with cameras and radio, opened by their ports' paths."""

import numpy as np
import pytest

from tests.twin.hardware.realtime_emulator import serial_target
from twin.connect import connect
from twin.loop import run
from twin.robot import Command, Lifecycle, WheelMode

ROVERS = ("rover1", "rover2")
SLOW_DOWN = 10
"""On two cores that are both busy otherwise a pair takes up to a second from request to image."""


class DriveLookAndTalk:
    """Drives slowly, reads every second stereo pair and sends its wheel speeds over the radio."""

    def __init__(self, links):
        self.links = links
        self.images = {name: {} for name in links}
        self.sent = {name: [] for name in links}
        self.heard = {name: [] for name in links}

    def reset(self):
        pass

    def step(self, observations):
        for name, observed in observations.items():
            pair, images = observed.stereo, self.images[name]
            if pair.usable and all(pair.stamp - stamp > 0.4 for stamp in images):
                images[pair.stamp] = np.array(pair.value)
            self.heard[name] += self.links[name].poll().messages
            self.sent[name].append(b"w" + observed.wheel_speeds.value.tobytes())
            self.links[name].send_latest(self.sent[name][-1])
        return dict.fromkeys(observations, Command(np.full(4, 2.0), wheel_mode=WheelMode.SPEED))


@pytest.mark.slow
def test_two_rovers_opened_by_path_drive_see_and_talk_without_a_stop(tmp_path):
    with (
        serial_target(ROVERS, SLOW_DOWN, tmp_path) as target,
        connect(target) as connection,
    ):
        controller = DriveLookAndTalk(connection.links)
        summary = run(connection.robots, [controller], connection.clock, duration=1.2)
        assert {robot.fault for robot in connection.robots.values()} == {""}
        # A busy machine may make the last tick long; it never makes the run short.
        assert summary.duration >= 1.2
        for name, other in (ROVERS, ROVERS[::-1]):
            images = list(controller.images[name].values())
            assert len(images) >= 2
            for pair in images:
                assert pair.shape[0] == 2 and pair.dtype == np.uint8
                assert pair.std() > 5.0 and np.any(pair[0] != pair[1])
            # What this one heard is what the other sent, and the other drove.
            heard = controller.heard[name]
            assert len(heard) >= 3 and set(heard) <= set(controller.sent[other])
            speeds = [np.frombuffer(message[1:]) for message in heard]
            assert np.max(speeds) > 1.0, (name, other)
    assert {r.lifecycle for r in connection.robots.values()} == {Lifecycle.UNCONFIGURED}
