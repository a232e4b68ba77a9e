"""How far a robot as made may lie from its drawing."""

import dataclasses
from typing import Final

from models.datasheets.units import DEGREE


@dataclasses.dataclass(frozen=True)
class Tolerances:
    """Tolerances of a rover with its arm; every value is drawn uniformly, each by itself.

    A share is of the drawing's value, to either side. The makers of 2002 left no tolerances, so
    all are assumptions, stated before any run.
    """

    spring: float = 0.30  # Share, of each spring's stiffness. Assumption: small wire springs
    damper: float = 0.30  # Share, of each damper. Assumption: varies with oil and temperature
    mass: float = 0.05  # Share, of each body; its inertia goes with it. Assumption: cables, screws
    centre: float = 10e-3  # Of each body's centre of gravity along each axis [m]. Assumption
    length: float = 2e-3  # Of the places of wheels, arm and joints along each axis [m]. Assumption
    wheel_radius: float = 0.02  # Share, of each wheel. Assumption: rubber tyres, pressed in by use
    tyre_friction: tuple[float, float] | None = (0.3, 0.8)
    """Least and largest Coulomb coefficient of a robot's tyres; None for the drawing's.

    Assumption: from wet rubber on loose ground to clean rubber on rock.
    """
    joint_friction: float = 0.30  # Share, of each arm gear's. Assumption: grease and preload
    backlash: tuple[float, float] = (0.15 * DEGREE, 0.5 * DEGREE)
    """Least and largest whole play of an arm gear [rad]: a low-backlash planetary gear of the arm
    motors' size (maxon GP 32 BZ, averages by stages)."""


TOLERANCES: Final = Tolerances()
HARSH_TOLERANCES: Final = Tolerances(
    # Assumption: a robot that was used for years, about twice as far off as a new one.
    spring=0.5,
    damper=0.5,
    mass=0.1,
    centre=20e-3,
    length=4e-3,
    wheel_radius=0.04,
    tyre_friction=(0.2, 0.9),
    joint_friction=0.6,
    backlash=(0.5 * DEGREE, 1.0 * DEGREE),  # Assumption: an ordinary planetary gear
)
EXACT: Final = Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, None, 0.0, (0.0, 0.0))
"""A robot that is its drawing."""
