"""The amplifier against its circuits, integrated step by step."""

import dataclasses
import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.datasheets import ARM_MOTOR, POWER_STAGE, PULSE_CLOCK, WHEEL_MOTOR
from twin.hardware.emulator.amplifier import (
    AmplifierConfig,
    bridge_share,
    command_volts,
    converter_codes,
    current_limit,
    motor_constant,
    motor_current,
    motor_resistance,
    motor_volts,
    pulse_share,
    supplied_volts,
)

pytestmark = pytest.mark.virtual_time

CARD = AmplifierConfig()
RC = AmplifierConfig(law="rc")
# A clock that is low for 40 % of its period, so that a short pulse ends before it rises.
SLOPPY = AmplifierConfig(law="rc", resistance_a=2e3, resistance_b=4e3, capacitance=1e-8)


@numba.njit
def astable(resistance_a, resistance_b, capacitance, step, count):
    """High and low times of a 555 between 1/3 and 2/3 of its supply, last full periods."""
    voltage, high, since = 0.0, True, 0.0
    times = np.zeros((2, 2))
    for _ in range(count):
        if high:
            voltage += step * (1.0 - voltage) / ((resistance_a + resistance_b) * capacitance)
        else:
            voltage -= step * voltage / (resistance_b * capacitance)
        since += step
        if (high and voltage >= 2.0 / 3.0) or (not high and voltage <= 1.0 / 3.0):
            times[0, int(high)] = since
            high, since = not high, 0.0
    return times[0]


@numba.njit
def pulse_width_modulated(control, time_constant, high_time, low_time, step, periods):
    """Share of time for which a clocked 555 with `control` (of Vcc) on its control pin is high."""
    period = high_time + low_time
    voltage, output, high, total = 0.0, False, 0.0, 0.0
    count = int(periods * period / step)
    for index in range(count):
        time = (index * step) % period
        triggered = time < low_time  # the period begins with the clock's fall
        if triggered and control > 0.0:
            output = True  # the trigger comparator overrides the threshold's
        elif voltage >= control:
            output = False
        if output:
            voltage += step * (1.0 - voltage) / time_constant
        else:
            voltage = 0.0  # the discharge transistor
        if index * step > 0.1 * periods * period:
            high += step * output
            total += step
    return high / total


@numba.njit
def bridge(share, battery, resistance, switches, inductance, emf, frequency, cycles, steps):
    """Mean current and mean motor voltage behind a switching sign/magnitude bridge."""
    step = 1.0 / (frequency * steps)
    current, mean, volts = 0.0, 0.0, 0.0
    for cycle in range(cycles):
        for phase in range(steps):
            driven = battery if phase < share * steps else 0.0
            terminal = driven - switches * current
            current += step * (terminal - resistance * current - emf) / inductance
            if cycle >= cycles - 20:
                mean += current / (20 * steps)
                volts += terminal / (20 * steps)
    return mean, volts


@pytest.mark.parametrize(
    ("a", "b", "c"), [(68e3, 2.2e3, 1e-9), (1e3, 10e3, 1e-7), (10e3, 10e3, 1e-8)]
)
def test_clock_agrees_with_the_integrated_555(a, b, c):
    card = AmplifierConfig(resistance_a=a, resistance_b=b, capacitance=c)
    step = b * c / 20_000
    low, high = astable(a, b, c, step, int(5 * (a + 2 * b) * c / step))
    assert card.clock_low == pytest.approx(low, rel=1e-3)
    assert card.clock_high == pytest.approx(high, rel=1e-3)
    assert card.clock_frequency == pytest.approx(1 / (low + high), rel=1e-3)
    # The data sheet's rounded formulas.
    assert card.clock_frequency == pytest.approx(1.44 / ((a + 2 * b) * c), rel=3e-3)
    assert card.clock_duty == pytest.approx((a + b) / (a + 2 * b))


def test_clock_duty_is_close_to_one_as_the_thesis_wants():
    assert 0.95 < CARD.clock_duty < 1.0
    assert 18e3 < CARD.clock_frequency < 22e3
    assert CARD.clock_low > CARD.least_pulse


@pytest.mark.parametrize("card", [RC, SLOPPY])
@pytest.mark.parametrize("fraction", [0.0, 0.004, 0.1, 0.33, 0.5, 0.66, 0.7, 0.8, 0.9, 0.95])
def test_rc_law_agrees_with_the_integrated_monostable(card, fraction):
    share = pulse_width_modulated(
        fraction,
        card.pulse_time_constant,
        card.clock_high,
        card.clock_low,
        1.0 / card.clock_frequency / 5000,
        300,
    )
    assert pulse_share(fraction * card.logic_supply, card) == pytest.approx(share, abs=4e-3)


def test_rc_law_meets_the_linear_one_at_both_ends_of_its_range_only():
    top = RC.full_fraction * RC.logic_supply
    assert pulse_share(top * (1 - 1e-9), RC) == pytest.approx(RC.clock_duty, abs=1e-6)
    assert pulse_share(0.0, RC) == 0.0
    # Half of the voltage for a full pulse gives ln(3/2) / ln(3) = 37 % of it.
    assert pulse_share(top / 2, RC) / RC.clock_duty == pytest.approx(0.369, abs=1e-3)
    # Above, the frequency divides and the motor slows down.
    assert pulse_share(top * 1.05, RC) < 0.6


def test_rc_pulse_is_never_shorter_than_the_clock_is_low():
    assert pulse_share(1e-3, SLOPPY) == pytest.approx(1.0 - SLOPPY.clock_duty)
    assert pulse_share(1e-3, RC) < 0.04 < 0.39 < pulse_share(1e-3, SLOPPY)


def test_linear_law_is_the_control_fraction_of_the_clock_duty():
    np.testing.assert_allclose(
        pulse_share(np.array([0.0, 1.25, 2.5, 5.0]), CARD),
        np.array([0.0, 0.25, 0.5, 1.0]) * CARD.clock_duty,
    )


def test_converter_has_twelve_bits_of_five_volts_and_a_direction_pin():
    codes = converter_codes(np.array([-1.0, -0.5, 0.0, 0.5, 1.0]), CARD)
    np.testing.assert_array_equal(codes, [-4095, -2048, 0, 2048, 4095])
    np.testing.assert_allclose(command_volts(codes, CARD), [4.99878, 2.5, 0.0, 2.5, 4.99878], 1e-5)
    with pytest.raises(ValueError, match="converter code"):
        command_volts(np.array([4096]), CARD)
    for bad in (1.001, math.nan):
        with pytest.raises(ValueError, match="duty outside"):
            converter_codes(np.array([bad]), CARD)


def test_pulses_and_gaps_below_a_microsecond_do_not_get_through():
    least = POWER_STAGE.least_pulse * CARD.clock_frequency
    shares = np.array([0.0, least * 0.99, least * 1.01, 0.5, 1 - least * 1.01, 1 - least * 0.99])
    np.testing.assert_array_equal(
        bridge_share(shares, CARD), [0.0, 0.0, shares[2], 0.5, shares[4], 1.0]
    )


def test_dead_band_is_two_percent_of_the_command():
    codes = np.arange(4096)
    current = motor_current(codes[:, None] * np.ones(8, int), np.zeros(8), CARD)
    first = codes[np.all(current > 0.0, axis=1)][0]
    # 1 us of 50.2 us, over the clock's duty of 97 %.
    assert first / 4096 == pytest.approx(1e-6 * CARD.clock_frequency / CARD.clock_duty, abs=3e-4)
    assert 0.02 < first / 4096 < 0.021


@pytest.mark.parametrize(("code", "speed"), [(400, 0.0), (2048, 2.0), (4095, 5.0), (1000, 4.0)])
def test_mean_voltage_agrees_with_the_switching_circuit(code, speed):
    card = dataclasses.replace(CARD, peak_current=100.0)
    share = float(bridge_share(pulse_share(command_volts(code, card), card), card))
    for motor in (0, 4):
        resistance, constant = card.motor_resistance[motor], card.motor_constant[motor]
        inductance = 2e-3 * resistance  # electrical time constant of 2 ms
        args = (share, card.battery, resistance, 0.66, inductance, constant * speed)
        mean, volts = bridge(*args, card.clock_frequency, 500, 2000)
        codes, speeds = np.full(8, code), np.full(8, speed)
        assert motor_current(codes, speeds, card)[motor] == pytest.approx(mean, abs=0.01)
        assert motor_volts(codes, speeds, card)[motor] == pytest.approx(volts, abs=0.02)


@settings(deadline=None)
@given(
    st.lists(st.integers(-4095, 4095), min_size=8, max_size=8),
    st.lists(st.floats(-12.0, 12.0), min_size=8, max_size=8),
    st.sampled_from(["linear", "rc"]),
)
def test_circuit_balances_and_current_is_limited(codes, speeds, law):
    card = dataclasses.replace(CARD, law=law)
    current, volts = motor_current(codes, speeds, card), motor_volts(codes, speeds, card)
    emf = np.array(card.motor_constant) * speeds
    assert np.all(np.abs(current) <= 6.0)
    np.testing.assert_allclose(volts, emf + np.array(card.motor_resistance) * current)
    # Where the limit does not act, what the battery gives is what the parts take.
    share = bridge_share(pulse_share(command_volts(codes, card), card), card)
    supplied = np.sign(codes) * share * card.battery * current
    free = np.abs(current) < 6.0
    across = supplied_volts(codes, speeds, card)
    np.testing.assert_allclose(across * current, volts * current + 0.66 * current**2, atol=1e-9)
    drive = np.sign(codes) * share * card.battery
    np.testing.assert_allclose(across[free], drive[free], atol=1e-9)
    taken = (np.array(card.motor_resistance) + 0.66) * current**2 + emf * current
    np.testing.assert_allclose(supplied[free], taken[free], atol=1e-9)


def test_motor_runs_alike_in_both_directions():
    rng = np.random.default_rng(2)
    codes, speeds = rng.integers(-4095, 4096, 8), rng.normal(size=8)
    np.testing.assert_array_equal(
        motor_volts(-codes, -speeds, CARD), -motor_volts(codes, speeds, CARD)
    )


def test_motor_numbers_are_the_sheets_line():
    for sheet in (WHEEL_MOTOR, ARM_MOTOR):
        resistance, constant = motor_resistance(sheet), motor_constant(sheet)
        assert constant * sheet.voltage / resistance == pytest.approx(sheet.gross_stall_torque)
        assert sheet.voltage / constant == pytest.approx(sheet.gross_no_load_speed)


def test_full_command_loses_a_fifth_of_the_voltage_of_a_stalled_wheel():
    volts = motor_volts(np.full(8, 4095), np.zeros(8), CARD)
    duty, resistance = CARD.clock_duty * 4095 / 4096, motor_resistance(WHEEL_MOTOR)
    assert volts[0] == pytest.approx(12 * duty * resistance / (resistance + 0.66))
    assert 0.79 < volts[0] / 12 < 0.81


def test_arm_motor_stalls_at_the_peak_current_for_200_ms_then_at_the_continuous_one():
    codes = np.full(8, 4095)
    card = dataclasses.replace(CARD, battery=14.0)
    limit = current_limit(np.array([0.0] * 4 + [0.0, 0.19, 0.2, 1.0]), card)
    current = motor_current(codes, np.zeros(8), card, limit)
    np.testing.assert_allclose(current[4:], [6.0, 6.0, 3.0, 3.0])


def test_zero_command_shorts_a_turning_motor_and_brakes_it():
    volts = motor_volts(np.zeros(8, int), np.full(8, 3.0), CARD)
    current = motor_current(np.zeros(8, int), np.full(8, 3.0), CARD)
    assert np.all(current < 0.0)
    np.testing.assert_allclose(volts, -0.66 * current)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("law", "cubic"),
        ("converter_bits", 0),
        ("full_fraction", 1.0),
        ("resistance_b", 0.0),
        ("battery", math.nan),
        ("least_pulse", -1e-6),
        ("motor_resistance", (0.0,) * 8),
        ("motor_constant", (1.0,) * 7),
    ],
)
def test_impossible_card_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match="motors" if field == "motor_constant" else field):
        AmplifierConfig(**{field: value})


def test_defaults_are_the_makers():
    assert CARD.switch_resistance == pytest.approx(0.33)
    assert (CARD.continuous_current, CARD.peak_current) == (3.0, 6.0)
    assert CARD.full_fraction == PULSE_CLOCK.threshold == pytest.approx(2 / 3)
    low, high = POWER_STAGE.supply
    assert low <= CARD.battery <= high
