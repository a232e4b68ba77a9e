"""Motions that tell more of a change: gentle, back where they began, of what changed."""

import numpy as np
import pytest

from controllers.motion.teleoperation import Teleoperation
from controllers.sensing.diagnosis import UNKNOWN, Finding
from controllers.sensing.loose_camera import LOOSE_CAMERA
from controllers.sensing.probing import PERIOD, SHARE, probe, probes
from models.compose import RobotPlacement
from twin.connect import connect
from twin.describe import describe_rover
from twin.loop import LoopRecorder, run
from twin.robot import Command
from twin.shadow.deviations import rover_deviations, shadow_scene
from twin.shadow.shadow import Shadow

ROVER = describe_rover("rover1")
SETTLED = 3.0
"""Time in which a rover that was put down comes to rest [s]."""
TIMES = np.arange(0.0, 4.0 * PERIOD, 0.01)
CHANGES = [each.name for each in rover_deviations(ROVER) if each.change > 0.0] + ["battery"]


def asked(name, times=TIMES):
    """(n, 2 + joints) what is asked of wheels and arm."""
    rows = [probe(Finding(name, 0.1, 0.01, 9.0), ROVER, float(time)) for time in times]
    return np.array([[each.ahead, each.left, *each.arm] for each in rows])


@pytest.mark.parametrize("name", CHANGES)
def test_each_is_gentle_moves_something_and_ends_where_it_began(name):
    rows = asked(name)
    assert 0.99 * SHARE < np.abs(rows).max() <= SHARE
    for end in (1, 2, 3, 4):
        place = np.sum(rows[: round(end * PERIOD / 0.01)], axis=0) * 0.01
        np.testing.assert_allclose(place, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "moved"),
    [
        ("supply elbow", {"elbow"}),
        ("zero wrist", {"wrist"}),
        ("load gripper", {"elbow"}),
        ("grip rear_left", {"ahead", "left"}),
        ("load base", {"ahead", "left"}),
        ("zero roll", {"ahead", "left"}),
        ("battery", {"ahead", "left"}),
    ],
)
def test_what_changed_is_moved(name, moved):
    names = ["ahead", "left", *ROVER.joint_names]
    assert {names[i] for i in np.flatnonzero(np.abs(asked(name)).max(axis=0))} == moved


@pytest.mark.parametrize("name", [UNKNOWN, LOOSE_CAMERA])
def test_of_what_is_unknown_and_of_a_camera_no_motion_tells_more(name):
    found = Finding(name, 0.02, 0.0, 9.0)
    assert not probes(found)
    with pytest.raises(ValueError, match=f"{name}: no motion tells more"):
        probe(found, ROVER, 0.0)


class Asking:
    """Asks a rover's hand what tells more of a change."""

    def __init__(self, name):
        self._finding, self._hand = Finding(name, 0.1, 0.01, 9.0), Teleoperation(ROVER, 0.15)

    def reset(self):
        self._hand.reset()

    def step(self, observations):
        if self._finding.name != UNKNOWN:
            self._hand.ask(*probe(self._finding, ROVER, observations[ROVER.name].time))
        return self._hand.step(observations)


class Informed(LoopRecorder):
    """Keeps what a shadow's innovations tell of its one deviation."""

    def __init__(self, shadow):
        self._shadow, self._applied = shadow, Command(np.zeros(4), np.zeros(4))
        self.rows = []

    def record(self, tick):
        found = self._shadow.step(tick.observations[ROVER.name], self._applied)
        self._applied = tick.applied[ROVER.name]
        if found is not None and found.time > SETTLED:
            self.rows.append(found.sensitivities[0] / found.sigma)

    @property
    def information(self):
        # What is the same at all times, an offset of the reading explains as well.
        return float(np.nansum(np.nanvar(self.rows, axis=0)) * len(self.rows))


@pytest.mark.parametrize("name", ["drag rear_left", "grip all", "spring rear_left", "supply elbow"])
def test_it_tells_far_more_of_the_change_than_standing_still_does(name):
    (deviation,) = (each for each in rover_deviations(ROVER) if each.name == name)
    told = []
    for asking in (name, UNKNOWN):
        shadow = Shadow(shadow_scene(RobotPlacement(ROVER.name)), ROVER, [deviation])
        informed = Informed(shadow)
        with connect("sim", realism="ideal", seed=4) as connection:
            run(connection.robots, [Asking(asking)], connection.clock, [informed], 3.0 * PERIOD)
        shadow.close()
        told.append(informed.information)
    assert told[0] > 20.0 * told[1], told  # noqa: PLR2004
