"""Scene of ``ch5-insertion``: a slave rover with the card, the slot on its post, a master rover.

The slot's mouth lies above the world's origin; the card goes in along +y, and the faces of card and
slot face +x, where the master is. So the insertion's plane is the upright plane of the
slave's arm, in which it can move the card across, ahead and in pitch (thesis assumption 1).
"""

import dataclasses
import functools
from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import CameraStation, best_camera_station
from controllers.insertion.drawing import Connector, InsertionDrawing
from models.card_and_slot.build import PAINT
from models.card_and_slot.stand import CARD_AXES, CARD_FORCE, CARD_TOUCH, SLOT_HEIGHT, TIP
from models.compose import (
    ARM_JOINTS,
    FieldConfig,
    RobotPlacement,
    arm_hold_voltage,
    make_model,
)
from models.datasheets import CARD_AND_SLOT, CARD_GUIDE
from perception.geometry.arrays import FloatArray
from perception.markers.poses import BodyCad
from twin.describe import body_pose, describe_rover

MASTER, SLAVE = "rover1", "rover2"
FIELD = FieldConfig(
    size=(4.8, 4.8),
    relief=0.02,
    cell=0.1,
    rocks=120,
    rock_radius=(0.02, 0.05),
    texture_tile=0.5,
    shadows=False,
)
"""Rough ground that all trials share."""
SEATED = (1e-3, 1e-3, *np.radians([1.0, 2.5, 1.0]))
"""What a seated card may be off ahead and beside [m], in turn, yaw and roll [rad]; across it is the
clearance and 0.2 mm."""
TOUCH = 0.2
"""Force at one contact by which a card has touched the slot [N]."""
_CONNECTOR = CARD_GUIDE.depth - 6e-3
"""Depth up to which a contact is one with the guides, before the connector [m]."""


@dataclasses.dataclass(frozen=True)
class InsertionScene:
    """Poses of the robots before a slot.

    Attributes:
        width: Width between the slot's walls [m].
        slave: (3,) x, y [m] and yaw [rad] of the slave's chassis, world.
        master: (3,) x, y [m] and yaw [rad] of the master's chassis, world.
        field: Configuration of the ground.
        guides: Whether the slot is of card guides with a connector.
    """

    width: float
    slave: tuple[float, float, float]
    master: tuple[float, float, float]
    field: FieldConfig
    guides: bool = False


@functools.cache
def insertion_drawing(width: float, guides: bool = False) -> InsertionDrawing:
    """Return the drawing of card and slot.

    Args:
        width: Width between the slot's walls, or the floors of its guides' grooves [m].
        guides: Whether the slot is of card guides with a connector.
    """
    sheet = CARD_AND_SLOT
    height = sheet.card_thickness / 2.0 + PAINT
    card = np.array([[x, y, height] for x, y in sheet.card_markers])
    outward, inward = sheet.slot_marker_inset
    side, height = width / 2.0 + outward, sheet.wall_height / 2.0 + PAINT
    slot = np.array([[-side, inward, height], [side, inward, height]])
    across = (-1.0, 0.0, 0.0)  # points down in the images
    return InsertionDrawing(
        BodyCad(card, up=across),
        BodyCad(slot, up=across),
        sheet.marker_diameter,
        sheet.card_width,
        sheet.card_length,
        sheet.friction,
        TIP,
        RigidTransform.from_components([0.0, 0.0, SLOT_HEIGHT], Rotation.from_matrix(CARD_AXES)),
        # Hand and camera head of the slave, from behind the card to its wrist.
        _box((-0.055, 0.015), (-TIP - 0.02, -TIP + 0.12), (-0.035, 0.035)),
        _box((-0.10, 0.10), (0.045, 0.16), (-0.012, 0.012)),
        Connector(CARD_GUIDE.depth, CARD_GUIDE.snap, CARD_GUIDE.mouth) if guides else None,
    )


@functools.cache
def best_station(width: float) -> CameraStation:
    """Return where the master sees card and slot best, with no other obstacle.

    Args:
        width: Width between the slot's walls [m].
    """
    return best_camera_station(describe_rover(MASTER), insertion_drawing(width))


def _box(*sides: tuple[float, float]) -> FloatArray:
    """Return (8, 3) corners."""
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def place_insertion(scene: InsertionScene) -> tuple[FieldConfig, tuple[RobotPlacement, ...]]:
    """Return the field with the slot, and the robots, of which the master alone has cameras."""
    field = dataclasses.replace(
        scene.field, slot_width=scene.width, card_guides=scene.guides, shadows=False
    )
    master = RobotPlacement(MASTER, scene.master[:2], scene.master[2], stereo=True)
    slave = RobotPlacement(SLAVE, scene.slave[:2], scene.slave[2], stereo=False, card=True)
    return field, (master, slave)


def compile_insertion(scene: InsertionScene, made: Sequence[RobotPlacement] = ()) -> mujoco.MjModel:
    """Compile a scene.

    Args:
        scene: Poses of the robots, slot and ground.
        made: Robots of `place_insertion` as made; none for those as drawn.

    Raises:
        ValueError: If the slot's width or a start is impossible.
    """
    field, robots = place_insertion(scene)
    return make_model(field, made or robots)


def begin_with_camera_at(model: mujoco.MjModel, angles: FloatArray) -> None:
    """Set the master's arm in the key frame ``home``, where its camera was placed before.

    Args:
        model: Model of `compile_insertion`; its key frame is changed.
        angles: (4,) joint angles [rad].
    """
    home = model.key("home").id
    for name, angle in zip(ARM_JOINTS, angles, strict=True):
        model.key_qpos[home, model.joint(f"{MASTER}/{name}_joint").qposadr[0]] = angle
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, home)
    mujoco.mj_forward(model, data)
    for name, voltage in zip(ARM_JOINTS, arm_hold_voltage(model, data, MASTER), strict=True):
        model.key_ctrl[home, model.actuator(f"{MASTER}/{name}").id] = voltage


def card_in_slot(data: mujoco.MjData) -> FloatArray:
    """Return the card's true pose in the slot, (6,) as of `in_slot`."""
    return in_slot(transform_between(data, f"{SLAVE}/card", "slot"))


def in_slot(transform_card_to_slot: RigidTransform) -> FloatArray:
    """Return a pose of the card: (6,) across, ahead, beside [m]; turn, yaw and roll [rad].

    The angles are those about the slot's normal, its axis across and that ahead.
    """
    yaw, roll, turn = transform_card_to_slot.rotation.as_rotvec()
    return np.array([*transform_card_to_slot.translation, turn, yaw, roll])


def contact_force(data: mujoco.MjData) -> FloatArray:
    """Return (3,) the true force by all that touches the card [N], card frame."""
    return -data.body(f"{SLAVE}/card").xmat.reshape(3, 3).T @ data.sensor(CARD_FORCE).data


class CardForces:
    """Largest true contact forces on the card.

    Attributes:
        peak: Largest of all [N].
        touch: Largest at one contact, while force guides the card and it is before the connector:
            there opposite lips may press on it at once [N].
    """

    def __init__(self) -> None:
        self.peak = self.touch = 0.0

    def note(self, data: mujoco.MjData, guided: bool) -> None:
        """Take one tick.

        Args:
            data: State of the scene.
            guided: Whether force guides the card.
        """
        self.peak = max(self.peak, float(np.linalg.norm(contact_force(data))))
        touch = float(np.linalg.norm(data.sensor(CARD_TOUCH).data))
        if guided and touch > self.touch and card_in_slot(data)[1] < _CONNECTOR:
            self.touch = touch


def is_seated(card: FloatArray, width: float) -> bool:
    """Return whether a card is seated in its guides; also where its pose is not known.

    Args:
        card: (6,) pose of the card in the slot, see `in_slot`; NaN where it is not known.
        width: Distance between the floors of the grooves [m].
    """
    across = (width - CARD_AND_SLOT.card_width) / 2.0 + 2e-4
    off = np.abs(card - [0.0, CARD_GUIDE.depth, 0.0, 0.0, 0.0, 0.0])
    return not np.any(off > [across, *SEATED])


def transform(data: mujoco.MjData, body: str) -> RigidTransform:
    """Return the true transform from a body to the world."""
    return body_pose(data, data.body(body).id)


def transform_between(data: mujoco.MjData, body: str, frame: str) -> RigidTransform:
    """Return the true transform from a body to another body's frame."""
    return transform(data, frame).inv() * transform(data, body)
