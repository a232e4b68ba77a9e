"""The thesis' motor amplifier: two 555 timers and a bridge for each motor (Thesis fig. D-3).

A 12-bit converter gives the command voltage and a direction pin the sign. A first 555 is the
clock; its fall starts a pulse of the second 555, whose control pin has the command voltage. The
LMD18200 brings the pulses to the motor at the voltage of the battery. Between pulses the bridge
shorts the motor (sign/magnitude drive), so current flows through two of its switches all the time.

All functions are pure and take the eight motors, or any other shape, at once.
"""

import dataclasses
import math
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from models.datasheets import ARM_MOTOR, POWER_STAGE, PULSE_CLOCK, WHEEL_MOTOR, MotorSheet
from perception.geometry.arrays import FloatArray, IntArray
from perception.geometry.checks import check_choice, check_numbers

PulseLaw = Literal["linear", "rc"]


def motor_constant(sheet: MotorSheet) -> float:
    """Return back-EMF per shaft speed [V s/rad], which is also torque per current [N m/A].

    The two are one number for the motor before gear friction; makers list both.
    """
    return sheet.voltage / sheet.gross_no_load_speed


def motor_resistance(sheet: MotorSheet) -> float:
    """Return the resistance of the winding [ohm]: what limits the current at standstill."""
    return sheet.voltage * motor_constant(sheet) / sheet.gross_stall_torque


_MOTORS: Final = (WHEEL_MOTOR,) * 4 + (ARM_MOTOR,) * 4


@dataclasses.dataclass(frozen=True)
class AmplifierConfig:
    """Parts of the amplifier card and the motors on it.

    Attributes:
        law: Law of the second timer's pulse over the command voltage; see `pulse_share`.
        logic_supply: Vcc of the timers and full scale of the converter [V].
        converter_bits: Resolution of the converter, without the direction pin.
        resistance_a: R_A of the clock [ohm].
        resistance_b: R_B of the clock [ohm].
        capacitance: C of the clock [F].
        full_fraction: Command voltage over Vcc at which the pulse of law "rc" is as long as the
            clock is high; it gives the RC of the second timer.
        battery: Supply of the bridge [V].
        switch_resistance: Resistance of each of the two switches that conduct [ohm].
        least_pulse: Shortest pulse or gap that the bridge passes on [s].
        peak_current: Largest motor current for `peak_time` [A].
        peak_time: [s].
        continuous_current: Largest motor current for ever [A].
        motor_resistance: Resistance of each motor's windings [ohm].
        motor_constant: Back-EMF, for each motor [V s/rad].
    """

    law: PulseLaw = "linear"
    logic_supply: float = PULSE_CLOCK.supply
    converter_bits: int = PULSE_CLOCK.converter_bits
    resistance_a: float = PULSE_CLOCK.resistance_a
    resistance_b: float = PULSE_CLOCK.resistance_b
    capacitance: float = PULSE_CLOCK.capacitance
    full_fraction: float = PULSE_CLOCK.threshold
    battery: float = WHEEL_MOTOR.voltage
    switch_resistance: float = POWER_STAGE.switch_resistance
    least_pulse: float = POWER_STAGE.least_pulse
    peak_current: float = POWER_STAGE.peak_current
    peak_time: float = POWER_STAGE.peak_time
    continuous_current: float = POWER_STAGE.continuous_current
    motor_resistance: tuple[float, ...] = tuple(motor_resistance(sheet) for sheet in _MOTORS)
    motor_constant: tuple[float, ...] = tuple(motor_constant(sheet) for sheet in _MOTORS)

    def __post_init__(self) -> None:
        """Refuse parts that make no amplifier.

        Raises:
            ValueError: Naming the field and its value.
        """
        check_choice("amplifier law", self.law, get_args(PulseLaw))
        motors = self.motor_resistance, self.motor_constant
        if len(set(map(len, motors))) > 1 or not np.all(np.array(motors) > 0.0):
            raise ValueError(
                f"amplifier motors: motor_resistance and motor_constant {motors}, needs as many "
                "positive numbers of both"
            )
        zero = "switch_resistance", "least_pulse"
        other = {"law", "motor_resistance", "motor_constant", *zero}
        names = [field.name for field in dataclasses.fields(self) if field.name not in other]
        check_numbers("amplifier", self, *names)
        check_numbers("amplifier", self, *zero, zero=True)
        if self.converter_bits > 16 or self.full_fraction >= 1.0:
            raise ValueError(
                f"amplifier converter_bits = {self.converter_bits}, full_fraction = "
                f"{self.full_fraction}: expected at most 16, and less than 1"
            )

    @property
    def full_code(self) -> int:
        """Largest code of the converter."""
        return 2**self.converter_bits - 1

    @property
    def clock_high(self) -> float:
        """Time for which the clock is high in each period [s]: C charges through R_A and R_B."""
        return math.log(2.0) * (self.resistance_a + self.resistance_b) * self.capacitance

    @property
    def clock_low(self) -> float:
        """Time for which the clock is low in each period [s]: C discharges through R_B."""
        return math.log(2.0) * self.resistance_b * self.capacitance

    @property
    def clock_frequency(self) -> float:
        """Frequency of the clock [Hz] (NE555 data sheet, 1.44 / ((R_A + 2 R_B) C))."""
        return 1.0 / (self.clock_high + self.clock_low)

    @property
    def clock_duty(self) -> float:
        """Fraction of a period for which the clock is high."""
        return self.clock_high * self.clock_frequency

    @property
    def pulse_time_constant(self) -> float:
        """RC of the second timer under law "rc" [s]."""
        return -self.clock_high / math.log1p(-self.full_fraction)


def converter_codes(duties: ArrayLike, config: AmplifierConfig) -> IntArray:
    """Return the converter codes (...) for duties (...) in [-1, 1]; the sign is the direction pin.

    Raises:
        ValueError: If a duty is not within [-1, 1].
    """
    values = np.asarray(duties, dtype=float)
    if not np.all(np.abs(values) <= 1.0):
        raise ValueError(f"duty outside of [-1, 1]: {values}")
    return np.rint(values * config.full_code).astype(np.int64)


def command_volts(codes: ArrayLike, config: AmplifierConfig) -> FloatArray:
    """Return the command voltages (...) [V] of signed converter codes (...).

    Raises:
        ValueError: If a code is beyond the converter's range.
    """
    size = np.abs(np.asarray(codes, dtype=float))
    if not np.all(size <= config.full_code):
        raise ValueError(f"converter code outside of +-{config.full_code}: {np.asarray(codes)}")
    return size * config.logic_supply / 2**config.converter_bits


def pulse_share(volts: ArrayLike, config: AmplifierConfig) -> FloatArray:
    """Return the fraction (...) of time for which the second timer's output is high.

    Law "linear" is the thesis': the clock's duty times the control fraction, volts / Vcc.

    Law "rc" is what a 555 does. Its capacitor charges through a resistor from zero up to the
    control voltage, t = -RC ln(1 - volts / Vcc), which is not proportional: with RC chosen for a
    full pulse at 2/3 of Vcc, half of that voltage gives 37 % of the pulse. A pulse is never
    shorter than the clock is low, since the low clock holds it: that is why the thesis wants a
    clock duty close to 100 %. A pulse that outlasts the period swallows the next fall of the
    clock, so that the frequency divides by 2, 3, ... and the duty falls back (as TI's data sheet
    warns): the law is not monotonic above `full_fraction`.

    Args:
        volts: Command voltages [V], 0 to Vcc.
        config: The card.
    """
    fraction = np.clip(np.asarray(volts, dtype=float) / config.logic_supply, 0.0, 1.0)
    if config.law == "linear":
        return fraction * config.clock_duty
    period = 1.0 / config.clock_frequency
    with np.errstate(divide="ignore"):
        pulse = -config.pulse_time_constant * np.log1p(-fraction)
    endless = ~np.isfinite(pulse)
    pulse = np.where(endless, 0.0, pulse)
    swallowed = np.floor(pulse / period)
    high = swallowed * period + np.maximum(pulse - swallowed * period, config.clock_low)
    share = high / ((swallowed + 1.0) * period)
    # A control pin at ground resets the timer for good.
    return np.where(endless, 1.0, np.where(fraction > 0.0, share, 0.0))


def bridge_share(share: ArrayLike, config: AmplifierConfig) -> FloatArray:
    """Return the fraction (...) of time for which the bridge drives: short pulses are lost.

    The LMD18200 wants a microsecond between two transitions of its inputs (maker's data sheet,
    "signal transition requirements"). Shorter pulses leave it off, shorter gaps leave it on.

    Args:
        share: Fraction of time for which its input is high.
        config: The card. Under law "rc" the gaps are taken as those of one clock period.
    """
    values = np.asarray(share, dtype=float)
    least = config.least_pulse * config.clock_frequency
    driven = np.where(values < least, 0.0, values)
    return np.where(1.0 - values < least, 1.0, driven)


def current_limit(high_time: ArrayLike, config: AmplifierConfig) -> FloatArray:
    """Return the largest motor currents (...) [A].

    Assumption: the card limits the current to the chip's ratings. The chip itself switches off
    only at some 10 A, or when it is too hot.

    Args:
        high_time: Time for which each motor's current has been above the continuous limit [s].
        config: The card.
    """
    spent = np.asarray(high_time, dtype=float) >= config.peak_time
    return np.where(spent, config.continuous_current, config.peak_current)


def motor_current(
    codes: ArrayLike,
    speeds: ArrayLike,
    config: AmplifierConfig,
    limit: ArrayLike | None = None,
) -> FloatArray:
    """Return the mean motor currents (8,) [A], positive in the positive sense of the motor.

    At some 20 kHz the winding's inductance keeps the current nearly constant within a period, so
    means suffice: duty battery = (R + R_bridge) i + k speed.

    Args:
        codes: (8,) signed converter codes.
        speeds: (8,) shaft speeds [rad/s].
        config: The card.
        limit: (8,) or one largest current [A]; the peak current unless given.
    """
    share = bridge_share(pulse_share(command_volts(codes, config), config), config)
    drive = np.sign(np.asarray(codes, dtype=float)) * share * config.battery
    constant, resistance = np.array(config.motor_constant), np.array(config.motor_resistance)
    emf = constant * np.asarray(speeds, dtype=float)
    most = config.peak_current if limit is None else np.asarray(limit, dtype=float)
    # Two switches of the bridge conduct.
    total = resistance + 2.0 * config.switch_resistance
    return np.clip((drive - emf) / total, -most, most)


def motor_volts(
    codes: ArrayLike,
    speeds: ArrayLike,
    config: AmplifierConfig,
    limit: ArrayLike | None = None,
) -> FloatArray:
    """Return the mean voltages (8,) between the motors' terminals [V].

    Args:
        codes: (8,) signed converter codes.
        speeds: (8,) shaft speeds [rad/s].
        config: The card.
        limit: (8,) or one largest current [A]; the peak current unless given.
    """
    current = motor_current(codes, speeds, config, limit)
    emf = np.array(config.motor_constant) * np.asarray(speeds, dtype=float)
    return emf + np.array(config.motor_resistance) * current


def supplied_volts(
    codes: ArrayLike,
    speeds: ArrayLike,
    config: AmplifierConfig,
    limit: ArrayLike | None = None,
) -> FloatArray:
    """Return the mean voltages (8,) across each motor and its two switches [V].

    They do not depend on the speeds but where the current is limited: so a simulated motor that has
    the switches' resistance as well brakes as it should between two calls, too.

    Args:
        codes: (8,) signed converter codes.
        speeds: (8,) shaft speeds [rad/s].
        config: The card.
        limit: (8,) or one largest current [A]; the peak current unless given.
    """
    current = motor_current(codes, speeds, config, limit)
    return motor_volts(codes, speeds, config, limit) + 2.0 * config.switch_resistance * current
