"""Flat scenes of the insertion, where what is true can be set."""

import functools

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm, watch_plan
from controllers.insertion.card_arm import CardArm
from controllers.insertion.watching import SeenParts
from experiments.ch5.insertion_scene import (
    MASTER,
    SLAVE,
    InsertionScene,
    best_station,
    compile_insertion,
    insertion_drawing,
    transform,
)
from models.compose import ARM_JOINTS, FLAT, settle
from models.datasheets import CARD_AND_SLOT
from perception.stereo.geometry import StereoGeometry
from twin.describe import describe_rover

WIDTH = CARD_AND_SLOT.slot_widths[1]
DRAWING = insertion_drawing(WIDTH)
MASTER_ROVER = describe_rover(MASTER)
ARM, HEAD = camera_arm(MASTER_ROVER)
"""The master's arm with its camera, as drawn."""
EYES = StereoGeometry(*HEAD.camera.intrinsics, HEAD.baseline)
PLAN = watch_plan(HEAD, DRAWING)
START = (0.01, -0.62, 0.02)
"""Of the slave: the card is about 0.14 m before the mouth."""


@functools.cache
def scene() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the scene on flat ground with the master at its best place, settled."""
    model = compile_insertion(InsertionScene(WIDTH, START, best_station(WIDTH).place, FLAT))
    return model, settle(model, 0.5)


def fresh() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the scene with a copy of its state."""
    model, rest = scene()
    data = mujoco.MjData(model)
    mujoco.mj_copyData(data, model, rest)
    return model, data


def card_arm() -> CardArm:
    """Return what the slave knows of its arm with the card."""
    return CardArm(describe_rover(SLAVE, card=True), DRAWING.tip)


def arm_at(model: mujoco.MjModel, data: mujoco.MjData, robot: str, angles) -> None:
    """Put an arm's joints somewhere."""
    for name, angle in zip(ARM_JOINTS, angles, strict=True):
        data.joint(f"{robot}/{name}_joint").qpos = angle
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)


def in_robot(data: mujoco.MjData, robot: str, body: str) -> RigidTransform:
    """Return the true transform from a body to a robot's chassis."""
    return transform(data, f"{robot}/chassis").inv() * transform(data, body)


def drawn_angles(arm: CardArm, rng: np.random.Generator, margin: float = 0.05) -> np.ndarray:
    """Return joint angles anywhere within the limits."""
    low, high = arm.limits.T
    return rng.uniform(low + margin, high - margin)


def true_parts(data: mujoco.MjData) -> SeenParts:
    """Return card and slot as they truly are, master's frame."""
    card, slot = in_robot(data, MASTER, f"{SLAVE}/card"), in_robot(data, MASTER, "slot")
    return SeenParts(card, slot, DRAWING.card, DRAWING.slot)
