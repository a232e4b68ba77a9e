"""The rover without its arm."""

import dataclasses
from typing import Final

from models.datasheets.units import DEGREE


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
    deck_half_y: float = 0.10886  # Chosen so that the pitch inertia is Table 2-2's 0.072
    deck_half_z: float = 0.022  # Assumption: computer cards and batteries in one layer
    deck_gap: float = 0.003  # Assumption: clearance of a half's body to the centre joint
    arm_mount: tuple[float, float, float] = (0.0, 0.054356, 0.036195)
    """Arm mount from the centre of gravity, in the body frame [m] (Thesis Table 2-2)."""
    spring: float = 3530.0  # Gives Table 2-2's pitch stiffness (README of the rover); rounded
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


ROVER: Final = RoverSheet()
