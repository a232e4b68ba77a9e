"""What stops the robot over boards: their errors, their silence, and no commands."""

import math
import threading
import time

import numpy as np
import pytest

from tests.twin.hardware.board_tables import (
    ARM_COUNT,
    CALIBRATION,
    PERIOD,
    WHEEL_COUNT,
    Bench,
    Boards,
)
from twin.describe import describe_rover
from twin.hardware.board_robot import BoardRobot, BoardRobotConfig
from twin.hardware.board_set import WiredBoards
from twin.hardware.connect_boards import watched
from twin.hardware.roboclaw.codec import Status
from twin.hardware.serial_link import LinkError
from twin.robot import ArmMode, Command, Lifecycle, RobotError, Validity

pytestmark = pytest.mark.virtual_time


@pytest.fixture
def bench():
    return Bench()


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


def test_error_persists_with_its_reason_until_reactivation(bench):
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
    with pytest.raises(RobotError, match="0x83 reports current_error_2; boards 0x80.*: zero conf"):
        bench.robot.activate()
    assert bench.robot.lifecycle is Lifecycle.ERROR


def test_board_that_was_reset_is_seen_by_its_timeout_and_wants_to_be_homed(bench):
    bench.active()
    bench.boards.timeouts[0x82] = 0.0
    assert bench.cycles_until_error() <= 16
    assert "motor board 0x82 was reset; configure and home the robot; b" in bench.robot.fault
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


@pytest.mark.parametrize("lifecycle", [Lifecycle.ACTIVE, Lifecycle.INACTIVE])
@pytest.mark.parametrize(("address", "name"), [(0x80, "front_left"), (0x82, "base_yaw")])
def test_board_that_is_reset_before_its_shafts_turned_far_gives_no_wrong_value(
    bench, lifecycle, address, name
):
    bench.homed()
    if lifecycle is Lifecycle.ACTIVE:
        bench.robot.activate()
    before = bench.cycle(moved=2)
    bench.boards.reset(address)
    for _ in range(3):
        seen = bench.cycle(moved=2)
        np.testing.assert_allclose(seen.wheel_speeds.value, before.wheel_speeds.value, rtol=1e-9)
        np.testing.assert_allclose(seen.arm_rates.value, before.arm_rates.value, rtol=1e-9)
        if seen.arm_angles.usable:
            # A sample may be three cycles old.
            known = before.arm_angles.value
            np.testing.assert_allclose(seen.arm_angles.value, known, atol=6.1 * ARM_COUNT)
        if lifecycle is Lifecycle.ACTIVE:
            assert f"the counter of {name} jumped" in bench.robot.fault
    with pytest.raises(RobotError, match="home"):
        bench.robot.activate()


def test_counter_that_jumps_while_the_robot_rests_wants_to_be_homed(bench):
    bench.homed().boards.counters[5] += 10**6
    assert bench.cycle().arm_angles.value[1] == pytest.approx(0.0, abs=ARM_COUNT)
    with pytest.raises(RobotError, match="does not know where its arm is"):
        bench.robot.activate()
    bench.robot.home(np.zeros(4))
    bench.robot.activate()


def test_board_that_is_reset_amid_activation_is_noticed(bench, monkeypatch):
    bench.homed()
    analogue = bench.boards.analogue

    def reset(pins):
        bench.boards.reset(0x82)
        return analogue(pins)

    monkeypatch.setattr(bench.boards, "analogue", reset)
    with pytest.raises(RobotError, match="0x82 was reset; configure and home the robot"):
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
    bench.robot = BoardRobot(
        describe_rover("rover1"), bench.boards, CALIBRATION, lambda: bench.time
    )
    bench.active().cycle()
    bench.boards.silent, start = {0x83}, bench.time
    bench.cycles_until_error()
    # Its own zeros are the last of all, so theirs were sent 45 ms before.
    assert bench.time - start - 0.045 <= 0.2 + PERIOD
    assert "0x83" in bench.robot.fault or "no valid answer" in bench.robot.fault


def test_board_that_was_silent_is_driven_last():
    stopped = []

    class Bus:
        def write(self, address, command, *values):
            stopped.append(address)
            if address == 0x80:
                raise LinkError("silent")

        def send(self, address, command, *values):
            stopped.append(address)

    boards = WiredBoards(Bus(), CALIBRATION)
    for order in ([0x80, 0x81, 0x82, 0x83], [0x81, 0x82, 0x83, 0x80]):
        stopped.clear()
        with pytest.raises(LinkError):
            boards.drive(np.zeros(8, dtype=np.int64))
        assert stopped == order


def test_after_a_stop_that_a_board_does_not_confirm_no_board_is_asked_before_activation(bench):
    """Questions would feed the board's own timeout: it would drive on with its last duty."""
    bench.active().cycle()
    bench.boards.silent = {0x81}
    bench.cycles_until_error()
    said = "boards 0x80, 0x82, 0x83: zero confirmed; 0x81: sent, not answered; stops by its own"
    assert f"{said} timeout of 200 ms" in bench.robot.fault
    asked, sent = len(bench.boards.asked), len(bench.boards.driven)
    for _ in range(15):
        seen = bench.cycle()
    assert [kind for kind, _ in bench.boards.asked[asked:] if kind not in ("pin", "wrench")] == []
    assert seen.wheel_speeds.validity is Validity.STALE
    assert seen.inclinometer.validity is Validity.MEASURED
    bench.robot.deactivate()
    assert len(bench.boards.driven) == sent and bench.robot.lifecycle is Lifecycle.ERROR
    bench.boards.silent = set()
    bench.robot.activate()
    assert bench.cycles_until_error(16) is None


def test_nothing_drives_between_a_stop_and_the_next_activation(bench):
    bench.active().cycle()
    bench.robot.deactivate()
    with pytest.raises(LinkError, match="halted"):
        bench.boards.drive(np.ones(8, dtype=np.int64))  # As a second thread would.
    bench.robot.activate()
    bench.robot.command(Command(np.ones(4)))
    assert np.any(bench.boards.taken())


@pytest.mark.parametrize("end", ["deactivate", "close"])
def test_end_that_a_board_does_not_confirm_is_told(bench, end, caplog):
    bench.active().cycle()
    bench.boards.silent = {0x80, 0x83}
    said = "0x81, 0x82: zero confirmed; 0x80, 0x83: sent, not answered; stop by their own timeout"
    if end == "close":
        bench.robot.close()
        assert said in caplog.text and bench.boards.closed
    else:
        with pytest.raises(RobotError, match=said):
            bench.robot.deactivate()
        assert bench.robot.lifecycle is Lifecycle.ERROR
        bench.robot.close()
        assert not caplog.text  # Not twice.


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
    assert bench.robot.fault.startswith(f"{channel} is stale; boards")
    last = age / PERIOD
    assert last + 1 - period < cycles <= last + 1
    with pytest.raises(RobotError, match=f"{channel} is"):
        bench.robot.activate()


def test_robot_does_not_start_without_a_sensor_that_it_should_have(bench):
    bench.boards.pins[1] = None
    bench.homed()
    with pytest.raises(RobotError, match="inclinometer is missing; boards 0x80.*: zero confirmed"):
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
    assert bench.robot.fault.startswith("no command for 0.15 s; boards")


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
    robot = BoardRobot(describe_rover("rover1"), boards, CALIBRATION, time.monotonic, config)
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
