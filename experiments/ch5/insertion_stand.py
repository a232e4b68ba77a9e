"""Where the master of ``ch5-insertion`` stands: for the best view, and for random ones."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.watching import SeenParts, WatchPlan, target_field
from controllers.kinematics.arm_inverse import arm_solutions
from controllers.kinematics.camera_arm import CameraArm
from controllers.placement.spatial.search import SearchConfig, SpatialTask, best_view
from controllers.placement.task import Lens, Occluder, PlacementError, View
from experiments.ch3.stereo.known_camera_arm import known_camera_arm
from experiments.ch5.insertion_scene import MASTER
from models.card_and_slot.build import PAINT
from models.card_and_slot.stand import CARD_AXES, SLOT_HEIGHT, TIP
from models.compose import FLAT, RobotPlacement, make_model
from models.datasheets import CAMERA, CARD_AND_SLOT, ROVER
from perception.markers.poses import BodyCad

FloatArray = NDArray[np.float64]

NEAREST, FARTHEST = 0.35, 1.2
"""Distances from which a marker can be told [m] (READINGS are of 0.35 to 1.1 m)."""
STEEPEST = math.radians(80.0)
"""Largest angle of a random view with the faces' normal."""
AIM = math.radians(5.0)
"""Deviation of where a random camera looks from the target, in both angles."""
GAP = 0.20
"""Of the card before the mouth in the middle of the approach [m]: a place is chosen for it."""
_CLEAR = 0.55  # Of the master's middle from the slave's way [m].
_FIELD = 1.9  # Half of where a master may stand [m].
_REACHES = np.arange(0.20, 0.45, 0.01)  # Of the camera before the robot's origin [m].
_TRIES = 2000


@dataclasses.dataclass(frozen=True)
class Stand:
    """A place for the master and its camera.

    Attributes:
        place: (3,) x, y [m] and yaw [rad] of its chassis.
        angles: (4,) of its arm [rad].
        distance: Of the camera from the target [m].
        slant: Angle of the view with the faces' normal [rad].
    """

    place: tuple[float, float, float]
    angles: FloatArray
    distance: float
    slant: float


@functools.cache
def reference_arm() -> CameraArm:
    """Return the arm with its camera, as drawn."""
    return known_camera_arm(make_model(FLAT, [RobotPlacement(MASTER)]), MASTER)


def card_cad() -> BodyCad:
    """Return the card's markers, card frame; across points down in the images."""
    sheet = CARD_AND_SLOT
    height = sheet.card_thickness / 2.0 + PAINT
    points = np.array([[x, y, height] for x, y in sheet.card_markers])
    return BodyCad(points, up=(-1.0, 0.0, 0.0))


def slot_cad(width: float) -> BodyCad:
    """Return the markers of a slot, slot frame.

    Args:
        width: Between its walls [m].
    """
    sheet = CARD_AND_SLOT
    outward, inward = sheet.slot_marker_inset
    side, height = width / 2.0 + outward, sheet.wall_height / 2.0 + PAINT
    points = np.array([[-side, inward, height], [side, inward, height]])
    return BodyCad(points, up=(-1.0, 0.0, 0.0))


def watch_plan() -> WatchPlan:
    """Return what the master knows of its camera and of what may hide the markers."""
    view = 2.0 * math.atan(CAMERA.width / 2.0 / CAMERA.pinhole.fx)
    lens = Lens(view, CAMERA.width, NEAREST, FARTHEST)
    # Hand and camera head of the slave, from behind the card to its wrist; the slot's post.
    carrier = _box((-0.055, 0.015), (-TIP - 0.02, -TIP + 0.12), (-0.035, 0.035))
    stand = _box((-0.10, 0.10), (0.045, 0.16), (-0.012, 0.012))
    return WatchPlan(
        lens,
        carrier,
        stand,
        np.geomspace(NEAREST, 0.8, 14),
        np.radians(np.arange(-40.0, 41.0, 5.0)),
    )


def seen_parts(width: float, gap: float = GAP) -> SeenParts:
    """Return card and slot where they are at a gap, in the frame of the level scene.

    Args:
        width: Of the slot [m].
        gap: Of the card before the mouth [m].
    """
    axes = Rotation.from_matrix(CARD_AXES)
    slot = RigidTransform.from_components([0.0, 0.0, SLOT_HEIGHT], axes)
    card = RigidTransform.from_components([0.0, -gap, SLOT_HEIGHT], axes)
    return SeenParts(card, slot, card_cad(), slot_cad(width))


@functools.cache
def best_stand(width: float, level: int = 4) -> Stand:
    """Return where the master sees card and slot best (Thesis section 4.2.3).

    Args:
        width: Of the slot [m].
        level: Of the search.

    Raises:
        PlacementError: If there is no place.
    """
    return search_stand(width, level)


def search_stand(
    width: float,
    level: int = 4,
    occluders: Sequence[Occluder] = (),
    blocked: Callable[[Stand], bool] | None = None,
) -> Stand:
    """Return where the master sees card and slot best, among what else stands there.

    Args:
        width: Of the slot [m].
        level: Of the search.
        occluders: What may hide them besides the slave and the slot's post, level scene.
        blocked: Says where a rover cannot stand.

    Raises:
        PlacementError: If there is no place.
    """
    parts, arm = seen_parts(width), reference_arm()
    plan = watch_plan()
    # Near enough to see all markers in the middle of the approach and no nearer.
    markers = parts.markers()
    half = 0.5 * np.ptp(markers, axis=0)
    least = max(
        1.15 * half[1] * 2.0 * CAMERA.pinhole.fx / CAMERA.width + CAMERA.baseline,
        1.15 * half[2] * 2.0 * CAMERA.pinhole.fy / CAMERA.height,
    )
    lens = dataclasses.replace(plan.lens, near=max(NEAREST, least))
    field = target_field(plan, parts, others=occluders)
    kept: list[Stand] = []

    def accept(view: View) -> bool:
        stand = stand_for(view.position, field.target.position, arm)
        if stand is None or not is_clear(stand) or (blocked is not None and blocked(stand)):
            return False
        kept.append(stand)
        return True

    search = SearchConfig(level=level, rings=12, refine=False)
    best_view(SpatialTask([field], lens, config=search), accept)
    return kept[-1]


def random_stand(width: float, rng: np.random.Generator) -> Stand:
    """Draw a place for the master; its camera then stays there.

    Directions are uniform before the faces, distances uniform from `NEAREST` to `FARTHEST`, and
    the camera looks at the target within some degrees: so the target could be seen (the thesis'
    "heuristics"), whatever hides it.

    Args:
        width: Of the slot [m].
        rng: Source of randomness.

    Raises:
        PlacementError: If none of many could be taken.
    """
    markers, arm = seen_parts(width).markers(), reference_arm()
    target = 0.5 * (markers.max(axis=0) + markers.min(axis=0))
    for _ in range(_TRIES):
        cosine, around = rng.uniform(math.cos(STEEPEST), 1.0), rng.uniform(-math.pi, math.pi)
        sine = math.sqrt(1.0 - cosine**2)
        direction = np.array([cosine, sine * math.cos(around), sine * math.sin(around)])
        camera = target + rng.uniform(NEAREST, FARTHEST) * direction
        aside = np.tan(rng.normal(0.0, AIM, 2)) * np.linalg.norm(camera - target)
        across = np.cross(direction, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        aim = target + aside[0] * across + aside[1] * np.cross(direction, across)
        stand = stand_for(camera, aim, arm)
        if stand is not None and is_clear(stand):
            away = camera - target
            distance = float(np.linalg.norm(away))
            return dataclasses.replace(
                stand, distance=distance, slant=math.acos(float(away[0]) / distance)
            )
    raise PlacementError(f"no place for the master in {_TRIES} random ones")


def stand_for(camera: FloatArray, target: FloatArray, arm: CameraArm) -> Stand | None:
    """Return where a level rover stands so that its camera is at a place and looks at another.

    It faces the target with its arm straight ahead, so that it came by driving straight (thesis
    section 5.2, assumption 3), and has its joints as far from their limits as can be.

    Args:
        camera: (3,) the left camera [m], level scene.
        target: (3,) on its axis [m].
        arm: With the camera.

    Returns:
        The place; None if the arm cannot.
    """
    view = np.asarray(target, dtype=float) - camera
    distance = float(np.linalg.norm(view))
    flat = math.hypot(view[0], view[1])
    if flat < 0.2 * distance:
        return None
    yaw = math.atan2(-view[0], view[1])
    height = camera[2] - ROVER.centre_height
    beside = float(arm.camera_in_robot(np.zeros(4)).translation[0])
    best: tuple[float, float, FloatArray] | None = None
    for reach in _REACHES:
        eye = np.array([beside, reach, height])
        ahead = eye + [0.0, flat, view[2]]
        for angles in arm_solutions(arm, eye, ahead):
            margin = float(np.min(np.minimum(angles - arm.limits[:, 0], arm.limits[:, 1] - angles)))
            if best is None or margin > best[0]:
                best = (margin, float(reach), angles)
    if best is None:
        return None
    _, reach, angles = best
    forward = np.array([-math.sin(yaw), math.cos(yaw)])
    right = np.array([math.cos(yaw), math.sin(yaw)])
    place = camera[:2] - reach * forward - beside * right
    slant = math.acos(min(max(-view[0] / distance, -1.0), 1.0))
    return Stand((float(place[0]), float(place[1]), yaw), angles, distance, slant)


def is_clear(stand: Stand) -> bool:
    """Say whether a master may stand there: on the field, and clear of the slave's way."""
    x, y, _ = stand.place
    nearest = min(max(y, -1.0), 0.15)  # of the slave's way and the slot
    return math.hypot(x, y - nearest) > _CLEAR and max(abs(x), abs(y)) < _FIELD


def _box(*sides: tuple[float, float]) -> FloatArray:
    """Return (8, 3) corners."""
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
