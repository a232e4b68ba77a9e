import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.datasheets import FORCE_TORQUE, SENSOR_ERRORS
from twin.describe import describe_rover
from twin.robot import Observation, Validity
from twin.sensor_bank import SensorBank, SensorWiring
from twin.sensors import (
    CHANNELS,
    DATASHEET,
    IDEAL,
    ChannelSpec,
    SensorSuite,
    channel_widths,
    with_errors,
)

PERIOD = 0.01
ROBOT = describe_rover()
WIDTHS = channel_widths(ROBOT)
OFFSETS = dict(zip(WIDTHS, np.cumsum([0, *WIDTHS.values()])))
GYRO = OFFSETS["gyro"]
DIRECT = SensorWiring(np.outer(np.arange(28), [1, 1, 0, 0]), (), {})
"""Every value comes from the place that it goes to."""
NO_HISTORY = np.zeros(0)


def bank(seed=0, suite=IDEAL, **gyro):
    if gyro:
        suite = suite.with_channel("gyro", **gyro)
    return SensorBank(suite, PERIOD, np.random.default_rng(seed), WIDTHS, DIRECT)


def read(sensors, time):
    return dict(zip(CHANNELS, sensors.channels(time), strict=True))


def feed(sensors, signal):
    """Sample `signal`, and return the gyro's first value and channel at each tick."""
    values, channels = [], []
    for tick, value in enumerate(signal):
        sensors.sample(tick * PERIOD, np.full(sensors.size, float(value)), NO_HISTORY)
        channel = read(sensors, tick * PERIOD)["gyro"]
        channels.append(channel)
        values.append(channel.value[0] if channel.value.size else math.nan)
    return np.array(values), channels


def test_offsets_lay_the_channels_side_by_side():
    assert WIDTHS["wheel_speeds"] == WIDTHS["arm_rates"] == 4 and sum(WIDTHS.values()) == 28
    assert bank().size == 28


def test_channels_are_those_of_an_observation_in_its_order():
    assert Observation._fields[1:-1] == CHANNELS


def test_ideal_channels_pass_values_unchanged():
    raw = np.random.default_rng(1).normal(size=bank().size)
    sensors = bank()
    sensors.sample(0.5, raw, NO_HISTORY)
    for name, channel in read(sensors, 0.5).items():
        start = OFFSETS[name]
        np.testing.assert_array_equal(channel.value, raw[start : start + WIDTHS[name]])
        assert channel.stamp == 0.5 and channel.validity is Validity.MEASURED


def test_noise_is_white_and_of_the_given_size():
    values, _ = feed(bank(noise=0.3, bias=0.1), np.zeros(20000))
    assert values.mean() == pytest.approx(0.1, abs=4 * 0.3 / math.sqrt(20000))
    assert values.std() == pytest.approx(0.3, rel=0.03)
    shifted = np.corrcoef(values[1:], values[:-1])[0, 1]
    assert abs(shifted) < 4 / math.sqrt(20000)


def test_noise_may_differ_between_components():
    sensors = bank(noise=(0.0, 0.1, 0.2))
    rows = []
    for _ in range(4000):
        sensors.sample(0.0, np.zeros(sensors.size), NO_HISTORY)
        rows.append(read(sensors, 0.0)["gyro"].value)
    np.testing.assert_allclose(np.std(rows, axis=0), [0.0, 0.1, 0.2], rtol=0.05)


def test_low_pass_follows_the_first_order_ramp_response():
    time = np.arange(60) * PERIOD
    values, _ = feed(bank(bandwidth=6.0), time)
    lag = 1.0 / (2 * np.pi * 6.0)
    expected = time - lag * (1.0 - np.exp(-time / lag))
    np.testing.assert_allclose(values, expected, atol=1e-12)


def test_low_pass_starts_settled_at_the_first_value():
    values, _ = feed(bank(bandwidth=6.0), np.full(5, 3.0))
    np.testing.assert_array_equal(values, 3.0)


@given(value=st.floats(-3, 3), bits=st.integers(1, 16))
@settings(max_examples=60, deadline=None)
def test_quantisation_is_within_half_a_step_and_on_a_code(value, bits):
    values, _ = feed(bank(low=-1.0, high=1.0, bits=bits), [value])
    step = 2.0 / 2**bits
    code = (values[0] + 1.0) / step
    assert code == pytest.approx(round(code)) and 0 <= round(code) <= 2**bits - 1
    inside = min(max(value, -1.0), 1.0 - step)
    assert abs(values[0] - inside) <= step / 2 + 1e-12


def test_quantisation_error_is_uniform():
    signal = np.random.default_rng(2).uniform(-0.9, 0.9, 20000)
    values, _ = feed(bank(low=-1.0, high=1.0, bits=6), signal)
    step = 2.0 / 64
    assert np.std(values - signal) == pytest.approx(step / math.sqrt(12), rel=0.03)


def test_saturation_clips_at_the_range():
    values, _ = feed(bank(low=-1.0, high=2.0), [-5.0, 0.5, 5.0])
    np.testing.assert_array_equal(values, [-1.0, 0.5, 2.0])


def test_delay_shifts_value_and_stamp_together():
    values, channels = feed(bank(delay=0.03), np.arange(10.0))
    assert [c.validity for c in channels[:3]] == [Validity.MISSING] * 3
    np.testing.assert_array_equal(values[3:], np.arange(7.0))
    np.testing.assert_allclose([c.stamp for c in channels[3:]], np.arange(7) * PERIOD)


def test_rate_holds_samples_between():
    values, channels = feed(bank(rate=25.0), np.arange(12.0))
    np.testing.assert_array_equal(values, np.repeat([0.0, 4.0, 8.0], 4))
    assert channels[7].stamp == pytest.approx(0.04)


def test_rate_that_does_not_divide_the_ticks_keeps_its_mean():
    values, _ = feed(bank(rate=30.0), np.arange(3000.0))
    assert len(np.unique(values)) == pytest.approx(900, abs=1)


def test_dropout_loses_the_given_fraction_and_holds_the_last():
    values, channels = feed(bank(dropout=0.3), np.arange(1.0, 5001.0))
    kept = sum(c.stamp == pytest.approx(k * PERIOD) for k, c in enumerate(channels))
    assert kept / 5000 == pytest.approx(0.7, abs=4 * math.sqrt(0.21 / 5000))
    seen = values[~np.isnan(values)]
    assert np.all(np.diff(seen) >= 0)


def test_lost_samples_make_a_channel_stale_and_never_zero():
    sensors = bank(seed=1, dropout=0.95, stale_after=0.05)
    values, channels = feed(sensors, np.full(400, 7.0))
    ages = np.array([k * PERIOD - c.stamp for k, c in enumerate(channels)])
    for age, channel in zip(ages, channels):
        if math.isnan(age):
            expected = Validity.MISSING
        else:
            expected = Validity.STALE if age > 0.05 + 1e-9 else Validity.MEASURED
        assert channel.validity is expected
    assert {Validity.STALE, Validity.MEASURED} <= {c.validity for c in channels}
    assert set(values[~np.isnan(values)]) == {7.0}


def test_disconnected_sensor_is_missing_and_empty():
    sensors = bank()
    sensors.sample(0.0, np.ones(sensors.size), NO_HISTORY)
    sensors.disconnect("gyro")
    channel = read(sensors, 0.0)["gyro"]
    assert channel.validity is Validity.MISSING
    assert channel.value.size == 0 and math.isnan(channel.stamp) and not channel.usable
    sensors.connect("gyro")
    assert read(sensors, 0.0)["gyro"].usable
    assert read(bank(connected=False), 0.0)["gyro"].validity is Validity.MISSING


def test_nothing_is_measured_before_the_first_sample():
    assert {c.validity for c in read(bank(), 0.0).values()} == {Validity.MISSING}


def test_values_are_read_only_and_outlive_later_samples():
    sensors = bank()
    sensors.sample(0.0, np.ones(sensors.size), NO_HISTORY)
    value = read(sensors, 0.0)["gyro"].value
    with pytest.raises(ValueError):
        value[0] = 5.0
    sensors.sample(PERIOD, np.zeros(sensors.size), NO_HISTORY)
    np.testing.assert_array_equal(value, np.ones(3))


def test_readings_of_many_ticks_keep_their_own_values():
    _, channels = feed(bank(delay=PERIOD), np.arange(200.0))
    np.testing.assert_array_equal(
        [c.value for c in channels[1:]], np.tile(np.arange(199.0), (3, 1)).T
    )
    np.testing.assert_allclose([c.stamp for c in channels[1:]], PERIOD * np.arange(199.0))


def test_restored_bank_continues_bit_for_bit():
    suite = DATASHEET.with_channel("gyro", delay=0.02, dropout=0.3, rate=30.0, bandwidth=10.0)
    sensors = bank(5, suite)
    feed(sensors, np.sin(np.arange(50.0)))
    saved = sensors.save()
    first, _ = feed(sensors, np.cos(np.arange(50.0)))
    other = bank(77, suite)
    other.restore(saved)
    again, _ = feed(other, np.cos(np.arange(50.0)))
    assert first.tobytes() == again.tobytes()


@pytest.mark.parametrize("ticks", [10, 64, 100])
def test_bank_restored_within_a_block_of_noise_continues_bit_for_bit(ticks):
    sensors, other = bank(5, noise=0.1), bank(77, noise=0.1)
    feed(sensors, np.zeros(ticks))
    other.restore(sensors.save())
    for anew in (sensors, other):
        first, _ = feed(anew, np.zeros(80))
        again = bank(5, noise=0.1)
        whole, _ = feed(again, np.zeros(ticks + 80))
        np.testing.assert_array_equal(first, whole[ticks:])


def test_noise_is_the_generators_own_row_after_row():
    values, _ = feed(bank(9, noise=0.1), np.zeros(70))
    rows = np.random.default_rng(9).standard_normal((70, bank().size))
    np.testing.assert_allclose(values, 0.1 * rows[:, GYRO], rtol=1e-12)


def test_one_missing_channel_leaves_the_others_measured():
    sensors = bank(dropout=1.0)
    for tick in range(20):
        sensors.sample(tick * PERIOD, np.ones(sensors.size), NO_HISTORY)
    worth = {name: channel.validity for name, channel in read(sensors, 0.19).items()}
    assert worth.pop("gyro") is Validity.MISSING
    assert set(worth.values()) == {Validity.MEASURED}


@pytest.mark.parametrize(
    "make", [lambda n: SensorSuite("x", {n: ChannelSpec()}), bank().disconnect]
)
def test_unknown_sensor_is_named_with_the_valid_ones(make):
    with pytest.raises(ValueError, match=r"'sonar'.*wheel_speeds.*heading"):
        make("sonar")


@pytest.mark.parametrize(
    "bad",
    [
        {"noise": -0.1},
        {"noise": math.nan},
        {"bias": math.inf},
        {"bits": 0, "low": 0.0, "high": 1.0},
        {"bits": 8},
        {"low": 1.0, "high": 1.0},
        {"rate": 0.0},
        {"bandwidth": -1.0},
        {"delay": -0.1},
        {"delay": math.nan},
        {"dropout": 1.5},
        {"stale_after": 0.0},
    ],
)
def test_impossible_sensor_is_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad)).split("_")[0].replace("low", "range")):
        ChannelSpec(**bad)


def test_datasheet_tilt_sensor_has_its_bandwidth_range_and_noise():
    tilt = DATASHEET.channels["inclinometer"]
    assert tilt.bandwidth == 6.0 and tilt.rate == 25.0
    assert tilt.noise == pytest.approx(math.radians(0.05))
    assert tilt.high == pytest.approx(math.radians(20))
    centre = DATASHEET.channels["centre_angle"]
    assert math.degrees(centre.high - centre.low) / 2**centre.bits == pytest.approx(
        0.145, abs=0.003
    )
    assert dataclasses.replace(tilt, rate=None).age_limit == 0.1


WRENCH = CHANNELS.index("arm_base_wrench")
LOAD = np.array([3.0, -20.0, 7.5, 0.4, -0.2, 1.1])


def wrench_at(time, **fields):
    """Read the wrench under `LOAD` at a time."""
    sensors = bank(suite=IDEAL.with_channel("arm_base_wrench", **fields))
    true = np.zeros(sensors.size)
    first = sum(list(WIDTHS.values())[:WRENCH])
    true[first : first + 6] = LOAD
    sensors.sample(time, true, NO_HISTORY)
    return read(sensors, time)["arm_base_wrench"].value


def test_wrench_has_cross_talk_scale_and_zero():
    rng = np.random.default_rng(0)
    cross = rng.normal(0.0, 0.05, (6, 6))
    scale, zero = rng.uniform(0.9, 1.1, 6), rng.normal(size=6)
    rows = tuple(tuple(row) for row in cross.tolist())
    seen = wrench_at(0.0, cross=rows, scale=tuple(scale), bias=tuple(zero))
    np.testing.assert_allclose(seen, scale * LOAD + cross @ LOAD + zero, rtol=1e-12)


def test_zero_of_the_wrench_drifts_until_the_sensor_is_warm():
    drift = (0.5, -0.5, 1.0, 0.02, 0.0, -0.02)
    for time in (0.0, 60.0, 600.0, 6000.0):
        wanted = LOAD + np.array(drift) * (1.0 - np.exp(-time / 600.0))
        np.testing.assert_allclose(wrench_at(time, drift=drift), wanted, rtol=1e-12)
    wanted = LOAD + 1.0 - np.exp(-0.5)
    np.testing.assert_allclose(wrench_at(30.0, drift=1.0, warm_up=60.0), wanted, rtol=1e-12)


def test_tachometer_scale_comes_before_range_and_converter():
    seen, _ = feed(bank(scale=1.25, low=-1.0, high=1.0, bits=2), [0.1, 0.7, 2.0, -2.0])
    np.testing.assert_allclose(seen, [0.0, 0.5, 0.5, -1.0])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"cross": ((0.0, 1.0),)}, "cross must be a square"),
        ({"cross": ((math.nan,),)}, "cross must be a square of finite numbers"),
        ({"cross": tuple((0.0,) * 7 for _ in range(7))}, "cross must be a square"),
        ({"scale": math.inf}, "scale must be finite"),
        ({"drift": math.nan}, "drift must be finite"),
        ({"warm_up": 0.0}, "warm_up must be positive"),
    ],
)
def test_impossible_errors_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        ChannelSpec(**fields)


def test_cross_talk_of_another_width_is_refused_by_the_channels_name():
    with pytest.raises(ValueError, match="sensor gyro: cross has 2 rows, needs 3"):
        bank(cross=((0.0, 0.1), (0.1, 0.0)))


def errors_of(suite, seed):
    return with_errors(suite, SENSOR_ERRORS, ROBOT, np.random.default_rng(seed))


def test_drawn_errors_are_within_the_sheet_and_differ_between_robots():
    suites = [errors_of(DATASHEET, seed) for seed in range(40)]
    for channel, field, most in (
        ("wheel_speeds", "scale", SENSOR_ERRORS.tachometer_scale),
        ("centre_angle", "scale", SENSOR_ERRORS.potentiometer_scale),
        ("centre_angle", "bias", SENSOR_ERRORS.potentiometer_zero),
        ("arm_angles", "bias", SENSOR_ERRORS.encoder_zero),
        ("inclinometer", "scale", SENSOR_ERRORS.inclinometer_scale),
        ("inclinometer", "bias", SENSOR_ERRORS.inclinometer_zero),
        ("inclinometer", "cross", SENSOR_ERRORS.inclinometer_cross),
        ("arm_base_wrench", "scale", SENSOR_ERRORS.wrench_scale),
        ("arm_base_wrench", "bias", SENSOR_ERRORS.wrench_zero),
        ("arm_base_wrench", "drift", SENSOR_ERRORS.wrench_drift),
        ("arm_base_wrench", "cross", SENSOR_ERRORS.wrench_cross),
        ("accelerometer", "bias", SENSOR_ERRORS.accelerometer_bias),
        ("gyro", "bias", SENSOR_ERRORS.gyro_bias),
        ("gyro", "scale", SENSOR_ERRORS.gyro_scale),
    ):
        drawn = np.array([getattr(suite.channels[channel], field) for suite in suites])
        drawn = drawn - 1.0 if field == "scale" else drawn
        if channel == "arm_base_wrench" and field in ("bias", "drift"):
            drawn /= FORCE_TORQUE.full_scale
        elif channel == "arm_base_wrench" and field == "cross":
            drawn *= np.array(FORCE_TORQUE.full_scale) / np.array(FORCE_TORQUE.full_scale)[:, None]
        np.testing.assert_array_less(np.abs(drawn), most * (1.0 + 1e-9))
        others = drawn[drawn != 0.0]
        assert others.min() < -0.7 * most and others.max() > 0.7 * most, (channel, field)
        assert len(np.unique(others)) == len(others)
        if field == "cross":
            np.testing.assert_array_equal(np.einsum("nii->ni", drawn), 0.0)


def test_a_robots_errors_do_not_depend_on_what_reads_its_sensors():
    plain, boards = errors_of(DATASHEET, 3), errors_of(IDEAL, 3)
    for channel, spec in boards.channels.items():
        other = plain.channels[channel]
        for field in ("bias", "scale", "cross", "drift", "warm_up"):
            assert getattr(spec, field) == getattr(other, field)
    assert plain.channels["inclinometer"].noise == DATASHEET.channels["inclinometer"].noise
    assert errors_of(DATASHEET, 4).channels["arm_angles"] != plain.channels["arm_angles"]
