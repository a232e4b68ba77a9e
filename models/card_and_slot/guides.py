"""Build card guides with an edge connector, a slot that the card snaps into.

In the slot's frame (README) a guide stands on either side of the card, across: a groove that holds
the card's edge between two lips, and opens towards the mouth across and along the normal. Behind
the guides the connector's springs press on both faces of the card, and its bottom stops it.
"""

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from models.card_and_slot.build import (
    CONTACT,
    add_card,
    add_marker,
    bench_scene,
    complete_bench,
)
from models.datasheets import CARD_AND_SLOT, CARD_GUIDE

_BOX, _CAPSULE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
_COLOUR, _METAL = [0.20, 0.21, 0.25, 1.0], [0.75, 0.65, 0.25, 1.0]
_PLATE = 0.0015  # Half thickness of what leads in [m].
_CONNECTOR = 0.03  # Half width of the connector [m].
_SPRING_MASS = 0.005
"""Of a spring, with what moves with it [kg]: 450 rad/s, which a step of 1 ms resolves."""
_HARD = {"solimp": [0.99, 0.999, 1e-4, 0.5, 2.0]}
"""Contact of so light a part that it would else give way by a tenth of a millimetre."""
_STOP = {"solref_limit": [0.002, 1.0], "solimp_limit": [0.99, 0.999, 1e-5, 0.5, 2.0]}
"""End of a joint's range that a spring's preload presses it against by 5 micrometres."""
_CLUTCH = {"solref_friction": [0.002, 1.0], "solimp_friction": [0.9999, 0.9999, 1e-3, 0.5, 2.0]}
"""Dry friction that creeps by some 0.01 mm in an insertion, not by a decimetre a second."""


def width_of(clearance: float) -> float:
    """Return the distance between the floors of both grooves [m], for a clearance [m] of a card."""
    return CARD_AND_SLOT.card_width + 2.0 * clearance


def add_guides(scene: mujoco.MjSpec, parent: mujoco.MjsBody, clearance: float) -> mujoco.MjsBody:
    """Add the body ``slot`` in the parent's frame: guides, a marker on each, and the connector.

    Args:
        scene: Scene that it is attached to.
        parent: Body to add to; move the slot by its ``pos`` and ``quat``.
        clearance: Distance between each of the card's edges and the groove [m].

    Returns:
        The slot's body.

    Raises:
        ValueError: If the clearance is not a positive length, or the lips would miss the card.
    """
    if not 0.0 < clearance < CARD_GUIDE.overlap / 2.0:
        raise ValueError(
            f"clearance {clearance} m: expected more than 0, less than half the lips' overlap"
        )
    body = parent.add_body(name="slot")
    for index, (name, side) in enumerate((("left", -1.0), ("right", 1.0))):
        _add_guide(body, f"slot_{name}", side, clearance)
        outward, inward = CARD_AND_SLOT.slot_marker_inset
        across = side * (CARD_AND_SLOT.card_width / 2.0 + clearance + outward)
        top = CARD_AND_SLOT.wall_height / 2.0
        add_marker(scene, body, f"slot_marker{index}", across, inward, top)
    _add_connector(body)
    return body


def give_way(card: mujoco.MjsBody, prefix: str = "") -> None:
    """Let a card give way in its gripper: in roll, along its normal, and by slipping back.

    Args:
        card: Body of the card, in a scene whose angles are radians; gets the joints ``card_slip``,
            ``card_normal`` and ``card_roll``.
        prefix: Prefix of these names.
    """
    sheet, middle = CARD_GUIDE, [0.0, -CARD_AND_SLOT.card_length / 2.0, 0.0]
    ahead, normal = [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
    card.add_joint(
        name=f"{prefix}card_slip",
        type=_SLIDE,
        axis=ahead,
        frictionloss=sheet.grip,
        range=[-0.03, 0.0],
        armature=0.0,
        **_CLUTCH,
        **_STOP,
    )
    for name, kind, axis, reach, stiffness in (
        ("normal", _SLIDE, normal, sheet.normal_range, sheet.normal_stiffness),
        ("roll", _HINGE, ahead, sheet.roll_range, sheet.roll_stiffness),
    ):
        joint = card.add_joint(
            name=f"{prefix}card_{name}",
            type=kind,
            axis=axis,
            pos=middle,
            range=[-reach, reach],
            # Not what an arm's body has for the joints of its children.
            frictionloss=0.0,
            armature=0.0,
            **_STOP,
        )
        joint.stiffness = [stiffness, 0, 0]
        # A tenth of a second to come to rest.
        joint.damping = [0.02 * stiffness, 0, 0]


def build_guides_bench(clearance: float, friction: float = CARD_AND_SLOT.friction) -> mujoco.MjSpec:
    """Return the guides at the origin, and the card in a gripper on a compliant hand.

    As `build.build_bench`, but that the card gives way in its gripper.

    Args:
        clearance: Distance between each of the card's edges and the groove [m].
        friction: Coefficient of friction between card and slot.

    Returns:
        A scene at 1 ms.

    Raises:
        ValueError: If the clearance or the friction is out of range.
    """
    spec = bench_scene()
    add_guides(spec, spec.worldbody, clearance)
    give_way(add_card(spec, spec.body("hand")))
    complete_bench(spec, friction)
    return spec


def _add_guide(body: mujoco.MjsBody, name: str, side: float, clearance: float) -> None:
    """Add the guide to one side: its back, its two lips, and what leads in to both."""
    sheet, card = CARD_GUIDE, CARD_AND_SLOT
    inner, floor = card.card_width / 2.0 - sheet.overlap, card.card_width / 2.0 + clearance
    groove, height = card.card_thickness / 2.0 + sheet.face_clearance, card.wall_height / 2.0
    (wider, begins), (higher, lips_begin) = sheet.lead_in, sheet.face_lead_in
    outside = floor + card.wall
    _add_box(body, name, side, ((floor, outside), (begins, sheet.depth), (-height, height)))
    edge = np.array([[floor + wider, 0.0, 0.0], [floor, begins, 0.0]]) * [side, 1.0, 1.0]
    _add_lead(body, f"{name}_lead", edge, [side, 0.0, 0.0], height)
    middle = side * (inner + floor + wider) / 2.0
    for lip, face in (("front", 1.0), ("back", -1.0)):
        low, high = sorted((face * groove, face * height))
        _add_box(
            body, f"{name}_{lip}", side, ((inner, floor), (lips_begin, sheet.depth), (low, high))
        )
        mouth = [middle, 0.0, face * (groove + higher)]
        edge = np.array([mouth, [middle, lips_begin, face * groove]])
        _add_lead(body, f"{name}_{lip}_lead", edge, [0.0, 0.0, face], (floor + wider - inner) / 2.0)


def _add_connector(body: mujoco.MjsBody) -> None:
    """Add the bottom, and the springs that press on the card's faces before it."""
    sheet, half = CARD_GUIDE, CARD_AND_SLOT.card_thickness / 2.0
    height = CARD_AND_SLOT.wall_height / 2.0
    size = [_CONNECTOR, sheet.seat / 2.0, height]
    place = [0.0, sheet.depth + sheet.seat / 2.0, 0.0]
    body.add_geom(name="slot_bottom", type=_BOX, size=size, pos=place, rgba=_COLOUR, **CONTACT)
    away = half - sheet.interference + sheet.spring_radius
    for name, face in (("front", 1.0), ("back", -1.0)):
        spring = body.add_body(
            name=f"slot_spring_{name}", pos=[0.0, sheet.depth - sheet.seat, face * away]
        )
        spring.add_geom(
            name=f"slot_spring_{name}",
            type=_CAPSULE,
            fromto=[-_CONNECTOR / 2.0, 0.0, 0.0, _CONNECTOR / 2.0, 0.0, 0.0],
            size=[sheet.spring_radius, 0.0, 0.0],
            mass=_SPRING_MASS,
            rgba=_METAL,
            priority=1,
            **CONTACT | _HARD,
        )
        joint = spring.add_joint(
            name=f"slot_spring_{name}",
            type=_SLIDE,
            axis=[0.0, 0.0, face],
            range=[0.0, 2.0 * sheet.interference],
            **_STOP,
        )
        joint.stiffness = [sheet.spring_stiffness, 0, 0]
        joint.springref = -sheet.spring_force / sheet.spring_stiffness
        joint.damping = [2.0 * math.sqrt(sheet.spring_stiffness * _SPRING_MASS), 0, 0]


Span = tuple[float, float]


def _add_box(body: mujoco.MjsBody, name: str, side: float, spans: tuple[Span, Span, Span]) -> None:
    """Add a box on one side by its spans across, ahead and along the normal [m]."""
    low, high = np.transpose(spans)
    body.add_geom(
        name=name,
        type=_BOX,
        size=(high - low) / 2.0,
        pos=(high + low) / 2.0 * [side, 1.0, 1.0],
        rgba=_COLOUR,
        **CONTACT,
    )


def _add_lead(
    body: mujoco.MjsBody,
    name: str,
    edge: NDArray[np.float64],
    outward: Sequence[float],
    half_width: float,
) -> None:
    """Add a plate whose inner face leads from the mouth into a groove.

    Args:
        body: Body of the slot.
        name: Name of the plate.
        edge: (2, 3) line in the middle of its inner face, from the mouth inward [m].
        outward: (3,) direction to its outer side.
        half_width: Half its width [m].
    """
    along = edge[1] - edge[0]
    length = float(np.linalg.norm(along))
    ahead = along / length
    out = np.asarray(outward) - (outward @ ahead) * ahead
    out /= np.linalg.norm(out)
    axes, quaternion = np.column_stack([np.cross(ahead, out), ahead, out]), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    body.add_geom(
        name=name,
        type=_BOX,
        size=[half_width, length / 2.0, _PLATE],
        pos=edge.mean(axis=0) + _PLATE * out,
        quat=quaternion,
        rgba=_COLOUR,
        **CONTACT,
    )
