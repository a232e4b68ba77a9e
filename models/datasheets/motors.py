"""Motors of wheels and arm joints, and the electronics that drive them."""

import dataclasses
from typing import Final

from models.datasheets.units import OUNCE_INCH, RPM


@dataclasses.dataclass(frozen=True)
class MotorSheet:
    """A geared direct-current motor, seen at its output shaft.

    The thesis gives what a user measures at the shaft, so after gear friction. MuJoCo's ``dcmotor``
    is the line before friction, hence the two ``gross`` properties.

    Attributes:
        voltage: Nominal and largest supply voltage [V].
        stall_torque: Torque left at the shaft at standstill [N m].
        no_load_speed: Speed of the unloaded shaft [rad/s].
        friction: Dry friction of the gear, at the shaft [N m].
        armature: Inertia of the rotor, reflected to the shaft [kg m^2].
    """

    voltage: float
    stall_torque: float
    no_load_speed: float
    friction: float
    armature: float

    @property
    def gross_stall_torque(self) -> float:
        """Stall torque before gear friction [N m]."""
        return self.stall_torque + self.friction

    @property
    def gross_no_load_speed(self) -> float:
        """Speed at which the back-EMF equals the supply [rad/s]."""
        return self.no_load_speed * self.gross_stall_torque / self.stall_torque


WHEEL_RATED_TORQUE: Final = 208.0 * OUNCE_INCH
"""Load at which the wheel motor's speed is given [N m] (Thesis app. D)."""
WHEEL_RATED_SPEED: Final = 49.0 * RPM
"""Wheel speed under that load [rad/s] (Thesis app. D)."""
ROVER_RATED_SPEED: Final = 0.25
"""Speed of the rover at the rated torque, "approximately 25 cm/sec" [m/s] (Thesis app. D)."""
_WHEEL_STALL: Final = 908.0 * OUNCE_INCH

WHEEL_MOTOR: Final = MotorSheet(
    voltage=12.0,  # Thesis app. D
    stall_torque=_WHEEL_STALL,  # Thesis app. D: 908 oz-in
    # Thesis app. D: the straight line through stall and (208 oz-in, 49 rpm) ends at 63.56 rpm.
    no_load_speed=WHEEL_RATED_SPEED / (1.0 - WHEEL_RATED_TORQUE / _WHEEL_STALL),
    friction=0.25,  # Assumption: 4 % of the stall torque, usual for a multi-stage spur gear
    armature=0.01,  # Assumption: a rotor of 1e-6 kg m^2 behind a gear of 100:1
)
ARM_MOTOR: Final = MotorSheet(
    voltage=12.0,  # Thesis app. D
    stall_torque=1495.0 * OUNCE_INCH,  # Thesis app. D
    no_load_speed=10.0,  # Assumption: leaves half the torque at 5 rad/s (0.5 rad at 10 rad/s)
    friction=0.3,  # Assumption: 3 % of the stall torque
    armature=0.01,  # Assumption: a rotor of 1e-6 kg m^2 behind a gear of 100:1
)


@dataclasses.dataclass(frozen=True)
class PowerStageSheet:
    """National Semiconductor LMD18200T, the bridge of one motor (maker's data sheet)."""

    switch_resistance: float = 0.33  # Typical, of each of the two switches that conduct [ohm]
    continuous_current: float = 3.0  # [A]
    peak_current: float = 6.0  # For `peak_time` [A]
    peak_time: float = 0.2  # [s]
    least_pulse: float = 1e-6  # Typical; "at least 1 usec" between transitions of inputs [s]
    supply: tuple[float, float] = (12.0, 55.0)  # Operating range [V]; the rover has the least


@dataclasses.dataclass(frozen=True)
class PulseClockSheet:
    """The 555 timers that make one motor's pulses (Thesis fig. D-3).

    Levels are the maker's (NE555 data sheet); the thesis' text gives no values of the parts.
    """

    supply: float = 5.0  # Vcc [V] (Thesis app. D: laboratory supply; the control fraction's "max")
    threshold: float = 2.0 / 3.0  # Fraction of Vcc at which the capacitor stops charging
    trigger: float = 1.0 / 3.0  # Fraction of Vcc below which it charges again
    resistance_a: float = 68e3  # Assumption: 20 kHz, above hearing, ... [ohm]
    resistance_b: float = 2.2e3  # ... with 97 % duty, "close to 100 %" as the thesis asks [ohm]
    capacitance: float = 1e-9  # Assumption [F]
    converter_bits: int = 12  # Assumption: analogue output of a motion card of its time


POWER_STAGE: Final = PowerStageSheet()
PULSE_CLOCK: Final = PulseClockSheet()
