"""Scene of ``mission``: two rovers before a slot, on rough ground, beside a known panel.

The panel is the target of chapter 3: a robot that detects it is localized on the map. Slot and
panel belong to one site whose drawing the robots have. The robots start some centimetres and
degrees off their nominal initial poses.
"""

import dataclasses
import math

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.mission.site import MissionRoles, SiteDrawing
from experiments.ch5.insertion_scene import (
    FIELD,
    MASTER,
    SLAVE,
    insertion_drawing,
    transform_between,
)
from models.clutter import PanelConfig
from models.compose import FieldConfig, RobotPlacement, make_model
from perception.geometry.se3 import transport_covariance
from perception.registration.target import TargetCad
from twin.describe import describe_rover
from twin.realism import RealismName, as_stated

INITIAL_POSES = {MASTER: (0.82, -0.35, math.pi / 2), SLAVE: (0.0, -0.92, 0.0)}
"""Nominal initial poses of the robots: x, y [m] and yaw [rad], world."""
INITIAL_PLACE_ERROR, INITIAL_YAW_ERROR = 0.06, 0.10
"""Greatest error of an initial pose, in x and y [m] and in yaw [rad]; errors are uniform."""
PANEL = PanelConfig((-0.5, -0.3), yaw=math.pi / 2, tilt=0.3)
SURVEY_PLACE, SURVEY_TURN = 1e-3, 1e-3
"""Standard deviations of the site from its drawing, along [m] and about [rad] each axis."""


@dataclasses.dataclass(frozen=True)
class MissionScene:
    """Scene as built.

    Attributes:
        field: Ground, rocks, panel and slot.
        robots: The master, and the slave with the card.
    """

    field: FieldConfig
    robots: tuple[RobotPlacement, RobotPlacement]


def draw_scene(width: float, rng: np.random.Generator) -> MissionScene:
    """Draw ground and initial poses.

    Args:
        width: Width between the slot's walls [m].
        rng: Random generator for ground and initial poses.
    """
    field = dataclasses.replace(
        FIELD,
        seed=int(rng.integers(2**31)),
        texture_pixels=2048,
        panel=PANEL,
        slot_width=width,
    )
    errors = np.array([INITIAL_PLACE_ERROR, INITIAL_PLACE_ERROR, INITIAL_YAW_ERROR])
    robots = []
    for name, nominal in INITIAL_POSES.items():
        x, y, yaw = np.array(nominal) + errors * rng.uniform(-1.0, 1.0, 3)
        robots.append(RobotPlacement(name, (x, y), yaw, card=name == SLAVE))
    return MissionScene(field, (robots[0], robots[1]))


def survey(scene: MissionScene, rng: np.random.Generator) -> SiteDrawing:
    """Return the drawing, which differs from the true scene.

    Args:
        scene: Scene as built.
        rng: Random generator for the differences.
    """
    model = make_model(dataclasses.replace(scene.field, texture_pixels=16), ())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    deviations = np.array([SURVEY_TURN] * 3 + [SURVEY_PLACE] * 3)
    true = transform_between(data, "slot", "panel")
    centred = RigidTransform.from_translation(true.translation)
    error = RigidTransform.from_exp_coords(deviations * rng.normal(size=6))
    # Errors about the slot's own place, in the panel's axes.
    drawn = centred * error * centred.inv() * true
    marker = PANEL.markers[0]
    assert scene.field.slot_width is not None
    return SiteDrawing(
        insertion_drawing(scene.field.slot_width),
        TargetCad(PANEL.marker_points, marker.radius, marker.dark),
        drawn,
        transport_covariance(centred, np.diag(deviations**2)),
        INITIAL_POSES,
        (INITIAL_PLACE_ERROR, INITIAL_YAW_ERROR),
    )


def roles(realism: RealismName = "ideal") -> MissionRoles:
    """Return the descriptions of both robots; the slave holds the card.

    Args:
        realism: Set whose stated tolerances they have.
    """
    robots = describe_rover(MASTER), describe_rover(SLAVE, card=True)
    return MissionRoles(*(as_stated(robot, realism) for robot in robots))
