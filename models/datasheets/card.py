"""The computer card, the slot that it goes into, and the hand that holds it."""

import dataclasses
from typing import Final

from models.datasheets.tables import TABLE_2_2_TRUTH
from models.datasheets.units import DEGREE, INCH


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
        """Stiffness along each axis [N/m]."""
        return self.turn_stiffness / self.reach**2

    @property
    def damping(self) -> float:
        """Damping along each axis [N s/m]."""
        return self.turn_damping / self.reach**2

    @property
    def turn_stiffness(self) -> float:
        """Stiffness about each axis [N m/rad] (Thesis Table 2-2)."""
        return TABLE_2_2_TRUTH["k_pitch"]

    @property
    def turn_damping(self) -> float:
        """Damping about each axis [N m s/rad] (Thesis Table 2-2)."""
        return TABLE_2_2_TRUTH["b_pitch"]


@dataclasses.dataclass(frozen=True)
class CardGuideSheet:
    """Two card guides, an edge connector between them, and what the card has to give way to both.

    Lengths [m]. A guide has a groove for the card's edge, which opens towards the mouth. The
    connector's springs press on both faces of the card; behind them is its bottom.
    """

    clearances: tuple[float, float, float] = (1.6e-3, 0.8e-3, 0.4e-3)
    """Beside each of the card's edges, across: easy, medium, hard."""
    face_clearance: float = 0.4e-3
    """Beside each of its faces. Assumption: a groove of 2.4 mm for a board of 1.6 mm."""
    overlap: float = 4e-3  # Of the guides' lips over a card in the middle. Assumption
    depth: float = 0.04  # From the mouth to the bottom, as the walls' of the plain slot
    lead_in: tuple[float, float] = (1e-3, 0.010)
    """How far a groove opens across, and over which depth. Assumption."""
    face_lead_in: tuple[float, float] = (8e-3, 0.015)
    """The same along the card's normal: the card's ends come 7.6 mm off it if it rolls 8 degrees.
    Assumption."""
    spring_radius: float = 1.5e-3  # Of a connector's spring where the card meets it. Assumption
    interference: float = 0.4e-3  # Of each face with its spring. Assumption
    spring_force: float = 0.88  # Preload of each spring: the card snaps in at 3.0 N [N]
    spring_stiffness: float = 1000.0  # [N/m] Assumption
    seat: float = 2e-3  # From the springs' middle to the bottom. Assumption
    snap: float = 3.0  # Force at which the card snaps in, by springs and friction [N]
    roll_range: float = 12.0 * DEGREE
    """Of the gripper about the card's forward axis, each way: of compensation units (Schunk AGE)
    that give way by up to 16 degrees."""
    roll_stiffness: float = 0.3  # Of the gripper about that axis [N m/rad]. Assumption
    normal_range: float = 4e-3  # Along the card's normal, each way: of the same units
    normal_stiffness: float = 1000.0  # [N/m] Assumption
    grip: float = 12.0  # Force ahead at which the card slips in the gripper [N]. Assumption

    @property
    def mouth(self) -> float:
        """Distance along the normal, each way, at which the guides take in a card's edge [m]."""
        return self.face_lead_in[0] + self.face_clearance


CARD_AND_SLOT: Final = CardAndSlotSheet()
CARD_GUIDE: Final = CardGuideSheet()
HAND: Final = HandSheet()
