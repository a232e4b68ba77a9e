"""Drawing of card and slot, their markers, and the obstacles about them.

Card and slot have the same axes when the card is in: x across, y ahead into the slot, z out of the
marked faces (Thesis section 5.2). The ground frame lies on level ground below the middle of the
slot's mouth, with z up and y into the slot.
"""

import dataclasses

from scipy.spatial.transform import RigidTransform

from controllers.insertion.watching import SeenParts
from perception.geometry.arrays import FloatArray
from perception.markers.poses import BodyCad


@dataclasses.dataclass(frozen=True)
class Connector:
    """What the card snaps into, behind card guides.

    Attributes:
        depth: Depth at which its bottom stops the card [m].
        snap: Force at which it lets the card in [N].
        mouth: Distance along the normal, each way, at which the guides take in a card's edge [m].
    """

    depth: float
    snap: float
    mouth: float


@dataclasses.dataclass(frozen=True, eq=False)
class InsertionDrawing:
    """Drawing of card and slot, with their markers and holders.

    Attributes:
        card: Markers of the card, card frame.
        slot: Markers of the slot, slot frame.
        marker_diameter: Diameter of a marker [m].
        card_width: Width of the card, across [m].
        card_length: Length of the card, ahead [m].
        friction: Coulomb coefficient between card and slot.
        tip: Distance from the joint of the wrist that holds the card to the middle of the card's
            leading edge [m].
        transform_slot_to_ground: Transform from the slot to the ground frame.
        card_holder: (K, 3) corners of a box about the card's holder [m], card frame.
        slot_holder: (L, 3) corners of a box about the slot's holder [m], slot frame.
        connector: What the card snaps into; None for a slot of two plain walls.
    """

    card: BodyCad
    slot: BodyCad
    marker_diameter: float
    card_width: float
    card_length: float
    friction: float
    tip: float
    transform_slot_to_ground: RigidTransform
    card_holder: FloatArray
    slot_holder: FloatArray
    connector: Connector | None = None

    def parts(
        self, gap: float, transform_ground_to_frame: RigidTransform | None = None
    ) -> SeenParts:
        """Return card and slot aligned at a gap.

        Args:
            gap: Distance from the card's leading edge to the mouth [m].
            transform_ground_to_frame: Transform from the ground frame to that of the result; None
                for the ground frame.
        """
        slot = self.transform_slot_to_ground
        card = RigidTransform.from_components(slot.translation - [0.0, gap, 0.0], slot.rotation)
        if transform_ground_to_frame is not None:
            slot, card = (transform_ground_to_frame * pose for pose in (slot, card))
        return SeenParts(card, slot, self.card, self.slot)
