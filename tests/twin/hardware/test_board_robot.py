"""The robot over boards: its states, its commands and its samples."""

import math
from contextlib import nullcontext

import numpy as np
import pytest

from tests.twin.hardware.board_tables import (
    ARM_COUNT,
    CALIBRATION,
    FORWARD,
    PERIOD,
    WHEEL_COUNT,
    Bench,
)
from twin import servo
from twin.connect import connect
from twin.hardware.board_set import WiredBoards
from twin.hardware.serial_link import LinkError
from twin.robot import (
    NOTHING,
    ArmMode,
    Channel,
    Command,
    Lifecycle,
    RobotError,
    Validity,
    WheelMode,
)

pytestmark = pytest.mark.virtual_time


@pytest.fixture
def bench():
    return Bench()


def test_unconfigured_robot_raises_an_error_and_sends_nothing(bench):
    for call in (bench.robot.observe, bench.robot.activate, lambda: bench.robot.home(np.zeros(4))):
        with pytest.raises(RobotError, match="robot 'rover1' is unconfigured"):
            call()
    with pytest.raises(RobotError, match="robot 'rover1' is unconfigured, not active"):
        bench.robot.command(Command())
    bench.robot.deactivate()
    assert not bench.boards.asked and not bench.boards.driven


def test_configured_robot_is_zeroed_and_inactive_and_reads_but_never_drives(bench):
    bench.robot.configure()
    assert bench.robot.lifecycle is Lifecycle.INACTIVE
    assert not np.any(bench.boards.taken()) and set(bench.boards.timeouts.values()) == {0.2}
    sent = len(bench.boards.driven)
    with pytest.raises(RobotError, match="robot 'rover1' is inactive, not active"):
        bench.robot.command(Command(np.ones(4)))
    assert bench.robot.observe().wheel_speeds.usable and len(bench.boards.driven) == sent


def test_arm_angles_are_missing_and_activation_is_refused_before_homing(bench):
    bench.robot.configure()
    assert bench.robot.observe().arm_angles.validity is Validity.MISSING
    with pytest.raises(RobotError, match="'rover1' does not know where its arm is"):
        bench.robot.activate()
    angles = np.array([0.3, -0.2, 0.1, 1.2])
    bench.robot.home(angles)
    np.testing.assert_allclose(
        bench.robot.observe().arm_angles.value, angles, atol=0.51 * ARM_COUNT
    )
    bench.robot.activate()
    assert bench.robot.lifecycle is Lifecycle.ACTIVE


def test_deactivation_and_closing_zero_all_axes(bench):
    bench.active().cycle()
    assert np.all(bench.boards.taken() != 0)
    bench.robot.deactivate()
    assert bench.robot.lifecycle is Lifecycle.INACTIVE and not np.any(bench.boards.taken())
    bench.robot.activate()
    bench.cycle()
    assert np.all(bench.boards.taken() != 0)
    bench.robot.close()
    assert bench.robot.lifecycle is Lifecycle.UNCONFIGURED
    assert not np.any(bench.boards.taken()) and bench.boards.closed


@pytest.mark.parametrize("before", [Lifecycle.UNCONFIGURED, Lifecycle.ACTIVE])
def test_robot_whose_board_is_silent_when_it_is_set_up_stays_unconfigured(bench, before):
    if before is Lifecycle.ACTIVE:
        bench.active()
    bench.boards.silent = {0x82}
    with pytest.raises(RobotError, match="0x80, 0x81, 0x83: zero confirmed; 0x82: sent"):
        bench.robot.configure()
    assert bench.robot.lifecycle is Lifecycle.UNCONFIGURED


def test_duty_beyond_full_is_clamped_and_what_is_applied_is_returned(bench):
    bench.active()
    asked = Command(np.array([1.7, -40.0, 0.3, -0.3]), np.array([1e9, -1e9, 0.1, 0.0]))
    applied = bench.robot.command(asked)
    codes = np.array([32767, 32767, 9830, 9830, 32767, -32767, 3277, 0])
    np.testing.assert_array_equal(bench.boards.taken(), codes)
    np.testing.assert_allclose(applied.wheels, [1.0, -1.0, 9830 / 32767, -9830 / 32767])
    np.testing.assert_allclose(applied.arm, [1.0, -1.0, 3277 / 32767, 0.0])


@pytest.mark.parametrize("mode", WheelMode)
@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_what_is_not_finite_never_comes_to_the_wire(bench, mode, wrong):
    bench.active().cycle()
    sent = len(bench.boards.driven)
    with pytest.raises(ValueError, match="nothing was sent"):
        Command(np.array([0.0, wrong, 0.0, 0.0]), wheel_mode=mode)
    wheels = np.zeros(4)
    command = Command(wheels, wheel_mode=mode)
    wheels[1] = wrong  # After the check: the command has its own.
    bench.robot.command(command)
    with pytest.raises(ValueError, match="read-only"):
        command.wheels[1] = wrong
    assert len(bench.boards.driven) == sent + 1 and not np.any(bench.boards.taken())


class Failing(Exception):
    """Whatever may go wrong between a command and the wire."""


@pytest.mark.parametrize("error", [KeyError, ValueError, MemoryError, KeyboardInterrupt, Failing])
def test_any_failure_between_a_command_and_the_wire_stops_the_robot(bench, error, monkeypatch):
    bench.active().cycle()
    assert np.all(bench.boards.taken() != 0)

    def fail(*_):
        raise error("amid a command")

    monkeypatch.setattr(type(bench.robot.calibration.drive), "duty_codes", fail)
    with pytest.raises(error, match="amid a command"):
        bench.robot.command(Command())
    assert not np.any(bench.boards.taken()) and bench.robot.lifecycle is Lifecycle.ERROR
    assert f"{error.__name__}: " in bench.robot.fault
    assert bench.robot.fault.endswith("; boards 0x80, 0x81, 0x82, 0x83: zero confirmed")


@pytest.mark.parametrize("part", ["wheels", "arm", "arm_rates"])
def test_command_of_another_size_stops_the_robot(bench, part):
    bench.active().cycle()
    with pytest.raises(ValueError, match="the robot has 4 wheels and 4 joints"):
        bench.robot.command(Command(**{part: np.ones(3)}))
    assert not np.any(bench.boards.taken()) and bench.robot.lifecycle is Lifecycle.ERROR


def test_pause_of_the_process_amid_a_command_stops_the_robot(bench, monkeypatch):
    bench.active().cycle()
    drive = bench.boards.drive

    def pause(codes):
        bench.time += 0.8
        drive(codes)

    monkeypatch.setattr(bench.boards, "drive", pause)
    bench.robot.command(Command(np.ones(4)))
    bench.robot.observe()
    assert bench.robot.fault.startswith("no command for 0.80 s")
    assert not np.any(bench.boards.taken())


def test_command_that_comes_late_drives_nothing(bench):
    """As after a pause of the whole process, when nobody knows what the world does."""
    bench.active().cycle()
    bench.time += 0.151
    with pytest.raises(RobotError, match="no command for 0.15 s; boards 0x80.*zero confirmed"):
        bench.robot.command(Command(np.ones(4)))
    assert not np.any(bench.boards.taken())


@pytest.mark.parametrize("step", [30, -30])
@pytest.mark.parametrize("start", [2**31 - 100, -(2**31) + 100])
def test_wheels_turn_on_evenly_while_their_counters_wrap(bench, start, step):
    bench.homed().boards.counters[:4] = start
    bench.robot.activate()
    expected = FORWARD[:4] * step * WHEEL_COUNT / PERIOD
    moved = np.array([step] * 4 + [0] * 4)
    for _ in range(12):
        speeds = bench.cycle(moved=moved).wheel_speeds
        assert speeds.validity is Validity.MEASURED
        np.testing.assert_allclose(speeds.value, expected, rtol=1e-9)
    assert bench.robot.lifecycle is Lifecycle.ACTIVE


def test_homing_refuses_an_arm_that_moves(bench):
    bench.robot.configure()
    bench.boards.creep[6] = 3
    with pytest.raises(RobotError, match="'rover1': the arm moves; hold it still to home"):
        bench.robot.home(np.zeros(4))
    with pytest.raises(RobotError, match="does not know where its arm is"):
        bench.robot.activate()
    # The four boards are asked between two readings of one.
    bench.boards.creep[6] = 0
    bench.boards.creep[0] = 500
    bench.robot.home(np.zeros(4))


@pytest.mark.parametrize(("after", "ready"), [(0.9, True), (1.1, False)])
def test_robot_waits_a_second_for_an_arm_that_settles_and_a_first_sample(
    bench, monkeypatch, after, ready
):
    whole = dict(bench.boards.pins)
    bench.boards.pins[1] = None
    bench.boards.creep[6] = 3
    start = 0.0

    def settle(seconds):
        bench.time += seconds
        if bench.time - start > after:
            bench.boards.creep[6] = 0
            bench.boards.pins = dict(whole)

    monkeypatch.setattr("twin.hardware.board_robot.time.sleep", settle)
    bench.robot.configure()
    with nullcontext() if ready else pytest.raises(RobotError, match="the arm moves"):
        bench.robot.home(np.zeros(4))
    bench.boards.creep[6] = 0
    bench.boards.pins[1] = None
    bench.robot.home(np.zeros(4))
    start = bench.time
    with nullcontext() if ready else pytest.raises(RobotError, match="inclinometer is missing"):
        bench.robot.activate()
    assert bench.robot.lifecycle is (Lifecycle.ACTIVE if ready else Lifecycle.ERROR)


def test_first_commands_find_the_servo_compiled(bench):
    bench.active()
    known = set(servo._act.signatures)
    for wheels, arm in ((np.ones(4), NOTHING), (NOTHING, np.ones(4)), (np.ones(4), np.ones(4))):
        bench.cycle(Command(wheels, arm, WheelMode.SPEED, ArmMode.POSITION, np.ones(4)))
        bench.cycle(Command(wheels, arm, WheelMode.EFFORT, ArmMode.RATE))
        bench.cycle(Command(wheels, arm))
    assert known and set(servo._act.signatures) == known


@pytest.mark.parametrize("step", ["configure", "home", "activate"])
def test_step_at_rest_bears_a_few_questions_without_an_answer(bench, step):
    """As they look when the host's process was held up; driving, three stop the robot."""
    if step != "configure":
        bench.robot.configure()
    if step == "activate":
        bench.robot.home(np.zeros(4))
    bench.boards.held_up = 4
    getattr(bench.robot, step)(*([np.zeros(4)] if step == "home" else []))
    assert bench.boards.held_up == 0 and not bench.robot.fault


def test_driving_robot_is_not_homed(bench):
    bench.active()
    with pytest.raises(RobotError, match="'rover1' is active; home it when it is inactive"):
        bench.robot.home(np.zeros(4))


def test_homing_that_fails_half_way_leaves_no_angles(bench):
    bench.homed()
    bench.boards.refuses = {6}
    with pytest.raises(RobotError, match="does not take an encoder count"):
        bench.robot.home(np.full(4, 0.3))
    assert bench.cycle().arm_angles.validity is Validity.MISSING
    with pytest.raises(RobotError, match="does not know where its arm is"):
        bench.robot.activate()


@pytest.mark.parametrize(
    ("angle", "duty", "applied"),
    [
        (-1.001, -0.5, 0.0),
        (-1.001, 0.5, 0.5),
        (2.401, 0.5, 0.0),
        (2.401, -0.5, -0.5),
        (0, 0.5, 0.5),
    ],
)
def test_joint_is_not_driven_on_beyond_its_range(bench, angle, duty, applied):
    bench.homed((0.0, angle, 0.0, 0.0))
    bench.robot.activate()
    found = bench.robot.command(Command(arm=np.full(4, duty))).arm
    np.testing.assert_allclose(found[[0, 2, 3]], duty, atol=2e-5)
    # Beyond the end of its range it is pushed back a little.
    assert found[1] == pytest.approx(applied, abs=2e-5 if applied else 2e-3)
    assert applied or found[1] * duty < 0.0
    assert bench.boards.taken()[5] == round(32767 * found[1])


def asked(bench, what, cycles):
    """How often each board or pin was asked in so many cycles."""
    bench.boards.asked.clear()
    for _ in range(cycles):
        bench.cycle()
    found = [address for kind, address in bench.boards.asked if kind == what]
    return {address: found.count(address) for address in found}


def test_everything_is_sampled_once_a_tick_however_often_it_is_observed(bench):
    bench.active().cycle()
    bench.boards.asked.clear()
    first = bench.robot.observe()
    bench.time += 0.4 * PERIOD
    assert bench.robot.observe() is first and not bench.boards.asked
    bench.time += 0.6 * PERIOD
    assert bench.robot.observe() is not first
    kinds = [kind for kind, _ in bench.boards.asked]
    assert kinds.count("encoders") == 4 and kinds.count("wrench") == 1


def test_pins_and_boards_take_equal_turns(bench):
    bench.active()
    assert asked(bench, "pin", 16) == {0: 4, 1: 4, 2: 4}
    # Once a round each, by its status alone or with all else.
    assert asked(bench, "state", 16) == dict.fromkeys(bench.boards.addresses, 1)
    assert asked(bench, "status", 16) == dict.fromkeys(bench.boards.addresses, 3)


def test_wrench_without_a_network_is_a_missing_sample_not_an_exception():
    class Unplugged:
        def read(self):
            raise LinkError("no socket")

    boards = WiredBoards(None, CALIBRATION, None, Unplugged())
    assert boards.wrench() is None


def test_stereo_pair_is_kept_with_its_stamp_until_it_is_too_old(bench):
    images = np.zeros((2, 4, 6), np.uint8)
    bench.homed()
    assert bench.cycle().stereo.validity is Validity.MISSING
    bench.boards.pair = Channel(images, bench.time, Validity.MEASURED)
    stamp = bench.time
    seen = bench.cycle().stereo
    assert seen.value is images and seen.stamp == stamp and seen.usable
    bench.boards.pair = None
    seen = [bench.cycle().stereo for _ in range(105)]
    assert all(pair.stamp == stamp for pair in seen)
    assert seen[90].usable and seen[-1].validity is Validity.STALE


def test_cameras_that_fail_are_missing_pairs_not_an_exception():
    class Unplugged:
        def read(self, now):
            raise LinkError("camera 0: no more images")

    boards = WiredBoards(None, CALIBRATION, camera=Unplugged())
    assert boards.stereo(1.0) is None


@pytest.mark.parametrize(
    ("joint", "sign"), [(0, 1), (0, -1), (1, 1), (2, 1), (3, 1), (3, -1)]
)  # The others end at the deck.
@pytest.mark.parametrize("mode", [ArmMode.DUTY, ArmMode.RATE, ArmMode.POSITION])
def test_joint_driven_at_full_speed_stops_at_the_end_of_its_range(joint, sign, mode):
    with connect("quantised") as connection:
        robot = connection.robots["rover1"]
        robot.activate()
        asked = np.array(
            robot.observe().arm_angles.value if mode is ArmMode.POSITION else [0.0] * 4
        )
        asked[joint] = 9.0 * sign
        beyond, fastest = -np.inf, 0.0
        for _ in range(150):
            seen = robot.observe()
            end = CALIBRATION.drive.ranges[joint][(sign + 1) // 2]
            beyond = max(beyond, sign * (seen.arm_angles.value[joint] - end))
            fastest = max(fastest, sign * seen.arm_rates.value[joint])
            robot.command(Command(arm=asked, arm_mode=mode))
            connection.clock.tick()
        assert -0.02 < beyond < 0.01 and fastest > 3.0
