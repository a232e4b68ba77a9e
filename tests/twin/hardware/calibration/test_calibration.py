"""Board numbers into SI units and back, and calibration files."""

import dataclasses
import datetime
import math
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from models.datasheets import ARM, ARM_MOTOR, INCLINOMETER_CALIBRATION, WHEEL_MOTOR
from twin.hardware.calibration.calibration import (
    CalibrationError,
    calibration_path,
    calibration_text,
    check_age,
    load_calibration,
    read_calibration,
    write_calibration,
)
from twin.hardware.calibration.motors import START
from twin.robot import AXES
from twin.sensors import DATASHEET

pytestmark = pytest.mark.virtual_time

ROVER1 = read_calibration(calibration_path("rover1"))
ROVER2 = read_calibration(calibration_path("rover2"))
TODAY = datetime.date(2026, 12, 1)
FRESH = dataclasses.replace(
    ROVER1,
    inclinometer=dataclasses.replace(
        ROVER1.inclinometer, calibrated_on=TODAY - datetime.timedelta(days=365)
    ),
    **{
        name: dataclasses.replace(getattr(ROVER1, name), calibrated_on=TODAY)
        for name in ("drive", "analogue", "force_torque", "limits")
    },
)

finite = st.floats(-1e3, 1e3, allow_nan=False)


def moved(**changes):
    """Rover 1's motors with other numbers for one of them."""
    axis = dataclasses.replace(ROVER1.drive.shoulder, **changes)
    return dataclasses.replace(ROVER1.drive, shoulder=axis)


@settings(deadline=None)
@given(
    st.lists(finite, min_size=8, max_size=8),
    st.sampled_from([-1, 1]),
    st.floats(100.0, 1e6),
)
def test_angle_comes_back_from_counts_within_half_a_count(angles, direction, counts):
    drive = moved(direction=direction, counts_per_turn=counts)
    back = drive.angles(drive.counts(angles))
    half = 0.5 / np.abs(drive.counts_per_radian)
    assert np.all(np.abs(back - angles) <= half * (1 + 1e-6) + 1e-12)


@settings(deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8))
def test_duty_comes_back_from_its_code_within_half_a_code(duties):
    codes = ROVER1.drive.duty_codes(duties)
    assert np.all(np.abs(codes) <= 32767)
    assert np.all(np.abs(ROVER1.drive.duties(codes) - duties) <= 0.5 / 32767 * (1 + 1e-9))


@settings(deadline=None)
@given(st.floats(0.0, 1.0), st.integers(1, 16), st.floats(1.0, 10.0))
def test_voltage_comes_back_from_the_converter_within_half_a_count(share, bits, reference):
    board = dataclasses.replace(ROVER1.analogue, bits=bits, reference=reference)
    volts = share * (reference - board.step / 2)  # above, the converter is at its end
    assert abs(board.volts(board.codes(volts)) - volts) <= board.step / 2 * (1 + 1e-9)


@settings(deadline=None)
@given(st.floats(-0.35, 0.35))
def test_tilt_comes_back_from_the_converter_within_half_a_count(angle):
    board = ROVER2.analogue
    for sensor in (ROVER2.inclinometer.roll, ROVER2.inclinometer.pitch):
        back = sensor.angle(board.volts(board.codes(sensor.volts(angle))))
        assert abs(back - angle) <= 0.5 * board.step / sensor.volts_per_radian * (1 + 1e-9)


@settings(deadline=None)
@given(
    st.lists(st.floats(-200, 200), min_size=6, max_size=6),
    st.integers(0, 2**31),
    st.sampled_from([-1, 1]),
)
def test_wrench_comes_back_from_counts_within_half_a_count(wrench, seed, direction):
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    bias = tuple(np.random.default_rng(seed).normal(size=6).tolist())
    sensor = dataclasses.replace(
        ROVER1.force_torque,
        rotation=tuple(map(tuple, rotation.tolist())),
        bias=bias,
        direction=direction,
    )
    back = sensor.wrench(sensor.counts(wrench))
    # A rotated half count is at most sqrt(3) as long in one component.
    assert np.all(np.abs(back - wrench) <= 0.5e-6 * math.sqrt(3) * (1 + 1e-6) + 1e-12)


def test_conversions_take_many_samples_at_once():
    rng = np.random.default_rng(1)
    angles = rng.normal(size=(5, 3, 8))
    counts = ROVER1.drive.counts(angles)
    assert counts.shape == (5, 3, 8) and counts.dtype == np.int64
    np.testing.assert_array_equal(ROVER1.drive.counts(angles[2, 1]), counts[2, 1])
    wrenches = rng.normal(size=(5, 3, 6))
    assert ROVER1.force_torque.wrench(ROVER1.force_torque.counts(wrenches)).shape == (5, 3, 6)


def test_forward_wheel_on_the_right_counts_down_and_is_driven_with_negative_codes():
    counts = ROVER1.drive.counts(np.full(8, 2 * math.pi))
    np.testing.assert_array_equal(counts[:4] - START, [200000, -200000, 200000, -200000])
    np.testing.assert_array_equal(counts[4:] - START, 16384)
    codes = ROVER1.drive.duty_codes(np.ones(8))
    np.testing.assert_array_equal(codes[:4], [32767, -32767, 32767, -32767])
    np.testing.assert_allclose(ROVER1.drive.rates(counts - START), 2 * math.pi)


def test_duty_out_of_range_or_nan_is_refused_before_it_is_a_code():
    for bad in (1.0001, -40000 / 32767, math.nan):
        with pytest.raises(ValueError, match="duty outside"):
            ROVER1.drive.duty_codes([bad] + [0.0] * 7)
    with pytest.raises(ValueError, match="NaN"):
        ROVER1.analogue.codes(math.nan)


def test_converter_and_wrench_saturate_instead_of_wrapping():
    np.testing.assert_array_equal(ROVER1.analogue.codes([-1.0, 0.0, 5.0, 99.0]), [0, 0, 1023, 1023])
    assert ROVER1.force_torque.counts([0, 0, 1e9, 0, 0, 0])[2] == -(2**31)


def test_sensor_that_reports_the_load_gives_an_upward_force_for_a_carried_weight():
    sensor = ROVER1.force_torque
    down = np.array([0, 0, -7.4556, 0, 0, 0]) * sensor.counts_per_newton
    assert sensor.wrench(down)[2] == pytest.approx(7.4556)


@pytest.mark.parametrize("robot", ["rover1", "rover2"])
def test_inclinometer_has_table_d_1s_constants(robot):
    section = read_calibration(calibration_path(robot)).inclinometer
    table = INCLINOMETER_CALIBRATION[robot.replace("rover", "robot")]
    for name in ("roll", "pitch"):
        sensor = getattr(section, name)
        assert sensor.zero_volts == table[name].zero_voltage
        millivolts = 1000 * sensor.volts_per_radian * math.pi / 180
        assert millivolts == pytest.approx(1000 * table[name].sensitivity, rel=1e-12)
        for volts in (2.0, 2.4, 2.9):
            # Table D-1 is in mV/degree, so theta = (V - V0) / (S 180/pi).
            assert sensor.angle(volts) == pytest.approx(table[name].angle(volts), rel=1e-12)


def test_ten_bits_cost_0_145_degrees_a_count_on_robot_1s_roll_axis():
    sensor, board = ROVER1.inclinometer.roll, ROVER1.analogue
    step = np.diff(np.degrees(sensor.angle(board.volts([500, 501]))))[0]
    assert step == pytest.approx(0.1452, abs=5e-5)


def test_nominal_files_agree_with_the_sheets_and_the_simulated_sensors():
    for calibration in (ROVER1, ROVER2):
        drive = calibration.drive
        np.testing.assert_array_equal(drive.ranges, ARM.joint_limits)
        # The simulated arm encoders have 14 bits a turn, the centre potentiometer 10 in 150 deg.
        assert drive.shoulder.counts_per_turn == 2 ** DATASHEET.channels["arm_angles"].bits
        board = calibration.analogue
        assert board.bits == DATASHEET.channels["centre_angle"].bits
        low = DATASHEET.channels["centre_angle"].low
        assert board.centre.angle(board.volts(0)) == pytest.approx(low)
        # The limit is above what a stalled motor takes, so only a short circuit trips it.
        for axis, sheet in ((drive.rear_left, WHEEL_MOTOR), (drive.elbow, ARM_MOTOR)):
            stall = sheet.gross_stall_torque * sheet.gross_no_load_speed / sheet.voltage
            assert stall < axis.current_limit < 1.5 * stall


def test_every_axis_has_a_channel_of_its_own():
    places = [(axis.address, axis.channel) for axis in ROVER1.drive.axes]
    assert len(set(places)) == len(AXES) == 8


@settings(max_examples=20, deadline=None)
@given(st.text(max_size=30), st.floats(1e-6, 1e9), st.dates())
def test_written_file_reads_back_equal(source, counts, date):
    drive = moved(counts_per_turn=counts)
    drive = dataclasses.replace(drive, source=source, calibrated_on=date)
    calibration = dataclasses.replace(ROVER1, drive=drive)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        write_calibration(path, calibration)
        assert read_calibration(path) == calibration
        assert [entry.name for entry in Path(folder).iterdir()] == ["robot.toml"]


def test_files_in_the_repository_are_as_the_writer_writes_them():
    for calibration in (ROVER1, ROVER2):
        path = calibration_path(calibration.robot)
        assert path.read_text() == calibration_text(calibration)


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "rover1.toml"
    write_calibration(path, ROVER1)
    before = path.read_text()

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_calibration(path, ROVER2)
    assert path.read_text() == before


def test_calibration_of_another_robot_is_refused():
    path = calibration_path("rover2")
    with pytest.raises(CalibrationError) as caught:
        load_calibration(path, "rover1", None)
    message = str(caught.value)
    assert message.count("\n") == 0
    assert all(part in message for part in (str(path), "'rover2'", "'rover1'", "rover1.toml"))


def test_stale_section_is_refused_with_what_to_do_and_a_larger_age_allows_it(tmp_path):
    path = tmp_path / "rover1.toml"
    write_calibration(path, FRESH)
    assert load_calibration(path, "rover1", TODAY) == FRESH
    tomorrow = TODAY + datetime.timedelta(days=1)
    with pytest.raises(CalibrationError) as caught:
        load_calibration(path, "rover1", tomorrow)
    message = str(caught.value)
    for part in (str(path), "inclinometer.calibrated_on", "366 days", "365", "calibrate this"):
        assert part in message
    load_calibration(path, "rover1", tomorrow, most_days=366)
    load_calibration(path, "rover1", None)


def test_table_d_1_of_2002_is_too_old_for_a_real_robot_of_today():
    with pytest.raises(CalibrationError, match="inclinometer.calibrated_on is 2002-01-01"):
        load_calibration(calibration_path("rover1"), "rover1", TODAY)


def test_date_in_the_future_is_refused():
    with pytest.raises(CalibrationError, match="after today"):
        check_age(FRESH, TODAY - datetime.timedelta(days=1))


TEXT = calibration_text(ROVER1)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("schema = 1", "schema = 2", ["schema is 2", "reads 1"]),
        ("schema = 1\n", "", ["schema is None"]),
        ("address = 0x81", "address = 0x84", ["drive.rear_left.address is 132", "131"]),
        ("channel = 2", "channel = 3", ["drive.front_right.channel is 3", "1 or 2"]),
        ("channel = 2", "channel = 1", ["front_right and front_left", "0x80, channel 1"]),
        ("direction = 1", "direction = 0", ["drive.front_left.direction is 0", "1 or -1"]),
        ("direction = 1", "direction = true", ["drive.front_left.direction is True"]),
        ("current_limit = 5.0", "current_limit = -1.0", ["front_left.current_limit is -1.0"]),
        ("counts_per_turn = 16384.0", "counts_per_turn = nan", ["base_yaw.counts_per_turn is nan"]),
        ("address = 0x81", "address = 129.5", ["address is 129.5", "whole number"]),
        ("upper = 2.6", "upper = 2.6\nzero_counts = 0", ["base_yaw.zero_counts is unknown"]),
        ("upper = 2.6", "upper = -3.0", ["base_yaw.lower and upper is (-2.6, -3.0)"]),
        ("upper = 2.6", "uper = 2.6", ["base_yaw.uper is unknown", "valid keys are", "upper"]),
        ("wrist]", "hand]", ["drive.hand is unknown", "wrist"]),
        ("bits = 10\n", "", ["analogue.bits is missing", "reference"]),
        ("bits = 10", 'bits = "10"', ["analogue.bits is '10'", "whole number"]),
        ("reference = 5.0", "reference = 0", ["analogue.reference is 0.0"]),
        ("pin = 1", "pin = 2", ["pins of centre, roll and pitch is (0, 2, 2)"]),
        ("zero_volts = 2.406", "zero_volts = inf", ["inclinometer.roll.zero_volts is inf"]),
        ("volts_per_radian = 1.9", "volts_per_radian = 0.0 #", ["volts_per_radian is 0.0"]),
        ("[[1.0, 0.0", "[[2.0, 0.0", ["force_torque.rotation is", "rotation matrix"]),
        ("[[1.0, 0.0", "[[-1.0, 0.0", ["force_torque.rotation is", "right-handed"]),
        ("bias = [0.0, ", "bias = [", ["force_torque.bias is", "six"]),
        ("least_battery = 10.5", "least_battery = 20.0", ["limits.least_battery and", "20.0"]),
        ("serial_timeout = 0.2", "serial_timeout = 0.25", ["serial_timeout is 0.25", "0.1 s"]),
        ("2002-01-01", '"2002-01-01"', ["inclinometer.calibrated_on is '2002-01-01'", "a date"]),
        ("2002-01-01", "2002-01-01T00:00:00", ["inclinometer.calibrated_on is", "a date"]),
        ('robot = "rover1"', "robot = 1", ["robot is 1", "a text"]),
        ("schema = 1", "schema = ", ["is not TOML"]),
    ],
)
def test_wrong_file_is_one_sentence_that_names_file_key_and_value(tmp_path, old, new, parts):
    assert old in TEXT
    path = tmp_path / "rover1.toml"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(CalibrationError) as caught:
        read_calibration(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(path))
    for part in parts:
        assert part in message


def test_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(CalibrationError, match=re.escape(str(tmp_path)) + ".*cannot be read"):
        read_calibration(tmp_path / "none.toml")


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_a_calibration_error(noise):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "noise.toml"
        path.write_bytes(noise)
        with pytest.raises(CalibrationError):
            read_calibration(path)
