"""Planar contacts of a rectangular card with a slot (Thesis section A.4, figures A-5, A-6).

Card frame: origin in the middle of the leading edge, y ahead, x to the right. Slot frame: origin in
the middle of the mouth, y into the slot. A pose (x, y, theta) is the card's in the slot's frame.
A wrench (f_x, f_y, m) is that of the slot on the card, in the card's frame, with the moment about
its origin.

Six states exist up to a mirror image, where features of a convex rectangle meet those of a slot
that is wider than it: a mouth corner on the leading edge (1), a mouth corner on a side (2), a
card's corner on the face beside the mouth (3), both mouth corners on side and leading edge (4), a
corner on the inner wall and the other mouth corner on the opposite side (5), and that corner on the
wall alone (6). With an angle of acos(card / slot width), 4 exists only above it and 5 only below.
The thesis prints equations for 1 to 5; its state 5 has the second normal on the leading edge, which
needs a slot narrower than the card: we read f_y2 / f_x2 = tan(theta), the side. 6 is unprinted.
"""

import dataclasses
import enum
import math

import numpy as np

from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers


class Touch(enum.Enum):
    """One contact of two features, each on the side -1 (left) or 1 (right)."""

    EDGE = "mouth corner on the leading edge"
    SIDE = "mouth corner on the side"
    FACE = "corner on the face"
    WALL = "corner on the inner wall"


CORNERS = ((Touch.EDGE, Touch.SIDE), (Touch.FACE, Touch.WALL))
"""Contacts of a mouth corner with the card, and of a card's corner with a wall."""
STATES: dict[int, tuple[tuple[Touch, int], ...]] = {
    1: ((Touch.EDGE, 1),),
    2: ((Touch.SIDE, 1),),
    3: ((Touch.FACE, 1),),
    4: ((Touch.EDGE, 1), (Touch.SIDE, -1)),
    5: ((Touch.WALL, 1), (Touch.SIDE, -1)),
    6: ((Touch.WALL, 1),),
}
"""Contacts of each state, on the right side; the mirror image has the opposite signs."""


@dataclasses.dataclass(frozen=True)
class CardInSlot:
    """Shapes and friction from the CAD. Lengths [m].

    Attributes:
        card_width: Width of the card, across.
        card_length: Length of the card, along the insertion.
        slot_width: Width between the walls.
        slot_depth: Depth of the walls.
        wall: Width of the faces beside the mouth.
        friction: Coulomb coefficient between card and slot.
    """

    card_width: float
    card_length: float
    slot_width: float
    slot_depth: float
    wall: float
    friction: float

    def __post_init__(self) -> None:
        """Refuse impossible shapes, and slots that the card cannot enter.

        Raises:
            ValueError: Naming the field.
        """
        check_numbers("card in slot", self, "friction", zero=True)
        *lengths, _ = (field.name for field in dataclasses.fields(self))
        check_numbers("card in slot", self, *lengths)
        if self.slot_width <= self.card_width:
            raise ValueError(
                f"slot_width = {self.slot_width}: expected more than the card's {self.card_width}"
            )


@dataclasses.dataclass(frozen=True)
class ContactPoint:
    """A contact at a pose.

    Attributes:
        gap: Distance between the features; negative when they overlap [m].
        gradient: (3,) derivative of the gap by the pose.
        point: (2,) position in the card's frame [m].
        normal: (2,) unit force on the card, card's frame.
        excess: Distance of the point beyond the end of its feature, 0 within [m].
    """

    gap: float
    gradient: FloatArray
    point: FloatArray
    normal: FloatArray
    excess: float


def turn(theta: float) -> FloatArray:
    """Return (2, 2) from the card's frame to the slot's."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s], [s, c]])


def contact_at(shape: CardInSlot, pose: FloatArray, touch: Touch, side: int) -> ContactPoint:
    """Return gap, point and normal of one pair of features.

    Args:
        shape: Shapes of card and slot.
        pose: (3,) [m, m, rad].
        touch: Features that meet.
        side: Side of the mouth corner or of the card's corner, -1 left and 1 right.

    Returns:
        The contact, with normals at theta for EDGE and SIDE, the slot's otherwise (Thesis figure
        A-6).
    """
    rotation = turn(pose[2])
    half_card, half_slot = shape.card_width / 2.0, shape.slot_width / 2.0
    if touch in (Touch.EDGE, Touch.SIDE):
        x, y = rotation.T @ (np.array([side * half_slot, 0.0]) - pose[:2])
        move = np.column_stack([-rotation.T, [y, -x]])  # derivative of the point by the pose
        point = np.array([x, y])
        if touch is Touch.EDGE:
            excess = max(abs(x) - half_card, 0.0)
            return ContactPoint(y, move[1], point, np.array([0.0, -1.0]), excess)
        normal = np.array([-float(side), 0.0])
        excess = max(y, -y - shape.card_length, 0.0)
        return ContactPoint(side * x - half_card, side * move[0], point, normal, excess)
    point = np.array([side * half_card, 0.0])
    x, y = pose[:2] + rotation @ point
    lever = rotation @ [-point[1], point[0]]
    if touch is Touch.FACE:
        normal = rotation.T @ [0.0, -1.0]
        excess = max(half_slot - side * x, side * x - half_slot - shape.wall, 0.0)
        return ContactPoint(-y, np.array([0.0, -1.0, -lever[1]]), point, normal, excess)
    normal = rotation.T @ [-float(side), 0.0]
    excess = max(-y, y - shape.slot_depth, 0.0)
    gradient = -side * np.array([1.0, 0.0, lever[0]])
    return ContactPoint(half_slot - side * x, gradient, point, normal, excess)


def contacts_of(shape: CardInSlot, pose: FloatArray, state: int, side: int) -> list[ContactPoint]:
    """Return the contacts of a state at a pose.

    Args:
        shape: Shapes of card and slot.
        pose: (3,) pose of the card [m, m, rad].
        state: Contact state, 1 to 6.
        side: 1 as in `STATES`, -1 for the mirror image.

    Raises:
        ValueError: If there is no such state or side.
    """
    if state not in STATES or side not in (-1, 1):
        raise ValueError(f"state {state}, side {side}: expected states 1 to 6 and sides -1, 1")
    return [contact_at(shape, pose, touch, side * sign) for touch, sign in STATES[state]]


def overlap(shape: CardInSlot, pose: FloatArray) -> float:
    """Return the depth of the overlap of card and slot at a pose [m], 0 without one."""
    depths = (
        -max(contact_at(shape, pose, touch, side).gap for touch in pair)
        for side in (-1, 1)
        for pair in CORNERS
    )
    return max(0.0, *depths)


def wrench_cone(contacts: list[ContactPoint], friction: float) -> FloatArray:
    """Return (3, 2 n) wrenches whose non-negative sums n frictional contacts can give.

    The two columns of a contact are its friction cone's edges, normal part 1 (Thesis figure A-6:
    f_n + f_fr, and r x of them).
    """
    columns = []
    for contact in contacts:
        (x, y), (across, ahead) = contact.point, contact.normal
        for sign in (-1.0, 1.0):
            force = contact.normal + sign * friction * np.array([-ahead, across])
            columns.append([force[0], force[1], x * force[1] - y * force[0]])
    return np.array(columns).T


def pose_in_state(
    shape: CardInSlot, state: int, side: int, tilt: float, place: float = 0.0
) -> FloatArray:
    """Construct a pose where exactly the features of a state meet.

    Args:
        shape: Shapes of card and slot.
        state: Contact state, 1 to 6.
        side: 1 as in `STATES`, -1 for the mirror image.
        tilt: Size of the card's angle [rad]; its sign follows from state and side.
        place: Position where the features meet [m]: from the card's corner along the leading edge
            (1) or the side (2), from the mouth corner along the face (3) or the wall (6); states 4
            and 5 have no freedom left.

    Returns:
        (3,) pose, with which nothing else overlaps.

    Raises:
        ValueError: If there is no such state, or it cannot exist at this tilt and place.
    """
    if state not in STATES or side not in (-1, 1):
        raise ValueError(f"state {state}, side {side}: expected states 1 to 6 and sides -1, 1")
    theta = tilt * side * (1.0 if state in (2, 3) else -1.0)
    half_card, half_slot = shape.card_width / 2.0, shape.slot_width / 2.0
    at_slot, at_card = np.array([side * half_slot, 0.0]), np.array([side * half_card, 0.0])
    if state == 1:
        at_card[0] -= side * place
    elif state == 2:
        at_card[1] = -place
    elif state == 3:
        at_slot[0] += side * place
    elif state == 4:
        at_card[0] = side * (shape.slot_width * math.cos(tilt) - half_card)
    elif state == 6:
        at_slot[1] = place
    else:
        along = (shape.slot_width - shape.card_width * math.cos(tilt)) / math.sin(tilt)
        at_slot[1] = along * math.cos(tilt) - shape.card_width * math.sin(tilt)
    pose = np.array([*(at_slot - turn(theta) @ at_card), theta])
    beyond = max(contact.excess for contact in contacts_of(shape, pose, state, side))
    if beyond > 1e-12 or overlap(shape, pose) > 1e-9:
        raise ValueError(
            f"state {state} does not exist at {math.degrees(tilt):.2f} deg and {place * 1e3:.2f} mm"
        )
    return pose


def contact_point(shape: CardInSlot, wrench: FloatArray) -> FloatArray:
    """Return the intersection of one contact's line of action with the card's outline.

    Thesis figure A-6: the point r with r x f = m. The larger component of the force decides whether
    it is on the leading edge or on a side, so tilt and angle of friction together must stay below
    45 deg.

    Args:
        shape: Width and length of the card.
        wrench: (3,) [N, N, N m].

    Returns:
        (2,) in the card's frame, at most at the outline's end [m]; NaN if the force pulls the
        card ahead, which no contact does.
    """
    fx, fy, moment = (float(value) for value in wrench)
    half = shape.card_width / 2.0
    if abs(fx) > abs(fy):
        side = -math.copysign(1.0, fx)
        y = (side * half * fy - moment) / fx
        return np.array([side * half, min(max(y, -shape.card_length), 0.0)])
    if fy >= 0.0:
        return np.full(2, np.nan)
    return np.array([min(max(moment / fy, -half), half), 0.0])
