"""Realism by name: what it changes, and that ideal changes nothing."""

import dataclasses

import numpy as np
import pytest

from models.as_made import AsMade
from models.compose import FLAT, RobotPlacement, make_model, settle
from models.datasheets import EXACT, SENSOR_ERRORS, TOLERANCES, SensorErrorSheet
from tests.twin.hardware.bridges import add_bridges
from twin.camera import StereoConfig
from twin.connect import connect
from twin.describe import describe_placement
from twin.hardware.calibration.calibration import calibration_path, read_calibration
from twin.hardware.emulator.rover import ANALOGUE_SENSORS
from twin.hardware.emulator.scene import SETTLING, SceneConfig
from twin.realism import REALISMS, Realism, make_robots
from twin.robot import ArmMode, Command, Observation
from twin.sensor_bank import tilt
from twin.sensors import DATASHEET, IDEAL
from twin.simulation import Simulation

PLAIN = dataclasses.replace(FLAT, texture_pixels=16)
NAMES = "rover1", "rover2"
PLACES = tuple(RobotPlacement(name, (x, 0.0)) for name, x in zip(NAMES, (-0.6, 0.6)))
CHANNELS = Observation._fields[1:-1]
NO_ERRORS = SensorErrorSheet(
    **{field.name: 0.0 for field in dataclasses.fields(SensorErrorSheet)} | {"wrench_warm_up": 1.0}
)


def swing(tick):
    """An arm motion that shakes the rover."""
    angles = np.array([0.3, 0.9, -1.4, 0.1]) + 0.3 * np.sin(2.0 * np.pi * 2.0 * 0.01 * tick)
    return Command(np.full(4, 0.1), angles, arm_mode=ArmMode.POSITION)


def drive(robots, clock, ticks=30):
    """Return what the robots observed, by robot, tick and channel, as bytes."""
    seen = []
    for robot in robots.values():
        robot.activate()
    for tick in range(ticks):
        for robot in robots.values():
            robot.command(swing(tick))
        clock.tick()
        for robot in robots.values():
            observed = robot.observe()
            channels = [getattr(observed, name) for name in CHANNELS]
            seen.append(tuple(c.value.tobytes() if c.usable else b"" for c in channels))
    return seen


def run_of(target="sim", **options):
    with connect(target, robots=PLACES, field=PLAIN, seed=4, **options) as link:
        return drive(link.robots, link.clock)


@pytest.fixture(scope="module")
def ideal():
    return run_of(realism="ideal")


def test_ideal_robots_are_those_of_the_drawing_and_the_data_sheets_bit_for_bit(ideal):
    model = make_model(PLAIN, PLACES)
    simulation = Simulation(model, NAMES, suite=DATASHEET, seed=4, data=settle(model, SETTLING))
    assert drive(simulation.robots, simulation) == ideal == run_of()


def test_errors_and_tolerances_of_zero_change_nothing(ideal):
    assert run_of(realism=Realism(sensor_errors=NO_ERRORS, tolerances=EXACT)) == ideal


@pytest.mark.parametrize("part", ["sensor_errors", "tolerances"])
def test_each_part_of_the_default_changes_what_is_observed(part, ideal):
    changed = Realism(**{part: getattr(REALISMS["default"], part)})
    seen = run_of(realism=changed)
    assert seen != ideal and run_of(realism=changed) == seen


def test_two_rovers_are_unlike_and_a_further_one_changes_no_other():
    first, second = make_robots(PLACES, "default", 4)
    assert first.made and second.made and first.made.seed != second.made.seed
    assert make_robots(PLACES[:1], "default", 4) == (first,)
    assert make_robots(PLACES, "default", 5)[0] != first
    assert first.made.tolerances == TOLERANCES
    assert make_robots(PLACES, "ideal", 4) == PLACES


def test_sensors_of_two_rovers_are_unlike_and_a_further_one_changes_no_other():
    def zeros(places):
        """What each robot's encoders say beyond its true joint angles."""
        exact = Realism(IDEAL, SENSOR_ERRORS)
        with connect("sim", robots=places, field=PLAIN, seed=4, realism=exact) as link:
            found = []
            for name, robot in link.robots.items():
                joints = [f"{name}/{joint}_joint" for joint in robot.description.joint_names]
                true = [link.simulation.data.joint(joint).qpos[0] for joint in joints]
                found.append(robot.observe().arm_angles.value - true)
        return found

    one, two = zeros(PLACES)
    assert np.all(np.abs([one, two]) <= SENSOR_ERRORS.encoder_zero)
    assert np.all(np.abs(one - two) > 1e-6)
    np.testing.assert_allclose(zeros(PLACES[:1])[0], one, atol=1e-12)


def test_what_is_made_already_or_the_users_own_stays():
    own = RobotPlacement("mine", model="mine.xml")
    made = RobotPlacement(made=AsMade(1))
    assert make_robots([made, own], "harsh", 0) == (made, own)


def test_unknown_realism_is_named_with_what_there_is():
    with pytest.raises(ValueError, match="realism 'real'; available: ideal, default, harsh"):
        connect("sim", realism="real")  # pyright: ignore[reportArgumentType]


def test_controllers_get_the_drawing_of_a_robot_as_made():
    with connect("sim", field=PLAIN, realism="harsh") as link:
        (robot,) = link.robots.values()
        assert robot.description is describe_placement(RobotPlacement("rover1"))  # it is cached


def test_harsh_is_further_off_than_default():
    default, harsh = REALISMS["default"], REALISMS["harsh"]
    for part in ("tolerances", "sensor_errors", "clock"):
        small = dataclasses.asdict(getattr(default, part))
        large = dataclasses.asdict(getattr(harsh, part))
        small.pop("wrench_warm_up", None)
        for name, value in small.items():
            if name == "tyre_friction":
                assert large[name][0] < value[0] and large[name][1] > value[1]
            else:
                assert np.all(np.array(large[name]) > np.array(value)), name


def test_scene_with_robots_as_made_survives_its_way_to_the_emulator():
    scene = SceneConfig(make_robots(PLACES, "harsh", 4), PLAIN, 4, None, SENSOR_ERRORS)
    assert SceneConfig.from_json(scene.to_json()) == scene


def counts_of(robot):
    """Return the size of a count of each channel of a rover's boards."""
    calibration = read_calibration(calibration_path(robot))
    step = calibration.analogue.step
    axes = calibration.inclinometer.pitch, calibration.inclinometer.roll
    return {
        "arm_angles": 2.0 * np.pi / 2**14,
        "centre_angle": step / calibration.analogue.centre.volts_per_radian,
        "inclinometer": step / np.array([each.volts_per_radian for each in axes]),
        "arm_base_wrench": 1e-6,
    }


def test_boards_show_the_errors_that_the_simulation_shows():
    """The same robots and seeds: the readings differ by half a count."""
    behind = dataclasses.replace(REALISMS["harsh"], suite=ANALOGUE_SENSORS)
    with (
        connect("sim", robots=PLACES, field=PLAIN, seed=4, realism=behind) as plain,
        connect("quantised", robots=PLACES, field=PLAIN, seed=4, realism="harsh") as boards,
    ):
        for name in NAMES:
            true, seen = plain.robots[name].observe(), boards.robots[name].observe()
            for channel, count in counts_of(name).items():
                difference = getattr(seen, channel).value - getattr(true, channel).value
                assert np.all(np.abs(difference) < 0.51 * count), channel
            joints = plain.robots[name].description.joint_names
            data = plain.simulation.data
            at = np.array([data.joint(f"{name}/{joint}_joint").qpos[0] for joint in joints])
            assert np.all(np.abs(seen.arm_angles.value - at) > 1e-4)


def test_emulated_boards_are_the_quantised_ones_with_wires():
    robots, options = PLACES[:1], {"field": PLAIN, "seed": 4, "realism": "default"}
    with (
        connect("quantised", robots=robots, **options) as direct,
        connect("emulated", robots=robots, **options) as wired,
    ):
        assert drive(direct.robots, direct.clock, 20) == drive(wired.robots, wired.clock, 20)


def test_emulated_inclinometer_is_shaken_as_the_simulated_one_is():
    """Specific force, low-passed at the rate of the physics: not the orientation, of either."""
    behind = Realism(ANALOGUE_SENSORS)
    robots, count = PLACES[:1], counts_of("rover1")["inclinometer"]
    apart, true_tilt, read = [], [], []
    with (
        connect("quantised", robots=robots, field=PLAIN, seed=4) as boards,
        connect("sim", robots=robots, field=PLAIN, seed=4, realism=behind) as plain,
    ):
        (robot,), (twin,) = boards.robots.values(), plain.robots.values()
        add_bridges(plain, twin.name)
        robot.activate()
        twin.activate()
        for tick in range(200):
            robot.command(swing(tick))
            boards.clock.tick()
            applied = boards.simulation.data.ctrl.copy() / 12.0
            twin.command(Command(applied[:4], applied[4:]))
            plain.clock.tick()
            seen, other = robot.observe(), twin.observe()
            if seen.inclinometer.stamp == seen.time:
                apart.append(seen.inclinometer.value - other.inclinometer.value)
                read.append(seen.inclinometer.value[0])
                turn = boards.simulation.data.sensor("rover1/orientation").data
                true_tilt.append(tilt(*turn.tolist())[0])
    assert len(apart) >= 40
    assert np.all(np.abs(apart) < 0.51 * count)
    shaken = np.array(read) - np.array(true_tilt)
    assert np.std(shaken) > np.std(true_tilt)  # 2.6 times as much


@pytest.mark.parametrize("target", ["sim", "quantised"])
def test_cameras_are_as_late_as_the_set_says(target):
    for name, realism in REALISMS.items():
        with connect(
            target, robots=PLACES[:1], field=PLAIN, stereo=StereoConfig(2.0), realism=name
        ) as link:
            seen = link.robots[NAMES[0]].observe()
            # The first pair was exposed before the start.
            assert seen.time - seen.stereo.stamp == pytest.approx(realism.cameras.latency, rel=2e-4)
    assert REALISMS["ideal"].cameras.latency == 0.0 < REALISMS["default"].cameras.latency


def test_head_is_described_by_the_deviations_of_its_set_and_by_nothing_drawn():
    described = []
    for seed in (1, 2):
        with connect(
            robots=PLACES, field=PLAIN, seed=seed, stereo=StereoConfig(), realism="harsh"
        ) as link:
            described += [robot.description.head for robot in link.robots.values()]
    cameras = REALISMS["harsh"].cameras
    for head in described:
        assert head.calibration == cameras.calibration
        assert head.calibration.eye_turn == cameras.eye_turn > 0.0
        assert head.exposure == cameras.exposure
