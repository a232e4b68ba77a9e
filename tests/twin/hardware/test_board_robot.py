"""The logic of the robot over boards, on boards that are only tables."""

import dataclasses
import math
import threading
import time

import numpy as np
import pytest

from twin import servo
from twin.hardware.board_robot import BoardRobot, BoardRobotConfig
from twin.hardware.board_set import BoardState, WiredBoards
from twin.hardware.calibration import calibration_path, read_calibration
from twin.hardware.camera import StereoFrame
from twin.hardware.connect_boards import watched
from twin.hardware.link import LinkError
from twin.hardware.roboclaw_codec import Status
from twin.robot import NOTHING, ArmMode, Command, Lifecycle, RobotError, Validity, WheelMode

pytestmark = pytest.mark.virtual_time

CALIBRATION = read_calibration(calibration_path("rover1"))
PERIOD = 0.01
PINS = {0: 512, 1: 493, 2: 488}  # Centre, roll and pitch, level.
# By hand from calibration/rover1.toml.
PLACES = [(0x80, 1), (0x80, 2), (0x81, 1), (0x81, 2), (0x82, 1), (0x82, 2), (0x83, 1), (0x83, 2)]
FORWARD = np.array([1, -1, 1, -1, 1, 1, 1, 1])
WHEEL_COUNT = 2.0 * math.pi / 200_000  # [rad]
ARM_COUNT = 2.0 * math.pi / 16_384  # [rad]


class Boards:
    """Counters, statuses and sensors that a test sets; notes all that it is asked and sent."""

    addresses = (0x80, 0x81, 0x82, 0x83)
    has_analogue = has_wrench = True
    has_stereo, stereo_fault = False, ""

    def __init__(self):
        self.counters = np.zeros(8, dtype=np.int64)
        self.creep = np.zeros(8, dtype=np.int64)  # Counts from one reading to the next.
        self.statuses = dict.fromkeys(self.addresses, Status.NORMAL)
        self.timeouts = dict.fromkeys(self.addresses, 0.0)
        self.battery = 12.0
        self.pins = dict(PINS)
        self.counts = np.zeros(6, dtype=np.int64)
        self.silent, self.deaf, self.refuses = set(), set(), set()
        self.asked, self.driven = [], []
        self.pair = None
        self.closed = False
        self.held_up = 0  # Questions that come to nothing from now on.

    def _hear(self, what, address):
        self.asked.append((what, address))
        late = self.held_up > 0
        self.held_up -= late
        if late or address in self.silent:
            raise LinkError(f"{what} of board {address:#x}: no valid answer")

    def configure(self):
        for address in self.addresses:
            self._hear("configure", address)
            self.timeouts[address] = 0.2

    def encoders(self, address):
        self._hear("encoders", address)
        self.counters += self.creep
        axes = [axis for axis, (place, _) in enumerate(PLACES) if place == address]
        one, two = ((int(self.counters[axis]) + 2**31) % 2**32 - 2**31 for axis in axes)
        return one, two

    def set_encoder(self, axis, count):
        if axis in self.refuses:
            raise LinkError("does not take an encoder count")
        assert -(2**31) <= count < 2**31
        self.counters[axis] = count

    def drive(self, codes):
        self.driven.append(codes.copy())
        if self.silent | self.deaf:
            raise LinkError("DUTY_BOTH: no valid answer")

    def analogue(self, pins):
        self.asked += [("pin", pin) for pin in pins]
        return {pin: self.pins.get(pin) for pin in pins}

    def wrench(self):
        self.asked.append(("wrench", 0))
        return self.counts

    def stereo(self, now):
        return self.pair

    def status(self, address):
        self._hear("status", address)
        return self.statuses[address]

    def state(self, address):
        self._hear("state", address)
        timeout = self.timeouts[address]
        return BoardState(address, self.statuses[address], self.battery, (0.0, 0.0), timeout)

    def reset_e_stop(self):
        for address in self.addresses:
            self.statuses[address] &= ~Status.E_STOP

    def close(self):
        self.closed = True

    def taken(self):
        """The codes of the last drive."""
        return self.driven[-1]


class Bench:
    """A robot with its boards, and the clock."""

    def __init__(self, calibration=CALIBRATION, **changes):
        self.time = 0.0
        self.boards = Boards()
        self.config = BoardRobotConfig(**changes)
        self.robot = BoardRobot("rover1", self.boards, calibration, lambda: self.time, self.config)

    def homed(self, angles=(0.0, 0.0, 0.0, 0.0)):
        self.robot.configure()
        self.robot.home(np.array(angles))
        return self

    def active(self):
        self.homed().robot.activate()
        return self

    def cycle(self, command=None, moved=0):
        """One tick after which the axes have moved by some counts; returns what is seen."""
        self.time += PERIOD
        self.boards.counters += moved
        seen = self.robot.observe()
        if self.robot.lifecycle is Lifecycle.ACTIVE:
            self.robot.command(command or Command(np.full(4, 0.5), np.full(4, 0.25)))
        return seen

    def cycles_until_error(self, most=100):
        for number in range(1, most + 1):
            try:
                self.cycle()
            except RobotError:
                pass
            if self.robot.lifecycle is Lifecycle.ERROR:
                assert not np.any(self.boards.taken())
                return number
        return None


@pytest.fixture
def bench():
    return Bench()


def test_unconfigured_robot_says_so_and_sends_nothing(bench):
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
    with pytest.raises(RobotError, match="robot 'rover1': configure of board 0x82"):
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
def test_nan_never_comes_to_the_wire_even_where_it_is_written_after_the_check(bench, mode, wrong):
    bench.active().cycle()
    sent = len(bench.boards.driven)
    with pytest.raises(ValueError, match="nothing was sent"):
        Command(np.array([0.0, wrong, 0.0, 0.0]), wheel_mode=mode)
    command = Command(np.zeros(4), wheel_mode=mode)
    command.wheels[1] = math.nan
    with pytest.raises(ValueError, match="nan"):
        bench.robot.command(command)
    assert len(bench.boards.driven) == sent + 1 and not np.any(bench.boards.taken())


@pytest.mark.parametrize("step", [30, -30])
@pytest.mark.parametrize("start", [2**31 - 100, -(2**31) + 100])
def test_wheels_turn_on_evenly_while_their_counters_wrap(bench, start, step):
    bench.boards.counters[:4] = start
    bench.active()
    expected = FORWARD[:4] * step * WHEEL_COUNT / PERIOD
    moved = np.array([step] * 4 + [0] * 4)
    for _ in range(12):
        speeds = bench.cycle(moved=moved).wheel_speeds
        assert speeds.validity is Validity.MEASURED
        np.testing.assert_allclose(speeds.value, expected, rtol=1e-9)
    assert bench.robot.lifecycle is Lifecycle.ACTIVE


def test_arm_angle_goes_on_through_a_wrap_at_homing_and_at_activation():
    shoulder = dataclasses.replace(CALIBRATION.drive.shoulder, zero_counts=2**31 - 10)
    drive = dataclasses.replace(CALIBRATION.drive, shoulder=shoulder)
    bench = Bench(dataclasses.replace(CALIBRATION, drive=drive)).homed((0.0, 0.5, 0.0, 0.0))
    assert bench.boards.counters[5] < 0  # It has wrapped.
    for _ in range(2):
        bench.robot.activate()
        angle = bench.robot.observe().arm_angles.value[1]
        assert angle == pytest.approx(0.5, abs=0.51 * ARM_COUNT)
        bench.robot.deactivate()


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
    assert found[1] == pytest.approx(applied, abs=2e-5)
    assert bench.boards.taken()[5] == round(32767 * applied)


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


STOPPING = [
    Status.E_STOP,
    Status.TEMPERATURE,
    Status.MAIN_VOLTAGE_HIGH,
    Status.DRIVER_FAULT_1,
    Status.DRIVER_FAULT_2,
    Status.CURRENT_ERROR_1,
    Status.CURRENT_ERROR_2,
    Status.MAIN_VOLTAGE_LOW_WARNING,
]


@pytest.mark.parametrize("address", Boards.addresses)
@pytest.mark.parametrize("bit", STOPPING)
def test_board_that_reports_an_error_stops_the_robot_within_a_round(bench, address, bit):
    bench.active()
    bench.boards.statuses[address] |= bit
    assert bench.cycles_until_error() <= 4
    assert f"board {address:#x} reports {bit.name.lower()}" in bench.robot.fault


def test_warnings_that_need_no_stop_do_not_stop(bench):
    bench.active()
    for address in bench.boards.addresses:
        bench.boards.statuses[address] = Status.TEMPERATURE_WARNING | Status.OVER_CURRENT_WARNING_1
    assert bench.cycles_until_error(32) is None


@pytest.mark.parametrize("volts", [10.4, 15.1])
def test_battery_out_of_range_stops_the_robot_within_a_round_of_all_boards(bench, volts):
    bench.active()
    bench.boards.battery = volts
    assert bench.cycles_until_error() <= 16
    assert f"has a battery of {volts} V" in bench.robot.fault


def test_error_lasts_until_it_is_activated_again_and_says_why(bench):
    bench.active()
    bench.boards.statuses[0x81] = Status.E_STOP
    bench.cycles_until_error()
    bench.robot.deactivate()
    assert bench.robot.lifecycle is Lifecycle.ERROR
    sent = len(bench.boards.driven)
    for _ in range(3):
        with pytest.raises(RobotError, match="is error, not active: motor board 0x81 reports e_st"):
            bench.robot.command(Command(np.ones(4)))
    assert len(bench.boards.driven) == sent
    bench.robot.activate()  # Lets go of the e-stop.
    assert bench.robot.lifecycle is Lifecycle.ACTIVE and not bench.robot.fault
    assert bench.cycles_until_error(32) is None


def test_activation_is_refused_while_the_fault_lasts(bench):
    bench.active()
    bench.boards.statuses[0x83] = Status.CURRENT_ERROR_2
    bench.cycles_until_error()
    with pytest.raises(RobotError, match="0x83 reports current_error_2; all axes are zeroed"):
        bench.robot.activate()
    assert bench.robot.lifecycle is Lifecycle.ERROR


def test_board_that_was_reset_is_seen_by_its_timeout_and_wants_to_be_homed(bench):
    bench.active()
    bench.boards.timeouts[0x82] = 0.0
    assert bench.cycles_until_error() <= 16
    assert bench.robot.fault == "motor board 0x82 was reset; configure and home the robot"
    with pytest.raises(RobotError, match="does not know where its arm is"):
        bench.robot.activate()
    bench.homed().robot.activate()
    assert bench.cycles_until_error(32) is None


@pytest.mark.parametrize(
    ("axis", "count", "name"), [(1, WHEEL_COUNT, "front_right"), (6, ARM_COUNT, "elbow")]
)
def test_counter_that_jumps_further_than_a_motor_turns_stops_the_robot(bench, axis, count, name):
    bench.active().cycle()
    moved = np.zeros(8, dtype=np.int64)
    moved[axis] = int(0.99 * 30.0 * PERIOD / count)
    bench.cycle(moved=moved)
    assert bench.robot.lifecycle is Lifecycle.ACTIVE
    moved[axis] = -math.ceil(1.01 * 30.0 * PERIOD / count)
    bench.cycle(moved=moved)
    assert bench.robot.lifecycle is Lifecycle.ERROR and not np.any(bench.boards.taken())
    assert f"the counter of {name} jumped" in bench.robot.fault
    with pytest.raises(RobotError, match="does not know where its arm is"):
        bench.robot.activate()


def test_board_that_is_silent_for_two_cycles_is_borne_with_its_samples_marked(bench):
    bench.active().cycle()
    bench.boards.silent = {0x82}
    bench.cycle()
    assert bench.robot.lifecycle is Lifecycle.ACTIVE
    bench.boards.silent = set()
    bench.cycle()
    assert bench.robot.lifecycle is Lifecycle.ACTIVE and bench.robot.statistics.lost_boards > 0


def test_samples_of_a_silent_board_keep_their_stamp_and_turn_stale(bench):
    bench.homed().cycle()
    bench.boards.silent = {0x82}
    stamp = bench.time
    ages = [bench.cycle().arm_angles for _ in range(12)]
    assert all(seen.stamp == stamp for seen in ages)
    # Stale when older than 0.1 s.
    assert [seen.validity is Validity.STALE for seen in ages] == [False] * 10 + [True] * 2
    assert bench.cycle().wheel_speeds.stamp == bench.time


def test_silent_board_stops_the_robot_after_three_cycles(bench):
    bench.active().cycle()
    bench.boards.silent = {0x81}
    assert bench.cycles_until_error() <= 3


def test_silent_board_that_holds_the_others_up_stops_the_robot_within_its_time(bench):
    """On the wall clock each call to it takes 45 ms, so three cycles would take 0.3 s."""

    class Bus(Boards):
        def _hear(self, what, address):
            bench.time += 0.045 * (address in self.silent)
            super()._hear(what, address)

        def drive(self, codes):
            bench.time += 0.045 * len(self.silent)
            super().drive(codes)

    bench.boards = Bus()
    bench.robot = BoardRobot("rover1", bench.boards, CALIBRATION, lambda: bench.time)
    bench.active().cycle()
    bench.boards.silent, start = {0x83}, bench.time
    bench.cycles_until_error()
    # Its own zeros are the last of all, so theirs were sent 45 ms before.
    assert bench.time - start - 0.045 <= 0.2 + PERIOD
    assert "0x83" in bench.robot.fault or "no valid answer" in bench.robot.fault


def test_board_that_was_silent_is_driven_last():
    told = []

    class Bus:
        def write(self, address, command, *values):
            told.append(address)
            if address == 0x80:
                raise LinkError("silent")

    boards = WiredBoards(Bus(), CALIBRATION)
    for order in ([0x80, 0x81, 0x82, 0x83], [0x81, 0x82, 0x83, 0x80]):
        told.clear()
        with pytest.raises(LinkError):
            boards.drive(np.zeros(8, dtype=np.int64))
        assert told == order


def test_zeros_that_no_board_heard_are_sent_until_it_does(bench):
    """Questions keep a board's own watchdog quiet: it would drive on with its last duty."""
    bench.active().cycle()
    bench.boards.silent = {0x81}
    bench.cycles_until_error()
    sent = len(bench.boards.driven)
    bench.cycle()
    assert len(bench.boards.driven) == sent + 1
    bench.boards.silent = set()
    bench.cycle()
    assert len(bench.boards.driven) == sent + 2 and not np.any(bench.boards.taken())
    bench.cycle()
    assert len(bench.boards.driven) == sent + 2


def test_board_that_answers_and_takes_no_command_stops_the_robot(bench):
    bench.active().cycle()
    bench.boards.deaf = {0x80}
    assert bench.cycles_until_error() == 3


@pytest.mark.parametrize(
    ("channel", "age", "period"), [("arm_base_wrench", 0.1, 1), ("inclinometer", 0.2, 4)]
)
def test_sensor_that_falls_silent_stops_the_robot_when_its_sample_is_stale(
    bench, channel, age, period
):
    bench.active()
    for _ in range(8):
        bench.cycle()
    if channel == "inclinometer":
        bench.boards.pins[2] = None
    else:
        bench.boards.counts = None
    cycles = bench.cycles_until_error()
    assert bench.robot.fault == f"{channel} is stale"
    last = age / PERIOD
    assert last + 1 - period < cycles <= last + 1
    with pytest.raises(RobotError, match=f"{channel} is"):
        bench.robot.activate()


def test_robot_does_not_start_without_a_sensor_that_it_should_have(bench):
    bench.boards.pins[1] = None
    bench.homed()
    with pytest.raises(RobotError, match="inclinometer is missing; all axes are zeroed"):
        bench.robot.activate()
    assert bench.robot.lifecycle is Lifecycle.ERROR


def test_robot_drives_without_sensors_that_it_was_never_given(bench):
    bench.boards.has_analogue = bench.boards.has_wrench = False
    bench.active()
    seen = bench.cycle()
    assert seen.inclinometer.validity is seen.arm_base_wrench.validity is Validity.MISSING
    assert bench.cycles_until_error(32) is None
    assert not [kind for kind, _ in bench.boards.asked if kind in ("pin", "wrench")]


def test_mode_that_needs_a_stale_channel_stops_the_robot():
    bench = Bench(lost_cycles=99, lost_time=9.0)
    bench.active().cycle()
    bench.boards.silent = {0x83}
    hold = Command(arm=np.zeros(4), arm_mode=ArmMode.POSITION)
    bench.cycle(hold)
    bench.time += 10 * PERIOD
    with pytest.raises(RobotError, match="position mode needs arm_rates, which is stale"):
        bench.cycle(hold)
    assert bench.robot.lifecycle is Lifecycle.ERROR and not np.any(bench.boards.taken())


def test_watchdog_stops_a_robot_that_is_not_commanded(bench):
    bench.active().cycle()
    bench.time += 0.149
    bench.robot.guard()
    assert bench.robot.lifecycle is Lifecycle.ACTIVE
    bench.time += 0.002
    bench.robot.guard()
    assert bench.robot.lifecycle is Lifecycle.ERROR and not np.any(bench.boards.taken())
    assert bench.robot.fault == "no command for 0.15 s"


def test_controller_that_observes_and_never_commands_is_stopped_too(bench):
    bench.active()
    for _ in range(15):
        bench.time += PERIOD
        bench.robot.observe()
    assert bench.robot.lifecycle is Lifecycle.ACTIVE
    bench.time += PERIOD
    bench.robot.observe()
    assert bench.robot.lifecycle is Lifecycle.ERROR


def test_watchdog_leaves_an_inactive_robot_alone(bench):
    bench.homed()
    sent = len(bench.boards.driven)
    bench.time += 10.0
    bench.robot.guard()
    assert bench.robot.lifecycle is Lifecycle.INACTIVE and len(bench.boards.driven) == sent


@pytest.mark.real_time
def test_watched_robot_stops_while_its_controller_hangs():
    boards = Boards()
    config = BoardRobotConfig(watchdog=0.05)
    robot = BoardRobot("rover1", boards, CALIBRATION, time.monotonic, config)
    robot.configure()
    robot.home(np.zeros(4))
    with watched(robot, period=0.01):
        assert "watchdog of rover1" in {thread.name for thread in threading.enumerate()}
        robot.activate()
        robot.command(Command(np.ones(4)))
        end = time.monotonic() + 20.0
        while robot.lifecycle is Lifecycle.ACTIVE and time.monotonic() < end:
            time.sleep(0.01)
    assert "no command for" in robot.fault and not np.any(boards.taken())
    assert "watchdog of rover1" not in {thread.name for thread in threading.enumerate()}


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
    bench.boards.pair = StereoFrame(images, bench.time)
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
