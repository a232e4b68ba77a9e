"""Sensors of a rover on a slope, against the geometry of its plane."""

import dataclasses
import math

import numpy as np
import pytest

from models.compose import RobotPlacement
from models.datasheets import INCLINOMETER
from tests.models.scenes import PLAIN, make_scene
from twin.hardware.emulator.rover import ANALOGUE_SENSORS
from twin.hardware.emulator.scene import SceneConfig, simulate
from twin.robot import ArmMode, Command, WheelMode
from twin.sensors import DATASHEET, IDEAL
from twin.simulation import Simulation

SLOPE = (math.radians(6.0), math.radians(-4.0))
YAWS = (0.0, 0.7)
LEAN = math.radians(0.15)
"""How much further than the slope the springs let a rover lean: some thousandth of its weight
for each degree."""


def attitude(axes, up):
    """Return pitch and roll [rad] of what looks along the second of its axes (3, 3)."""
    right, forward, above = axes @ up
    return np.array([math.asin(forward), math.atan2(-right, above)])


def plane_axes(yaw):
    """Right, ahead and normal (3, 3) of a robot that stands flat on the plane."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def tilts_at_rest(field, yaw, suite):
    """Stand still for 3 s; return the readings of the last two, and the true axes (3, 3)."""
    scene = make_scene(RobotPlacement(yaw=yaw), field=field)
    simulation = Simulation(scene.model, ["rover1"], suite=suite, data=scene.start())
    robot, start = simulation.robots["rover1"], scene.rest.body("rover1/chassis").xpos
    robot.activate()
    home = robot.observe().arm_angles.value
    robot.command(Command(np.zeros(4), home, WheelMode.SPEED, ArmMode.POSITION))
    seen = []
    for tick in range(300):
        simulation.tick()
        if tick >= 100:
            seen.append(robot.observe())
    creep = np.linalg.norm(simulation.data.body("rover1/chassis").xpos - start)
    assert creep < 1e-3
    return seen, simulation.data.site("rover1/imu").xmat.reshape(3, 3).T


@pytest.mark.parametrize("yaw", YAWS)
def test_inclinometer_of_a_rover_that_stands_on_a_slope_reads_its_pitch_and_roll(yaw):
    field = dataclasses.replace(PLAIN, slope=SLOPE, friction=0.6)
    seen, axes = tilts_at_rest(field, yaw, DATASHEET)
    level, _ = tilts_at_rest(PLAIN, yaw, DATASHEET)
    # A new sample every fourth tick.
    readings = np.array([each.inclinometer.value for each in seen])
    mean, samples = readings.mean(axis=0), len(readings) / 4
    within = 4.0 * INCLINOMETER.noise / math.sqrt(samples)
    np.testing.assert_allclose(mean, attitude(axes, field.up), atol=within)
    # Its load tilts the rover on its springs on level ground, too.
    load = np.mean([each.inclinometer.value for each in level], axis=0)
    wanted = attitude(plane_axes(yaw), field.up)
    np.testing.assert_allclose(mean - load, wanted, atol=LEAN + 2.0 * within)
    if yaw == 0.0:
        across = math.asin(math.sin(SLOPE[0]) / math.cos(SLOPE[1]))
        np.testing.assert_allclose(wanted, [SLOPE[1], -across], atol=1e-12)


@pytest.mark.parametrize("yaw", YAWS)
def test_sensors_of_the_orientation_refer_to_the_level(yaw):
    field = dataclasses.replace(PLAIN, slope=SLOPE, friction=0.6)
    seen, axes = tilts_at_rest(field, yaw, IDEAL)
    np.testing.assert_allclose(seen[-1].inclinometer.value, attitude(axes, field.up), atol=1e-6)
    # North lies level, below or above the field's y axis.
    north = np.array([0.0, 1.0, 0.0]) - field.up[1] * field.up
    east = np.cross(north, field.up)
    forward = axes[1]
    heading = math.atan2(-forward @ east, forward @ north)
    assert seen[-1].heading.value[0] == pytest.approx(heading, abs=1e-6)
    assert heading == pytest.approx(yaw, abs=0.01)


def test_emulated_boards_stand_on_the_slope_too():
    field = dataclasses.replace(PLAIN, slope=SLOPE)
    scene = SceneConfig.from_json(SceneConfig((RobotPlacement(),), field).to_json())
    simulation = simulate(scene, ANALOGUE_SENSORS)
    simulation.settle(0.1)
    axes = simulation.data.site("rover1/imu").xmat.reshape(3, 3).T
    reading = simulation.robots["rover1"].observe().inclinometer.value
    simulation.close()
    np.testing.assert_allclose(reading, attitude(axes, field.up), atol=4.0 * INCLINOMETER.noise)
