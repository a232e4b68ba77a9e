"""Scene of ``mission``: two rovers dropped metres away from a slot and a panel, in a rough field.

What is drawn, and within which limits, stands in ``docs/mission.md``. Slot and panel belong to one
site whose drawing the robots have; the panel is the target of chapter 3, by which a robot is
localized.
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
from models.clutter import PanelConfig, ScreenConfig
from models.compose import FieldConfig, RobotPlacement, make_model
from models.configuration import START_RADIUS, SUN_ELEVATION
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import transport_covariance
from perception.registration.target import TargetCad
from twin.describe import describe_rover
from twin.optics.realism import RealismName
from twin.realism import as_stated

MAST = 0.065
"""Height by which both stereo heads are raised, so that the slave looks over its card [m]."""
CARD_PLACE = (0.0, -0.92, 0.0)
"""Place before the slot from which the slave inserts the card: x, y [m] and yaw [rad]."""
INITIAL_PLACE_ERROR, INITIAL_YAW_ERROR = 0.5, math.radians(30.0)
"""Greatest error of what is known of an initial pose, in x and y [m] and in yaw [rad]; uniform."""
SURVEY_PLACE, SURVEY_TURN = 1e-3, 1e-3
"""Standard deviations of the site from its drawing, along [m] and about [rad] each axis."""
WALL = (1.0, 0.12, 0.6)
PILLAR = (0.10, 0.10, 0.45)
BLOCK = (0.097, 0.097, 0.097)
"""Width, depth and height of what is put up [m]; a block's edge is a wheel's diameter."""
_FIELD = dataclasses.replace(
    FIELD,
    rock_radius=(0.02, 0.07),
    block_edge=(0.05, 0.10),
    texture_pixels=4096,
    texture_tile=2.0,
    sun_elevation=SUN_ELEVATION,
    clear=((*CARD_PLACE[:2], 0.45), (0.0, 0.1, 0.25)),
)
_CARD = (0.52, 0.12)
"""How far ahead of the slave its card is at first, and radius of a disc that holds it [m]."""
_PLINTH = ScreenConfig((0.0, 0.22), 0.0, (0.16, 0.16, 0.2))
_APART = 2.0  # Initial poses from another [m].
_MARGIN = 3.0  # Ground beyond the farthest initial pose [m].
_ROCKS, _BLOCKS = 1340 / 22.0**2, 220 / 22.0**2  # Drawn on a square metre.
_PATCHES = 0.5  # Largest friction of a patch over the least.
_STEEPEST = math.radians(10.0)
_WALL_ODDS, _WALL_FAR = 0.75, (1.0, 1.6)
_ALONG_WALL = np.linspace(-0.5, 0.5, 9)  # Points of a wall that keep off [its width].


@dataclasses.dataclass(frozen=True)
class Field:
    """How hard a field is to cross.

    Attributes:
        clutter: Rocks and blocks on a square metre over the default's.
        friction: Least friction of the ground's patches.
        distance: Distances of initial poses from the slot, least and most [m].
    """

    clutter: float = 1.0
    friction: float = 0.3
    distance: tuple[float, float] = (3.0, 8.0)

    def config(self) -> FieldConfig:
        """Return ground, rocks and blocks, before a seed and what stands there are drawn."""
        side = 2.0 * (self.distance[1] + _MARGIN)
        return dataclasses.replace(
            _FIELD,
            size=(side, side),
            rocks=round(self.clutter * _ROCKS * side**2),
            blocks=round(self.clutter * _BLOCKS * side**2),
            friction_patches=(self.friction, self.friction + _PATCHES),
        )


@dataclasses.dataclass(frozen=True)
class MissionScene:
    """Scene as built.

    Attributes:
        field: Ground, rocks, blocks, walls, panel and slot.
        robots: The master, and the slave with the card.
        known: Initial poses as the robots know them: x, y [m] and yaw [rad], by robot name.
    """

    field: FieldConfig
    robots: tuple[RobotPlacement, RobotPlacement]
    known: dict[str, tuple[float, float, float]]


def draw_scene(
    width: float, rng: np.random.Generator, hardness: Field | None = None
) -> MissionScene:
    """Draw ground, site and initial poses.

    Args:
        width: Distance between the floors of the grooves of the slot's guides [m].
        rng: Random generator for all that is drawn.
        hardness: How hard the field is to cross; None for the default.
    """
    hardness = hardness or Field()
    steep, uphill = rng.uniform(0.0, _STEEPEST), rng.uniform(-math.pi, math.pi)
    x, y = rng.uniform(-0.1, 0.1, 2)
    turn = rng.uniform(-1.0, 1.0) * math.radians(20.0)
    panel = PanelConfig((-0.5 + x, -0.3 + y), yaw=math.pi / 2 + turn, tilt=0.3, ballast=0.12)
    poses = _initial_poses(hardness.distance, rng)
    starts = list(poses.values())
    walls = [wall for pose in starts if (wall := _wall(panel, pose, starts, rng)) is not None]
    away, aside = rng.uniform(0.40, 0.50), rng.uniform(-1.0, 1.0) * math.radians(20.0)
    pillar = ScreenConfig((away * math.cos(aside), away * math.sin(aside)), aside, PILLAR)
    field = dataclasses.replace(
        hardness.config(),
        seed=int(rng.integers(2**31)),
        slope=(steep * math.cos(uphill), steep * math.sin(uphill)),
        panel=panel,
        slot_width=width,
        card_guides=True,
        clear=(*_FIELD.clear, _below_card(poses[SLAVE])),
        screens=(_PLINTH, *walls, pillar, *(_block(panel, pose, starts, rng) for pose in starts)),
    )
    errors = np.array([INITIAL_PLACE_ERROR, INITIAL_PLACE_ERROR, INITIAL_YAW_ERROR])
    known: dict[str, tuple[float, float, float]] = {}
    for name, pose in poses.items():
        x, y, yaw = (pose + errors * rng.uniform(-1.0, 1.0, 3)).tolist()
        known[name] = (x, y, yaw)
    robots = [
        RobotPlacement(
            name, (pose[0], pose[1]), pose[2], card=name == SLAVE, mast=MAST, patterned=True
        )
        for name, pose in poses.items()
    ]
    return MissionScene(field, (robots[0], robots[1]), known)


def survey(scene: MissionScene, rng: np.random.Generator) -> SiteDrawing:
    """Return the drawing, which differs from the true scene.

    Args:
        scene: Scene as built.
        rng: Random generator for the differences.
    """
    bare = dataclasses.replace(scene.field, texture_pixels=16, rocks=0, blocks=0, screens=())
    model = make_model(bare, ())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    deviations = np.array([SURVEY_TURN] * 3 + [SURVEY_PLACE] * 3)
    true = transform_between(data, "slot", "panel")
    centred = RigidTransform.from_translation(true.translation)
    error = RigidTransform.from_exp_coords(deviations * rng.normal(size=6))
    # Errors about the slot's own place, in the panel's axes.
    drawn = centred * error * centred.inv() * true
    assert scene.field.slot_width is not None and scene.field.panel is not None
    panel = scene.field.panel
    marker = panel.markers[0]
    return SiteDrawing(
        insertion_drawing(scene.field.slot_width, guides=True),
        TargetCad(panel.marker_points, marker.radius, marker.dark),
        drawn,
        transport_covariance(centred, np.diag(deviations**2)),
        scene.known,
        (INITIAL_PLACE_ERROR, INITIAL_YAW_ERROR),
        CARD_PLACE,
    )


def roles(realism: RealismName = "ideal") -> MissionRoles:
    """Return the descriptions of both robots; the slave holds the card.

    Args:
        realism: Set whose stated tolerances they have.
    """
    robots = describe_rover(MASTER, mast=MAST), describe_rover(SLAVE, card=True, mast=MAST)
    return MissionRoles(*(as_stated(robot, realism) for robot in robots))


def _initial_poses(
    distance: tuple[float, float], rng: np.random.Generator
) -> dict[str, FloatArray]:
    """Return x, y [m] and yaw [rad] of each rover, within distances [m] of the slot."""
    poses: dict[str, FloatArray] = {}
    for name in (MASTER, SLAVE):
        while name not in poses:
            far, bearing = rng.uniform(*distance), rng.uniform(-math.pi, math.pi)
            place = far * np.array([math.cos(bearing), math.sin(bearing)])
            if all(math.dist(place, other[:2]) >= _APART for other in poses.values()):
                poses[name] = np.array([*place, rng.uniform(-math.pi, math.pi)])
    return poses


def _below_card(pose: FloatArray) -> tuple[float, float, float]:
    """Return the disc below the card that the slave holds at a pose: x, y and radius [m]."""
    (x, y, yaw), (ahead, radius) = pose, _CARD
    return x - ahead * math.sin(yaw), y + ahead * math.cos(yaw), radius


def _wall(
    panel: PanelConfig, pose: FloatArray, poses: list[FloatArray], rng: np.random.Generator
) -> ScreenConfig | None:
    """Return a wall across the line of sight from a pose to the panel; None for none."""
    wanted, near = rng.uniform() < _WALL_ODDS, rng.uniform(*_WALL_FAR)
    if not wanted:
        return None
    line = pose[:2] - np.array(panel.position)
    length = float(np.linalg.norm(line))
    ahead = line / length
    across = np.array([-ahead[1], ahead[0]])
    clear = [
        (np.array(CARD_PLACE[:2]), 0.75),
        (np.zeros(2), 0.5),
        (np.array(panel.position), panel.footprint + 0.1),
        *((other[:2], 0.5) for other in poses),
    ]
    for far in (near, *np.arange(_WALL_FAR[0], length - 0.5, 0.1)):
        middle = np.array(panel.position) + far * ahead
        points = middle + WALL[0] * _ALONG_WALL[:, None] * across
        if all(np.linalg.norm(points - place, axis=1).min() > gap for place, gap in clear):
            yaw = math.atan2(across[1], across[0])
            return ScreenConfig((float(middle[0]), float(middle[1])), yaw, WALL)
    return None


def _block(
    panel: PanelConfig, pose: FloatArray, poses: list[FloatArray], rng: np.random.Generator
) -> ScreenConfig:
    """Return a block in the straight way from a pose to the slot, off all poses and the panel."""
    while True:
        x, y = ((1.0 - rng.uniform(0.3, 0.8)) * pose[:2]).tolist()
        if math.dist((x, y), CARD_PLACE[:2]) < 0.55:  # noqa: PLR2004
            continue
        block = ScreenConfig((x, y), float(rng.uniform(0.0, 1.5)), BLOCK)
        off_starts = all(block.distance(tuple(each[:2])) > START_RADIUS for each in poses)
        if off_starts and block.distance(panel.position) > panel.footprint:
            return block
