"""A motion is played from where the arm is, over time, and to its end."""

import numpy as np
import pytest

from controllers.motion.playback import MotionPlayer
from models.compose import FLAT, RobotPlacement
from twin.connect import connect
from twin.loop import LoopRecorder, run
from twin.robot import ArmMode, Channel, Observation, Validity

STAMPS = np.array([5.0, 6.0, 8.0])
ANGLES = np.array([[0.2, 0.9, -1.4, 0.1], [0.2, 0.7, -1.0, 0.1], [0.2, 0.9, -1.0, 0.5]])


def seen(time, angles):
    there = Channel(np.asarray(angles), time, Validity.MEASURED)
    return {"rover1": Observation(time, arm_angles=there)}


def test_it_goes_to_the_start_rests_and_follows_the_straight_lines_between_times():
    player = MotionPlayer("rover1", STAMPS, ANGLES, speed=0.5)
    home = np.array([0.0, 0.9, -1.4, 0.1])
    first = player.step(seen(0.0, home))["rover1"]
    np.testing.assert_allclose(first.arm, home)
    half = player.step(seen(0.2, home))["rover1"]
    np.testing.assert_allclose(half.arm, [0.1, 0.9, -1.4, 0.1])
    np.testing.assert_allclose(half.arm_rates, [0.5, 0.0, 0.0, 0.0])
    player.step(seen(0.5, ANGLES[0]))
    player.step(seen(2.0, ANGLES[0]))  # At rest for long enough: here it begins.
    command = player.step(seen(2.5, ANGLES[0]))["rover1"]
    np.testing.assert_allclose(command.arm, [0.2, 0.8, -1.2, 0.1])
    assert command.arm_mode is ArmMode.POSITION and not player.done
    command = player.step(seen(4.0, ANGLES[0]))["rover1"]
    np.testing.assert_allclose(command.arm, 0.5 * (ANGLES[1] + ANGLES[2]))
    player.step(seen(5.0, ANGLES[0]))
    assert player.done and player.played == pytest.approx(3.0)


class Angles(LoopRecorder):
    def __init__(self):
        self.rows = []

    def record(self, tick):
        self.rows.append(tick.observations["rover1"].arm_angles.value)


def test_a_rover_follows_it():
    angles = Angles()
    with connect("sim", robots=[RobotPlacement("rover1")], field=FLAT) as connection:
        player = MotionPlayer("rover1", STAMPS, ANGLES)
        run(connection.robots, [player], connection.clock, [angles], 20.0, lambda: player.done)
    rows = np.array(angles.rows)
    assert np.abs(rows[:, 0].max() - 0.2) < 0.03
    assert rows[:, 1].min() == pytest.approx(0.7, abs=0.05)
    np.testing.assert_allclose(rows[-1], ANGLES[-1], atol=0.1)
