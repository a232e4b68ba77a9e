"""Scene of ``ch5-insertion``: a slave rover with the card, the slot on its post, a master rover.

The slot's mouth lies above the world's origin; the card goes in along +y, and the faces of card and
slot look along +x, where the master stands. So the insertion's plane is the upright plane of the
slave's arm, in which it can move the card across, ahead and in pitch (thesis assumption 1).
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from experiments.known_camera_arm import body_pose
from models.card_and_slot.build import add_card, add_slot
from models.compose import (
    ARM_JOINTS,
    FieldConfig,
    RobotPlacement,
    add_home,
    arm_hold_voltage,
    build_scene,
    compile_scene,
    make_terrain,
)
from models.datasheets import CARD_AND_SLOT

FloatArray = NDArray[np.float64]

MASTER, SLAVE = "rover1", "rover2"
SLOT_HEIGHT = 0.30
"""Of the mouth's middle above the ground at its post [m]."""
GRIP = 0.10
"""From the wrist's joint to the card's trailing edge [m]: within the fingers."""
TIP = GRIP + CARD_AND_SLOT.card_length
"""From the wrist's joint to the middle of the card's leading edge [m]."""
CARD_AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Columns are the card's axes in the wrist's frame, and the slot's in the world: across is down,
ahead is forward, the normal is to the right."""
CARD_FORCE = "truth_card_force"
OVERVIEW = "overview"
"""Camera that looks at both rovers, for pictures."""
_POST = 0.012  # Half width of the post [m].


@dataclasses.dataclass(frozen=True)
class InsertionScene:
    """Where everything stands.

    Attributes:
        width: Between the slot's walls [m].
        slave: (3,) x, y [m] and yaw [rad] of the slave's chassis.
        master: (3,) the same of the master's.
        field: The ground.
    """

    width: float
    slave: tuple[float, float, float]
    master: tuple[float, float, float]
    field: FieldConfig


def compile_insertion(scene: InsertionScene) -> mujoco.MjModel:
    """Compile the scene.

    Args:
        scene: Where everything stands.

    Raises:
        ValueError: If the slot's width or a start is impossible.
    """
    robots = placements(scene)
    spec = build_scene(scene.field, robots)
    wrist = spec.body(f"{SLAVE}/wrist")
    card = add_card(wrist, f"{SLAVE}/")
    card.pos = [0.0, TIP, 0.0]
    card.quat = _quaternion(CARD_AXES)
    ground = float(make_terrain(scene.field, robots).ground_at(np.zeros(2)))
    slot = add_slot(spec.worldbody, scene.width)
    slot.pos = [0.0, 0.0, ground + SLOT_HEIGHT]
    slot.quat = _quaternion(CARD_AXES)
    _add_post(spec, scene.width, ground)
    # For scoring alone: what the hand puts on the card.
    spec.add_sensor(
        name=CARD_FORCE,
        type=mujoco.mjtSensor.mjSENS_FORCE,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname=f"{SLAVE}/card_wrench",
    )
    spec.worldbody.add_camera(
        name=OVERVIEW,
        pos=[0.75, -1.25, ground + 0.68],
        xyaxes=[0.92, 0.39, 0.0, -0.12, 0.28, 0.95],
        fovy=46,
    )
    add_home(spec, robots)
    model = compile_scene(spec)
    # Shadows take two thirds of the time of an image.
    model.light_castshadow[:] = 0
    return model


def placements(scene: InsertionScene) -> list[RobotPlacement]:
    """Return the robots of a scene; only the master has cameras."""
    return [
        RobotPlacement(MASTER, scene.master[:2], scene.master[2], stereo=True),
        RobotPlacement(SLAVE, scene.slave[:2], scene.slave[2], stereo=False),
    ]


def begin_with_camera_at(model: mujoco.MjModel, angles: FloatArray) -> None:
    """Let the master's arm begin where its camera was taken before, in the key frame ``home``.

    Args:
        model: From `compile_insertion`; its key frame is changed.
        angles: (4,) of the joints [rad].
    """
    home = model.key("home").id
    for name, angle in zip(ARM_JOINTS, angles, strict=True):
        model.key_qpos[home, model.joint(f"{MASTER}/{name}_joint").qposadr[0]] = angle
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, home)
    mujoco.mj_forward(model, data)
    voltages = arm_hold_voltage(model, data, MASTER)
    for name, voltage in zip(ARM_JOINTS, voltages, strict=True):
        model.key_ctrl[home, model.actuator(f"{MASTER}/{name}").id] = voltage


def card_in_slot(data: mujoco.MjData) -> FloatArray:
    """Return the card's true pose in the slot: (6,) across, ahead, beside [m], and turns [rad].

    The turns are pitch (about the normal) and those about the slot's x and y axes.
    """
    slot, card = data.body("slot"), data.body(f"{SLAVE}/card")
    turn = slot.xmat.reshape(3, 3)
    relative = Rotation.from_matrix(turn.T @ card.xmat.reshape(3, 3)).as_rotvec()
    return np.array([*(turn.T @ (card.xpos - slot.xpos)), relative[2], relative[0], relative[1]])


def contact_force(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return (3,) what truly touches the card [N], card frame, but for the card's inertia."""
    body = model.body(f"{SLAVE}/card").id
    weight = data.xmat[body].reshape(3, 3).T @ model.opt.gravity * model.body_mass[body]
    return -data.sensor(CARD_FORCE).data - weight


def transform(data: mujoco.MjData, body: str) -> RigidTransform:
    """Return the true transform from a body to the world."""
    return body_pose(data, data.body(body).id)


def _add_post(spec: mujoco.MjSpec, width: float, ground: float) -> None:
    """Hold both walls from behind: a post, and a bracket at the far end of the walls."""
    sheet = CARD_AND_SLOT
    outer = width / 2.0 + sheet.wall
    depth, middle = sheet.slot_depth, ground + SLOT_HEIGHT
    box = mujoco.mjtGeom.mjGEOM_BOX
    colour = [0.45, 0.46, 0.48, 1.0]
    # Behind the slot, so that the card may go through.
    back = depth + 0.10
    spec.worldbody.add_geom(
        name="post",
        type=box,
        size=[_POST, _POST, (SLOT_HEIGHT + outer) / 2.0],
        pos=[0.0, back, ground + (SLOT_HEIGHT + outer) / 2.0],
        rgba=colour,
    )
    for name, side in (("upper", 1.0), ("lower", -1.0)):
        height = middle + side * (outer - sheet.wall / 2.0)
        spec.worldbody.add_geom(
            name=f"bracket_{name}",
            type=box,
            size=[_POST / 2.0, (back - depth) / 2.0, sheet.wall / 2.0],
            pos=[0.0, (back + depth) / 2.0, height],
            rgba=colour,
        )


def _quaternion(axes: FloatArray) -> FloatArray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes).ravel())
    return quaternion
