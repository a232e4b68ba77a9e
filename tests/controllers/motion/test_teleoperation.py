"""A person's hand on a rover: in MuJoCo, and by itself."""

import math

import numpy as np
import pytest

from controllers.motion.teleoperation import Teleoperation, largest_speed
from models.compose import RobotPlacement
from tests.controllers.motion.seen import seen_at
from tests.models.scenes import PLAIN, make_scene
from twin.describe import describe_rover
from twin.robot import ArmMode, Observation, WheelMode
from twin.simulation import Simulation

ROBOT = "rover1"
ROVER = describe_rover(ROBOT)
STILL = (0.0, 0.0, 0.0, 0.0)


class Hand:
    """A simulated rover that a person drives, with its true place and motion."""

    def __init__(self, speed):
        scene = make_scene(RobotPlacement(ROBOT, stereo=False), field=PLAIN)
        self.simulation = Simulation(scene.model, [ROBOT], seed=5, data=scene.start())
        self.hand = Teleoperation(ROVER, speed)
        self.robot = self.simulation.robots[ROBOT]
        self.robot.activate()

    def run(self, seconds, asked=None):
        """Run, asked again every 50 ms; return the true speed of each tick [m/s]."""
        before, speeds = self.place, []
        for tick in range(round(seconds / 0.01)):
            if asked is not None and tick % 5 == 0:
                self.hand.ask(*asked)
            self.robot.command(self.hand.step({ROBOT: self.robot.observe()})[ROBOT])
            self.simulation.tick()
            speeds.append(math.dist(self.place, before) / 0.01)
            before = self.place
        return np.array(speeds)

    @property
    def place(self):
        return self.simulation.data.body(f"{ROBOT}/chassis").xpos[:2].copy()

    @property
    def yaw(self):
        axes = self.simulation.data.body(f"{ROBOT}/chassis").xmat
        return math.atan2(-axes[1], axes[4])

    @property
    def arm(self):
        names = (f"{ROBOT}/{joint}_joint" for joint in ROVER.joint_names)
        return np.array([self.simulation.data.joint(name).qpos[0] for name in names])


@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_it_drives_at_the_limit_and_stands_soon_after_it_is_let_go(ahead):
    rover = Hand(0.2)
    assert rover.run(0.5).max() < 0.01
    begin = rover.place
    speeds = rover.run(2.0, (ahead, 0.0, STILL))
    assert speeds[100:].mean() == pytest.approx(0.2, rel=0.05)
    assert ahead * (rover.place - begin)[1] > 0.3
    rover.hand.rest()
    assert rover.run(0.4)[20:].max() < 0.01


def test_who_is_gone_stops_it_within_three_tenths_of_a_second():
    rover = Hand(0.3)
    rover.run(1.0, (1.0, 0.0, STILL))
    rover.hand.ask(1.0, 0.0, STILL)
    speeds = rover.run(0.6)
    assert speeds[:15].min() > 0.2 and speeds[30:].max() < 0.01


def test_wheels_are_no_faster_in_a_turn_than_the_limit():
    rover = Hand(0.2)
    before = rover.yaw
    rover.run(1.0, (1.0, 1.0, STILL))
    speeds = ROVER.wheel_radius * np.asarray(rover.robot.observe().wheel_speeds.value)
    assert np.abs(speeds).max() < 0.2 * 1.1 and speeds[1] > speeds[0] + 0.1
    assert rover.yaw - before > 0.1


@pytest.mark.parametrize("joint", range(4))
def test_a_joint_turns_at_its_rate_and_holds_where_it_is_let_go(joint):
    rover = Hand(0.2)
    rover.run(0.3)
    begin, turning = rover.arm, [float(index == joint) for index in range(4)]
    rover.run(1.0, (0.0, 0.0, turning))
    there = rover.arm
    assert (there - begin)[joint] == pytest.approx(0.4, abs=0.04)
    assert np.abs(np.delete(there - begin, joint)).max() < 0.02
    rover.hand.rest()
    rover.run(1.0)
    np.testing.assert_allclose(rover.arm, there, atol=0.015)


def test_a_goal_ends_at_the_joint_s_limit_and_near_a_joint_that_is_held_up():
    hand = Teleoperation(ROVER, 0.1)
    high = ROVER.arm.limits[0, 1]
    for tick in range(100):
        hand.ask(0.0, 0.0, (1.0, 0.0, 0.0, 0.0))
        near = np.array([high - 0.01, 0.9, -1.4, 0.1])
        command = hand.step({ROBOT: seen_at(0.01 * tick, arm_angles=near)})[ROBOT]
    assert command.arm[0] == high and command.arm_rates[0] == 0.0
    hand.reset()
    for tick in range(100):
        hand.ask(0.0, 0.0, (-1.0, 0.0, 0.0, 0.0))
        command = hand.step({ROBOT: seen_at(0.01 * tick, arm_angles=np.zeros(4))})[ROBOT]
    assert command.arm[0] == pytest.approx(-0.08) and command.arm[1] == 0.0


def test_the_arm_is_left_alone_until_its_angles_are_known():
    hand = Teleoperation(ROVER, 0.1)
    hand.ask(1.0, 0.0, (1.0, 1.0, 1.0, 1.0))
    command = hand.step({ROBOT: Observation(0.0)})[ROBOT]
    assert not command.arm.size and command.arm_mode is ArmMode.DUTY
    assert command.wheel_mode is WheelMode.SPEED and command.wheels.min() > 0.0


def test_the_drawing_limits_the_speed():
    # Thesis app. D: 49 rpm, 25 cm/s, under 208 oz-in; the motor stalls at 908.
    assert largest_speed(ROVER) == pytest.approx(0.25 / (1.0 - 208.0 / 908.0), rel=2e-3)
    for speed in (0.0, -0.1, 0.33, math.nan):
        with pytest.raises(ValueError, match=r"expected above 0 to 0\.32 m/s"):
            Teleoperation(ROVER, speed)
    with pytest.raises(ValueError, match="4 joints"):
        Teleoperation(ROVER, 0.1).ask(0.0, 0.0, (1.0,))
