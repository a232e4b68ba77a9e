"""Flat scenes of the insertion, where what is true can be set."""

from __future__ import annotations

import functools

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.card_arm import CardArm
from controllers.insertion.watching import SeenParts
from controllers.kinematics.chain import Chain
from experiments.ch2.known_arm import known_arm
from experiments.ch5.insertion_scene import (
    MASTER,
    SLAVE,
    InsertionScene,
    compile_insertion,
    transform,
)
from experiments.ch5.insertion_stand import best_stand, card_cad, reference_arm, slot_cad
from models import datasheets
from models.card_and_slot.stand import TIP
from models.compose import ARM_JOINTS, FLAT, settle
from models.datasheets import CARD_AND_SLOT

WIDTH = CARD_AND_SLOT.slot_widths[1]
START = (0.01, -0.62, 0.02)
"""Of the slave: the card is about 0.14 m before the mouth."""


@functools.cache
def scene() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the scene on flat ground with the master at its best place, settled."""
    model = compile_insertion(InsertionScene(WIDTH, START, best_stand(WIDTH).place, FLAT))
    return model, settle(model, 0.5)


def fresh() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the scene with a copy of its state."""
    model, rest = scene()
    data = mujoco.MjData(model)
    mujoco.mj_copyData(data, model, rest)
    return model, data


def card_arm() -> CardArm:
    """Return what the slave knows of its arm with the card."""
    known = known_arm(scene()[0], SLAVE)
    chain = Chain.of_arm(known, datasheets.ARM_MOTOR.armature)
    return CardArm(reference_arm(), chain, TIP, known.base)


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
    return SeenParts(card, slot, card_cad(), slot_cad(WIDTH))
