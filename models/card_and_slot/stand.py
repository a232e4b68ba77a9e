"""Card and slot where rovers use them: the card in a gripper, the slot on its post.

The slot's mouth lies above the world's origin; the card goes in along +y, and the faces of card and
slot look along +x. So the insertion's plane is the upright plane of an arm that points along y, in
which it can move the card across, ahead and in pitch (thesis section 5.2, assumption 1).
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from models.card_and_slot.build import add_card, add_slot
from models.card_and_slot.guides import add_guides, give_way
from models.datasheets import CARD_AND_SLOT

SLOT_HEIGHT = 0.30
"""Height of the mouth's middle above the ground at its post [m]."""
GRIP = 0.10
"""Distance from the wrist's joint to the card's trailing edge [m]: within the fingers."""
TIP = GRIP + CARD_AND_SLOT.card_length
"""Distance from the wrist's joint to the middle of the card's leading edge [m]."""
CARD_AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Columns are the card's axes in the wrist's frame, and the slot's in the world: across is down,
ahead is forward, the normal is to the right."""
CARD_FORCE = "truth_card_force"
"""Sensor of the force by the card on all that touches it, world frame, for scoring alone."""
CARD_TOUCH = "truth_card_touch"
"""Sensor of the largest force at one contact of the card, that contact's frame, for scoring."""
OVERVIEW, SITE_VIEW = "overview", "site_view"
"""Cameras for pictures: both rovers at the slot, and the site with the panel."""
_POST = 0.012  # Half width of the post [m].
_LARGEST_FORCE, _NET_FORCE = 2, 3  # MuJoCo's numbers of how contacts are reduced to one.


def hold_card(scene: mujoco.MjSpec, robot: str, gives: bool = False) -> None:
    """Put the card into a robot's gripper.

    Args:
        scene: Scene with the robot and its arm.
        robot: Name of the robot.
        gives: Whether the card gives way in the gripper, see `guides.give_way`.
    """
    card = add_card(scene, scene.body(f"{robot}/wrist"), f"{robot}/")
    card.pos = [0.0, TIP, 0.0]
    card.quat = _quaternion(CARD_AXES)
    if gives:
        give_way(card, f"{robot}/")
    for name, reduced in ((CARD_FORCE, _NET_FORCE), (CARD_TOUCH, _LARGEST_FORCE)):
        scene.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=f"{robot}/card",
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), reduced, 1],
        )


def stand_slot(scene: mujoco.MjSpec, width: float, ground: float, guides: bool = False) -> None:
    """Add the slot and what holds it.

    Args:
        scene: Scene to add to.
        width: Distance between the slot's walls [m].
        ground: Height of the ground at the origin [m].
        guides: Whether it is of card guides with a connector, and the width that between the floors
            of their grooves.

    Raises:
        ValueError: If the width is not a positive length, or not one of a groove for the card.
    """
    if guides:
        slot = add_guides(scene, scene.worldbody, (width - CARD_AND_SLOT.card_width) / 2.0)
    else:
        slot = add_slot(scene, scene.worldbody, width)
    slot.pos = [0.0, 0.0, ground + SLOT_HEIGHT]
    slot.quat = _quaternion(CARD_AXES)
    _add_post(scene, width, ground)
    _add_camera(scene, OVERVIEW, (0.75, -1.25, ground + 0.68), (0.0, 0.05, ground + 0.2), 46.0)
    _add_camera(scene, SITE_VIEW, (1.15, -1.9, ground + 1.15), (0.12, -0.3, ground + 0.1), 44.0)


def _add_camera(
    scene: mujoco.MjSpec,
    name: str,
    place: tuple[float, float, float],
    target: tuple[float, float, float],
    field: float,
) -> None:
    """Add a camera that looks at a point, its rows level; the field of view is in degrees."""
    back = np.subtract(place, target)
    right = np.cross([0.0, 0.0, 1.0], back)
    up = np.cross(back, right)
    scene.worldbody.add_camera(name=name, pos=place, xyaxes=[*right, *up], fovy=field)


def _add_post(scene: mujoco.MjSpec, width: float, ground: float) -> None:
    """Hold both walls from behind: a post, and a bracket at the far end of the walls."""
    sheet = CARD_AND_SLOT
    outer = width / 2.0 + sheet.wall
    depth, middle = sheet.slot_depth, ground + SLOT_HEIGHT
    box = mujoco.mjtGeom.mjGEOM_BOX
    colour = [0.45, 0.46, 0.48, 1.0]
    # Behind the slot, so that the card may go through.
    back = depth + 0.10
    scene.worldbody.add_geom(
        name="post",
        type=box,
        size=[_POST, _POST, (SLOT_HEIGHT + outer) / 2.0],
        pos=[0.0, back, ground + (SLOT_HEIGHT + outer) / 2.0],
        rgba=colour,
    )
    for name, side in (("upper", 1.0), ("lower", -1.0)):
        height = middle + side * (outer - sheet.wall / 2.0)
        scene.worldbody.add_geom(
            name=f"bracket_{name}",
            type=box,
            size=[_POST / 2.0, (back - depth) / 2.0, sheet.wall / 2.0],
            pos=[0.0, (back + depth) / 2.0, height],
            rgba=colour,
        )


def _quaternion(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    return quaternion
