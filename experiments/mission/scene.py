"""Scene of ``mission``: two rovers dropped before a slot, on rough ground, beside a known panel.

The panel is the target of chapter 3: whoever sees it knows where it stands. Slot and panel belong
to one site whose drawing the robots have. They were told where they would be dropped; they land
some centimetres and degrees beside.
"""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.ch5.insertion_scene import MASTER, SLAVE, transform
from models.clutter import PanelConfig
from models.compose import FieldConfig, RobotPlacement, make_model
from perception.geometry.se3 import transport_covariance
from perception.registration.target import TargetCad

FloatArray = NDArray[np.float64]

NOMINAL = {MASTER: (0.82, -0.35, math.pi / 2), SLAVE: (0.0, -0.92, 0.0)}
"""Where the robots should be dropped: x, y [m] and yaw [rad], world."""
DROP_PLACE, DROP_YAW = 0.06, 0.10
"""They land evenly within this of it, in x and y [m] and in yaw [rad]."""
PANEL = PanelConfig((-0.5, -0.3), yaw=math.pi / 2, tilt=0.3)
SURVEY_PLACE, SURVEY_TURN = 1e-3, 1e-3
"""Deviations by which the site differs from its drawing, along each axis [m] and about it [rad]."""


@dataclasses.dataclass(frozen=True)
class MissionScene:
    """What is built.

    Attributes:
        field: Ground, rocks, panel and slot.
        robots: The master, and the slave with the card.
    """

    field: FieldConfig
    robots: tuple[RobotPlacement, RobotPlacement]


def draw_scene(width: float, rng: np.random.Generator) -> MissionScene:
    """Draw ground and drops.

    Args:
        width: Between the slot's walls [m].
        rng: Source of randomness.
    """
    field = FieldConfig(
        size=(4.8, 4.8),
        relief=0.02,
        cell=0.1,
        rocks=120,
        rock_radius=(0.02, 0.05),
        seed=int(rng.integers(2**31)),
        texture_pixels=2048,
        texture_tile=0.5,
        panel=PANEL,
        slot_width=width,
        shadows=False,
    )
    spread = np.array([DROP_PLACE, DROP_PLACE, DROP_YAW])
    robots = []
    for name, nominal in NOMINAL.items():
        x, y, yaw = np.array(nominal) + spread * rng.uniform(-1.0, 1.0, 3)
        robots.append(RobotPlacement(name, (x, y), yaw, card=name == SLAVE))
    return MissionScene(field, (robots[0], robots[1]))


@dataclasses.dataclass(frozen=True)
class Site:
    """What the robots have a drawing of.

    Attributes:
        target: Markers of the panel.
        transform_slot_to_panel: As drawn.
        covariance: (6, 6) of xi in ``true = from_exp_coords(xi) * transform_slot_to_panel``.
        panel: Roughly, the transform from the panel to the world in which `NOMINAL` is given.
    """

    target: TargetCad
    transform_slot_to_panel: RigidTransform
    covariance: FloatArray
    panel: RigidTransform


def survey(scene: MissionScene, rng: np.random.Generator) -> Site:
    """Return the drawing, which differs from what was built.

    Args:
        scene: As built.
        rng: Source of the differences.
    """
    model = make_model(dataclasses.replace(scene.field, texture_pixels=16), ())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    panel, slot = transform(data, "panel"), transform(data, "slot")
    deviations = np.array([SURVEY_TURN] * 3 + [SURVEY_PLACE] * 3)
    true = panel.inv() * slot
    centred = RigidTransform.from_translation(true.translation)
    error = RigidTransform.from_exp_coords(deviations * rng.normal(size=6))
    # Errors about the slot's own place, in the panel's axes.
    drawn = centred * error * centred.inv() * true
    marker = PANEL.markers[0]
    return Site(
        TargetCad(PANEL.marker_points, marker.radius, marker.dark),
        drawn,
        transport_covariance(centred, np.diag(deviations**2)),
        panel,
    )
