"""Every number of the models, in SI units, each with its source.

Sources are the thesis (by table, equation or appendix), a maker's data sheet, or "Assumption: ..."
where neither gives a value. The MJCF files have to hold literals; ``tests/models`` asserts on the
compiled model that each of them agrees with this module.

Body frame of a rover: x to the right, y forward, z up; its origin is the centre of gravity of the
rover without arm, above the middle of the wheelbase.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

OUNCE_INCH: Final = 0.028349523125 * 9.80665 * 0.0254
"""One ounce-force inch [N m] (definition)."""
RPM: Final = 2.0 * math.pi / 60.0
"""One revolution a minute [rad/s] (definition)."""
INCH: Final = 0.0254
"""One inch [m] (definition)."""
DEGREE: Final = math.pi / 180.0
"""One degree [rad] (definition)."""
GRAVITY: Final = 9.81
"""Standard acceleration of free fall as MuJoCo has it [m/s^2]."""


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

    def shaft_torque(self, duty: float, speed: float) -> float:
        """Return the torque left at a shaft that turns forward [N m].

        Args:
            duty: Fraction of the nominal voltage in [-1, 1].
            speed: Shaft speed, positive [rad/s].
        """
        drive = duty - speed / self.gross_no_load_speed
        return self.gross_stall_torque * drive - self.friction


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
class RoverSheet:
    """The four-wheeled rover without its arm.

    Lengths [m], masses [kg], heights above flat ground unless said otherwise.
    """

    mass: float = 3.74  # Thesis app. D: weight without arm
    wheel_radius: float = 0.0487  # Thesis app. D: 49 rpm give 25 cm/s (0.04872 m)
    wheel_half_width: float = 0.025  # Assumption: a tyre half as wide as it is high
    wheel_mass: float = 0.2  # Assumption: plastic rim with rubber tyre
    half_wheelbase: float = 0.15  # Assumption: overall length about 0.45 m (Thesis fig. D-1)
    half_track: float = 0.14  # Assumption: a little narrower than long
    motor_mass: float = 0.25  # Assumption: a 37 mm gear motor of this torque
    motor_half_x: float = 0.065  # Assumption: position of the motors beside the centre line
    motor_radius: float = 0.0185  # Assumption: 37 mm gear motor
    motor_half_length: float = 0.03  # Assumption: 37 mm gear motor
    deck_mass: float = 0.97  # What the weight leaves for each half's body
    deck_half_x: float = 0.09  # Assumption: body between the wheels
    deck_half_y: float = 0.10886  # Chosen so that `pitch_inertia` is Table 2-2's 0.072
    deck_half_z: float = 0.022  # Assumption: computer cards and batteries in one layer
    deck_gap: float = 0.003  # Assumption: clearance of a half's body to the centre joint
    arm_mount: tuple[float, float, float] = (0.0, 0.054356, 0.036195)
    """Arm mount from the centre of gravity, in the body frame [m] (Thesis Table 2-2)."""
    spring: float = 3530.0  # `required_spring`, rounded
    damper: float = 16.67  # 1.5 / (4 * 0.15^2) (Thesis Table 2-2, eq. A-1)
    travel: float = 0.02  # Assumption: the suspension reaches its bump stops after 2 cm
    centre_range: float = 30.0 * DEGREE  # Assumption: end stops of the centre joint
    centre_friction: float = 0.01  # Assumption: bearing of the centre joint [N m]
    centre_damping: float = 0.02  # Assumption: bearing of the centre joint [N m s/rad]
    tyre_friction: float = 0.6  # Assumption: rubber on dusty hard ground

    @property
    def sprung_mass(self) -> float:
        """Mass that the four springs carry [kg]."""
        return 2.0 * self.deck_mass + 4.0 * self.motor_mass

    @property
    def centre_height(self) -> float:
        """Height of the rover's centre of gravity [m].

        The deck's top is the arm mount, the motors and wheels lie at axle height; solving the
        centre of gravity of the three for its own height gives this.
        """
        low = 4.0 * (self.motor_mass + self.wheel_mass)
        deck = 2.0 * self.deck_mass
        above = self.arm_mount[2] - self.deck_half_z
        return (low * self.wheel_radius + deck * above) / low

    @property
    def deck_height(self) -> float:
        """Height of the decks' centres [m]."""
        return self.centre_height + self.arm_mount[2] - self.deck_half_z

    @property
    def sprung_height(self) -> float:
        """Height of the sprung mass' centre of gravity [m]."""
        moment = 2.0 * self.deck_mass * self.deck_height
        moment += 4.0 * self.motor_mass * self.wheel_radius
        return moment / self.sprung_mass

    @property
    def pitch_inertia(self) -> float:
        """Inertia of the base in pitch about the line where the tyres meet the ground [kg m^2].

        Braked wheels roll with the body, so it turns about that line, not about its centre of
        gravity: the sum over the parts of I + m h^2, where the wheels count with their height only
        because the springs leave them on the ground (README of the rover).
        """
        half_y = self.deck_half_y
        deck = (half_y**2 + self.deck_half_z**2) / 3.0 + self.deck_height**2
        deck += (self.deck_gap + half_y) ** 2
        motor = self.motor_radius**2 / 2.0 + self.wheel_radius**2 + self.half_wheelbase**2
        wheel = 1.5 * self.wheel_radius**2
        return 2.0 * self.deck_mass * deck + 4.0 * (
            self.motor_mass * motor + self.wheel_mass * wheel
        )

    @property
    def required_spring(self) -> float:
        """Spring of one wheel that gives Table 2-2's pitch stiffness [N/m].

        The sprung weight takes away m g h of what the four springs give, h above the axles, since
        the wheels roll under the body as it pitches (README of the rover).
        """
        lever = self.sprung_height - self.wheel_radius
        gravity = self.sprung_mass * GRAVITY * lever
        return (TABLE_2_2_TRUTH["k_pitch"] + gravity) / (4.0 * self.half_wheelbase**2)

    @property
    def spring_reference(self) -> float:
        """Wheel travel at which a spring is slack, so that the bare rover rides level at 0 [m]."""
        return -self.sprung_mass * GRAVITY / (4.0 * self.spring)


@dataclasses.dataclass(frozen=True)
class ArmSheet:
    """The four-degree-of-freedom arm above the force/torque sensor, stereo head included.

    Lengths [m], masses [kg]. The thesis gives the weight alone; the rest is our assumption.
    """

    mass: float = 0.76  # Thesis app. D
    base_mass: float = 0.10  # Assumption: flange of the sensor
    turret_mass: float = 0.10  # Assumption
    upper_mass: float = 0.14  # Assumption: tube and elbow motor
    forearm_mass: float = 0.10  # Assumption: tube
    wrist_mass: float = 0.08  # Assumption: gripper
    base_height: float = 0.03  # Assumption: sensor face to the base joint
    turret_height: float = 0.03  # Assumption: base joint to the shoulder
    upper_length: float = 0.20  # Assumption: the arm reaches the ground and 0.4 m ahead
    forearm_length: float = 0.18  # Assumption
    wrist_length: float = 0.12  # Assumption: wrist joint to the grip point
    joint_limits: tuple[tuple[float, float], ...] = (
        (-2.6, 2.6),  # base yaw
        (-1.0, 2.4),  # shoulder
        (-2.6, 2.6),  # elbow
        (-2.0, 2.0),  # wrist
    )
    """Ranges of the joints [rad]. Assumption: free of collisions in the forward half space."""
    home: tuple[float, float, float, float] = (0.0, 0.9, -1.4, 0.1)
    """Joint angles of the key frame [rad]. Assumption: the cameras look at the ground ahead."""


@dataclasses.dataclass(frozen=True)
class CameraSheet:
    """One camera of the stereo pair (Thesis Table D-2).

    The thesis contradicts itself: its text says a 1/3" sensor of 510 x 494 pixels of 9.6 x 7.5 um,
    its table a 1/2" one of 510 x 492 pixels and 6.4 x 4.8 mm. With the 8.5 mm lens the table's
    sensing area gives a field of view of 41.3 deg, the text's pixels 32.1 deg; it states 41.2 deg.
    So the table holds here, and the pixel pitch is the sensing area over the pixels
    (12.55 x 9.76 um; the table's 12.7 x 9.8 um would give 41.7 deg).
    """

    width: int = 510
    height: int = 492
    sensing_width: float = 6.4e-3
    sensing_height: float = 4.8e-3
    focal_length: float = 8.5e-3
    baseline: float = 0.038  # Spacing of the stereo pair [m]. Assumption: housings side by side
    mass: float = 0.120  # Table D-2: 120 g
    housing: tuple[float, float, float] = (30.5e-3, 30.5e-3, 61e-3)  # Table D-2
    signal_to_noise_db: float = 46.0  # Table D-2: more than 46 dB
    gamma: float = 0.45  # Table D-2

    @property
    def fx(self) -> float:
        """Focal length in columns [px]."""
        return self.focal_length * self.width / self.sensing_width

    @property
    def fy(self) -> float:
        """Focal length in rows [px]."""
        return self.focal_length * self.height / self.sensing_height

    @property
    def cx(self) -> float:
        """Column of the optical axis, pixel centres at whole numbers [px]."""
        return (self.width - 1) / 2.0

    @property
    def cy(self) -> float:
        """Row of the optical axis, pixel centres at whole numbers [px]."""
        return (self.height - 1) / 2.0

    @property
    def field_of_view(self) -> tuple[float, float]:
        """Horizontal and vertical field of view [rad]."""
        return (
            2.0 * math.atan(self.sensing_width / (2.0 * self.focal_length)),
            2.0 * math.atan(self.sensing_height / (2.0 * self.focal_length)),
        )


@dataclasses.dataclass(frozen=True)
class InclinometerSheet:
    """Crossbow CXTA02 two-axis tilt sensor."""

    bandwidth: float = 6.0  # -3 dB frequency [Hz] (maker)
    noise: float = 0.05 * DEGREE  # r.m.s. [rad] (maker)
    linear_range: float = 20.0 * DEGREE  # Thesis app. D: +-20 deg


@dataclasses.dataclass(frozen=True)
class InclinometerCalibration:
    """Calibration of one inclinometer axis (Thesis eq. D-1, Table D-1).

    Attributes:
        zero_voltage: Output at zero angle [V].
        sensitivity: Slope [V/deg]; eq. D-1 needs it as V/rad, so times 180/pi.
    """

    zero_voltage: float
    sensitivity: float

    def angle(self, voltage: float) -> float:
        """Return the angle [rad] that an output voltage [V] means (Thesis eq. D-1)."""
        return (voltage - self.zero_voltage) / self.sensitivity * DEGREE


@dataclasses.dataclass(frozen=True)
class ForceTorqueSheet:
    """JR3 67M25A six-axis sensor under the arm."""

    force_noise: float = 0.1  # Assumption: r.m.s., about 1/1000 of the range [N]
    torque_noise: float = 0.01  # Assumption: r.m.s., about 1/1000 of the range [N m]


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


@dataclasses.dataclass(frozen=True)
class CardAndSlotSheet:
    """The computer card and its insertion site, a slot (Thesis sections 5.3, 5.4).

    Lengths [m]. Frames: README of the model.
    """

    card_width: float = 4.25 * INCH  # Thesis section 5.4
    slot_widths: tuple[float, float, float] = (5.0 * INCH, 4.5 * INCH, 4.375 * INCH)
    """Easy, medium, hard (Thesis Table 5-1)."""
    marker_diameter: float = 0.25 * INCH  # Thesis fig. 5-10
    card_length: float = 0.10  # Assumption: a short expansion card
    card_thickness: float = 1.6e-3  # Usual thickness of a printed board
    card_density: float = 1850.0  # Glass-fibre epoxy [kg/m^3]
    slot_depth: float = 0.04  # Assumption: no bottom, the card may go through
    wall: float = 0.03  # Assumption: width of the faces beside the mouth
    wall_height: float = 0.02  # Assumption: of the walls, along the card's normal
    friction: float = 0.3  # Assumption: smooth plastic on plastic
    card_markers: tuple[tuple[float, float], ...] = ((-0.038, -0.02), (0.038, -0.02))
    """Centres on the card's face, card frame [m]. Assumption: the thesis prints no places."""
    slot_marker_inset: tuple[float, float] = (0.015, 0.015)
    """Centres on the walls' faces, from the mouth's corners outward and inward [m]. Assumption."""


@dataclasses.dataclass(frozen=True)
class HandSheet:
    """What carries the card: arm and suspension as one 6-DOF compliance (Thesis eq. A-1).

    The arm's servo holds its joints by integral action, so in the steady state it is the
    suspension that gives. Its pitch stiffness is the softest that the thesis prints; at the hand's
    reach it is taken for all three directions, and for all three turns.
    """

    reach: float = 0.4  # Assumption: the arm reaches 0.4 m ahead [m]
    mass: float = 0.15  # Wrist (`ArmSheet`) and a joint's rotor seen at the reach [kg]
    inertia: float = 0.01  # Of a joint's rotor (`ARM_MOTOR.armature`) [kg m^2]

    @property
    def stiffness(self) -> float:
        """Along each axis [N/m]."""
        return self.turn_stiffness / self.reach**2

    @property
    def damping(self) -> float:
        """Along each axis [N s/m]."""
        return self.turn_damping / self.reach**2

    @property
    def turn_stiffness(self) -> float:
        """About each axis [N m/rad] (Thesis Table 2-2)."""
        return TABLE_2_2_TRUTH["k_pitch"]

    @property
    def turn_damping(self) -> float:
        """About each axis [N m s/rad] (Thesis Table 2-2)."""
        return TABLE_2_2_TRUTH["b_pitch"]


@dataclasses.dataclass(frozen=True)
class MuscleWireSheet:
    """A muscle wire of nickel-titanium, 0.15 mm, 90 degC type (maker's table of actuator wires).

    Its temperature is a first-order lag of the power. It pulls with a force that rises from none
    where austenite starts to all where austenite is finished, falls by as much over its whole
    contraction, and never pushes.
    """

    diameter: float = 0.15e-3  # Maker: 0.006 in [m]
    force: float = 3.15  # Maker: 321 g, at 172 MPa [N]
    current: float = 0.41  # Maker: contracts in `heating_time` [A]
    resistance: float = 55.0  # Maker [ohm/m]
    heating_time: float = 1.0  # Maker [s]
    cooling_time: float = 1.7  # Maker, in still air [s]
    contraction: float = 0.04  # Maker: 4 % for many cycles
    austenite: tuple[float, float] = (88.0, 98.0)  # Maker's curve at 172 MPa [degC]
    martensite_finish: float = 62.0  # Maker's curve at 172 MPa [degC]
    ambient: float = 25.0  # Assumption [degC]
    density: float = 6450.0  # Maker [kg/m^3]
    specific_heat: float = 837.0  # Maker: 0.2 cal/(g K) [J/(kg K)]

    @property
    def time_constant(self) -> float:
        """Of the lag [s]: cooling from all austenite to all martensite takes `cooling_time`."""
        hot, cold = self.austenite[1] - self.ambient, self.martensite_finish - self.ambient
        return self.cooling_time / math.log(hot / cold)

    @property
    def heating(self) -> float:
        """What the current would warm it by in the end [K]: `heating_time` to all austenite."""
        rise = self.austenite[1] - self.ambient
        return rise / (1.0 - math.exp(-self.heating_time / self.time_constant))


@dataclasses.dataclass(frozen=True)
class BraidSheet:
    """A stage of BRAID (Thesis appendix E, which prints no size).

    Lengths [m]. The legs' detents are double wells: the force is ``k x (x^2 / h^2 - 1)`` at x from
    the middle of a leg, h half of what it extends by.
    """

    radius: float = 0.05  # Assumption: of the joints' circle on each disc
    short: float = 0.05  # Assumption: a leg as long as the radius, ...
    long: float = 0.065  # ... and 30 % more, as `appe-workspace` and `appe-inverse` have it
    barrier: float = 25.0  # Assumption: three times what five stages and a head load it by [N]
    damping: float = 400.0  # Assumption: of a leg [N s/m]; with less, five stages shake legs over
    strands: int = 16  # Assumption: wires side by side; all pull twice the barrier
    disc_thickness: float = 4e-3  # Assumption
    rim: float = 6e-3  # Assumption: disc beyond the joints
    density: float = 940.0  # Ultra-high-molecular-weight polyethylene [kg/m^3] (handbook)
    modulus: float = 0.7e9  # The same [Pa], as `controllers.braid.flexure` has it
    flexure: tuple[float, float, float] = (5e-3, 10e-3, 0.7e-3)
    """Length, width and thickness of a leg's hinge. Assumption, thin enough for its fatigue."""
    rod_radius: float = 3e-3  # Assumption
    sleeve_radius: float = 5e-3  # Assumption
    rod_mass: float = 0.008  # Assumption: with its foot and the posts that wires are folded over
    sleeve_mass: float = 0.008  # Assumption

    @property
    def half_stroke(self) -> float:
        """Half of what a leg extends by, h [m]."""
        return 0.5 * (self.long - self.short)

    @property
    def middle(self) -> float:
        """Length of a leg on top of its barrier [m]."""
        return 0.5 * (self.long + self.short)

    @property
    def detent(self) -> float:
        """Stiffness k of the double well [N/m]: its force 2 k h / sqrt(27) is the barrier."""
        return self.barrier * math.sqrt(27.0) / (2.0 * self.half_stroke)

    @property
    def wire_length(self) -> float:
        """Of each wire, folded over posts: it contracts by the whole stroke [m]."""
        return 2.0 * self.half_stroke / MUSCLE_WIRE.contraction

    @property
    def leg_power(self) -> float:
        """What heating one bundle takes [W]."""
        ohmic = MUSCLE_WIRE.current**2 * MUSCLE_WIRE.resistance
        return self.strands * self.wire_length * ohmic

    @property
    def flexure_stiffness(self) -> float:
        """Of a leg's hinge, E w t^3 / (12 length) [N m/rad]."""
        length, width, thickness = self.flexure
        return self.modulus * width * thickness**3 / (12.0 * length)


@dataclasses.dataclass(frozen=True)
class RodArm:
    """The arm of the simulation study: a slender rod along its y axis (Thesis section 2.6.1)."""

    mass: float = 1.0
    ixx: float = 0.02
    iyy: float = 0.001
    izz: float = 0.02
    centre: float = 0.245  # Distance of its centre of gravity along y [m]


ROVER: Final = RoverSheet()
ARM: Final = ArmSheet()
CAMERA: Final = CameraSheet()
INCLINOMETER: Final = InclinometerSheet()
FORCE_TORQUE: Final = ForceTorqueSheet()
POWER_STAGE: Final = PowerStageSheet()
PULSE_CLOCK: Final = PulseClockSheet()
ROD_ARM: Final = RodArm()
CARD_AND_SLOT: Final = CardAndSlotSheet()
HAND: Final = HandSheet()
MUSCLE_WIRE: Final = MuscleWireSheet()
BRAID: Final = BraidSheet()

INCLINOMETER_CALIBRATION: Final[Mapping[str, Mapping[str, InclinometerCalibration]]] = (
    MappingProxyType(
        {
            "robot1": MappingProxyType(
                {
                    "roll": InclinometerCalibration(2.406, 33.631e-3),
                    "pitch": InclinometerCalibration(2.381, 34.733e-3),
                }
            ),
            "robot2": MappingProxyType(
                {
                    "roll": InclinometerCalibration(2.447, 29.338e-3),
                    "pitch": InclinometerCalibration(2.392, 34.905e-3),
                }
            ),
        }
    )
)
"""Thesis Table D-1, by robot and axis."""


def _table(text: str, column: int) -> Mapping[str, float]:
    rows = (line.split() for line in text.strip().splitlines())
    return MappingProxyType({row[0]: float(row[column]) for row in rows})


_TABLE_2_1: Final = """
mass      3.0     4.021     3.655
ixx       0.15    0.123     0.144
iyy       0.10    0.054     0.089
izz       0.20    0.119     0.177
ixz       0.0     0.045     0.011
iyz       0.03    0.071     0.047
ixy       0.0     0.037     0.014
rx        0.01    0.030     0.012
ry        0.3     0.512     0.360
rz        0.1    -1.053     0.042
bx      100.0   142.554    78.362
by      100.0   139.956    75.559
bz      300.0    22.368    16.757
b_pitch 200.0    78.665   195.264
b_roll  300.0   105.061   266.254
b_yaw   400.0   133.714   333.860
kx     1000.0  1103.281   979.494
ky     1000.0  1094.529  1244.836
kz      500.0   390.469   375.479
k_pitch 2000.0  945.103  1934.569
k_roll  2500.0 1950.426  2394.257
k_yaw   3000.0 2402.537  2891.637
"""
TABLE_2_1_TRUTH: Final = _table(_TABLE_2_1, 1)
"""Thesis Table 2-1, true values: mass [kg], inertia [kg m^2], r from the base's centre of gravity
to the arm mount [m], damping [N s/m, N m s/rad], stiffness [N/m, N m/rad]."""
TABLE_2_1_CONSTANT: Final = _table(_TABLE_2_1, 2)
"""Thesis Table 2-1, estimates under the constant-parameter excitation."""
TABLE_2_1_VARIABLE: Final = _table(_TABLE_2_1, 3)
"""Thesis Table 2-1, estimates under the variable-parameter excitation."""
TABLE_2_1_AVERAGE_ERROR: Final = (108.8, 18.9)
"""Thesis Table 2-1, printed average errors, constant and variable [%]."""

_TABLE_2_2: Final = """
ixx       0.072      0.041    0.035
ry        0.054356  -0.072    0.072
rz        0.036195  -0.091    0.052
b_pitch   1.5        7.543    1.459
k_pitch 317.0      354.711  327.885
"""
TABLE_2_2_TRUTH: Final = _table(_TABLE_2_2, 1)
"""Thesis Table 2-2, values measured in the laboratory; units as in Table 2-1."""
TABLE_2_2_CONSTANT: Final = _table(_TABLE_2_2, 2)
"""Thesis Table 2-2, estimates under the constant-parameter excitation."""
TABLE_2_2_VARIABLE: Final = _table(_TABLE_2_2, 3)
"""Thesis Table 2-2, estimates under the variable-parameter excitation."""
TABLE_2_2_AVERAGE_ERROR: Final = (208.4, 26.8)
"""Thesis Table 2-2, printed average errors, constant and variable [%]."""
