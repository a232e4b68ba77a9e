"""BRAID and the muscle wires that switch it (Thesis appendix E)."""

import dataclasses
import math
from typing import Final


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
        """Time constant of the lag [s]: cooling to all martensite takes `cooling_time`."""
        hot, cold = self.austenite[1] - self.ambient, self.martensite_finish - self.ambient
        return self.cooling_time / math.log(hot / cold)

    @property
    def heating(self) -> float:
        """Final rise of temperature under the current [K]: `heating_time` to all austenite."""
        rise = self.austenite[1] - self.ambient
        return rise / (1.0 - math.exp(-self.heating_time / self.time_constant))


MUSCLE_WIRE: Final = MuscleWireSheet()


@dataclasses.dataclass(frozen=True)
class BraidSheet:
    """A stage of BRAID (Thesis appendix E, which prints no size).

    Lengths [m]. The legs' detents are double wells: x off a leg's middle it is pushed away
    from there by ``k x (1 - x^2 / h^2)``, h half of what it extends by.
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
    modulus: float = 0.7e9  # The same [Pa], as `controllers.braid.arm.flexure` has it
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
    def leg_power(self) -> float:
        """Power that heats a bundle [W]; each wire, folded over posts, contracts by the stroke."""
        length = 2.0 * self.half_stroke / MUSCLE_WIRE.contraction
        return self.strands * length * (MUSCLE_WIRE.current**2 * MUSCLE_WIRE.resistance)

    @property
    def flexure_stiffness(self) -> float:
        """Stiffness of a leg's hinge, E w t^3 / (12 length) [N m/rad]."""
        length, width, thickness = self.flexure
        return self.modulus * width * thickness**3 / (12.0 * length)


BRAID: Final = BraidSheet()
