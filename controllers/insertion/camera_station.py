"""Camera stations with card and slot in view: best views, and random ones.

A camera station is a rover's pose on the ground with joint angles of the arm, for the middle of the
approach (Thesis section 4.2.3). Poses are given in the ground frame of an `InsertionDrawing`.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.drawing import InsertionDrawing
from controllers.insertion.watching import WatchPlan, arm_spheres, slants, target_field
from controllers.kinematics.arm_inverse import parallel_views
from controllers.kinematics.serial_chain import SerialChain
from controllers.placement.mapped_ground import MappedGround
from controllers.placement.spatial.search import (
    SearchConfig,
    SpatialTask,
    best_view,
    rate_positions,
)
from controllers.placement.task import Lens, Occluder, PlacementError, View
from perception.geometry.arrays import FloatArray
from perception.stereo.geometry import StereoGeometry
from twin.description import RobotDescription, StereoHeadDescription

NEAREST, FARTHEST = 0.35, 1.2
"""Distances at which a marker can be detected [m] (READINGS has 0.35 to 1.1 m)."""
STEEPEST = math.radians(80.0)
"""Largest angle of a random view with the faces' normal."""
AIM = math.radians(5.0)
"""Standard deviation of a random camera's direction from the target's, in both angles [rad]."""
GAP = 0.20
"""Gap of the card before the mouth in the middle of the approach [m], for which a station is
chosen."""
_CLEAR = 0.55  # Distance of the camera rover's middle from the other rover's path [m].
_FIELD = 1.9  # Half of the square in which the camera rover may be [m].
_REACHES = np.arange(0.20, 0.45, 0.01)  # Distances of the camera before the robot's origin [m].
_TRIES = 2000
_MARGIN = 0.08  # Distance that arm and head keep from what is mapped [m].
_SHIFT = 0.05  # How far the head may be from its place, and card and slot are seen yet [m].


@dataclasses.dataclass(frozen=True)
class CameraStation:
    """A pose of a rover for its camera.

    Attributes:
        place: (3,) x, y [m] and yaw [rad] of the robot, ground frame.
        angles: (4,) joint angles of its arm [rad].
        distance: Distance from the camera to the target [m].
        slant: Angle of the view with the faces' normal [rad].
    """

    place: tuple[float, float, float]
    angles: FloatArray
    distance: float
    slant: float


def watch_plan(head: StereoHeadDescription, drawing: InsertionDrawing) -> WatchPlan:
    """Return the candidate camera poses for card and slot.

    Args:
        head: Description of the stereo head.
        drawing: Drawing of card and slot.
    """
    camera = head.camera
    view = 2.0 * math.atan(camera.width / 2.0 / camera.fx)
    return WatchPlan(
        Lens(view, camera.width, NEAREST, FARTHEST),
        drawing.card_holder,
        drawing.slot_holder,
        np.geomspace(NEAREST, 0.8, 14),
        np.radians(np.arange(-40.0, 41.0, 5.0)),
    )


def best_camera_station(
    robot: RobotDescription,
    drawing: InsertionDrawing,
    level: int = 4,
    ground: MappedGround | None = None,
    may_stand: Callable[[FloatArray], bool] | None = None,
) -> CameraStation:
    """Return the station with the best view of card and slot (Thesis section 4.2.3).

    The best feasible candidate is improved between its neighbours. On mapped ground arm and head
    touch nothing there, and both eyes see card and slot, even from a little aside.

    Args:
        robot: Rover with the camera.
        drawing: Drawing of card and slot.
        level: Level of the tree of directions whose candidates are searched.
        ground: Mapped ground; None without obstacles.
        may_stand: Whether the rover gets to a position (2,) [m], ground frame, and may stand there;
            None for anywhere.

    Raises:
        PlacementError: If there is no station.
    """
    arm, head = camera_arm(robot)
    parts, plan, camera = drawing.parts(GAP), watch_plan(head, drawing), head.camera
    # Near enough to see all markers in the middle of the approach and no nearer.
    half = 0.5 * np.ptp(parts.markers(), axis=0)
    least = max(
        1.15 * half[1] * 2.0 * camera.fx / camera.width + head.baseline,
        1.15 * half[2] * 2.0 * camera.fy / camera.height,
    )
    lens = dataclasses.replace(plan.lens, near=max(NEAREST, least))
    occluders: list[Occluder] = []
    if ground is not None:
        slot = drawing.transform_slot_to_ground
        occluders = ground.occluders(slot.translation, slot.rotation.apply([0.0, 0.0, 1.0]))
    field = target_field(plan, parts, others=occluders)

    def placed(view: View) -> CameraStation | None:
        return base_placement(view.position, field.target.position, arm, robot.centre_height)

    def accept(view: View) -> bool:
        station = placed(view)
        if station is None or not is_clear(station):
            return False
        eyes = np.array([view.position, right_of(view.position, station, 1.0)])
        if slants(eyes, parts.markers(), parts.normals()).max() > plan.slant:
            return False
        place = np.array(station.place[:2])
        if may_stand is not None and not may_stand(place):
            return False
        if ground is None:
            return True
        return (
            ground.is_free(place)
            and not ground.touches(held_space(robot, station), _MARGIN)
            and shows_both_eyes(view.position, station)
        )

    def right_of(left: FloatArray, station: CameraStation, share: float) -> FloatArray:
        x, y = math.cos(station.place[2]), math.sin(station.place[2])
        return left + share * head.baseline * np.array([x, y, 0.0])

    def shows_both_eyes(left: FloatArray, station: CameraStation) -> bool:
        middle = right_of(left, station, 0.5)
        (view,) = rate_positions(field, lens, middle)
        return view.free_cap * view.distance > 0.5 * head.baseline + _SHIFT

    search = SearchConfig(level=level, rings=12)
    station = placed(best_view(SpatialTask([field], lens, config=search), accept))
    assert station is not None
    return station


def held_space(robot: RobotDescription, station: CameraStation) -> FloatArray:
    """Return spheres (N, 4) of the space that arm and head hold at a station, ground frame [m].

    Args:
        robot: Rover with the camera.
        station: Its pose and that of its arm.
    """
    arm, head = camera_arm(robot)
    spheres = arm_spheres(arm, head.baseline, station.angles[None])[0]
    x, y, yaw = station.place
    to_ground = RigidTransform.from_components(
        [x, y, robot.centre_height], Rotation.from_euler("z", yaw)
    )
    return np.column_stack([to_ground.apply(spheres[:, :3]), spheres[:, 3]])


def random_camera_station(
    robot: RobotDescription, drawing: InsertionDrawing, rng: np.random.Generator
) -> CameraStation:
    """Draw a random station for a rover whose camera then stays fixed.

    Directions are uniform before the faces, distances uniform from `NEAREST` to `FARTHEST`, and
    the camera points at the target within some degrees: so the target is in the field of view (the
    thesis' "heuristics"), though it may be occluded.

    Args:
        robot: Rover with the camera.
        drawing: Drawing of card and slot.
        rng: Random generator for the station.

    Raises:
        PlacementError: If none of many draws is reachable and clear.
    """
    markers, (arm, _) = drawing.parts(GAP).markers(), camera_arm(robot)
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
        station = base_placement(camera, aim, arm, robot.centre_height)
        if station is not None and is_clear(station):
            away = camera - target
            distance = float(np.linalg.norm(away))
            return dataclasses.replace(
                station, distance=distance, slant=math.acos(float(away[0]) / distance)
            )
    raise PlacementError(f"no place for the master in {_TRIES} random ones")


def base_placement(
    camera: FloatArray, target: FloatArray, arm: SerialChain, centre_height: float
) -> CameraStation | None:
    """Return the pose of a level rover whose camera is at a position and points at a target.

    The rover faces the target with its arm straight ahead, so that it arrives by driving straight
    (Thesis section 5.2, assumption 3), and its joints are as far from their limits as possible.

    Args:
        camera: (3,) position of the left camera [m], ground frame.
        target: (3,) point on the camera's axis [m], ground frame.
        arm: Arm with the camera.
        centre_height: Height of the robot frame over level ground [m].

    Returns:
        Camera station; None if the arm cannot reach it.
    """
    view = np.asarray(target, dtype=float) - camera
    distance = float(np.linalg.norm(view))
    flat = math.hypot(view[0], view[1])
    if flat < 0.2 * distance:
        return None
    yaw = math.atan2(-view[0], view[1])
    height = camera[2] - centre_height
    beside = float(arm.tool_frame(np.zeros(4))[0, 3])
    eyes = np.full((len(_REACHES), 3), [beside, 0.0, height])
    eyes[:, 1] = _REACHES
    postures = parallel_views(arm, eyes, [0.0, flat, view[2]])
    margins = np.minimum(postures - arm.limits[:, 0], arm.limits[:, 1] - postures).min(axis=2)
    if np.isnan(margins).all():
        return None
    best = np.unravel_index(np.nanargmax(margins), margins.shape)
    reach, angles = float(_REACHES[best[0]]), postures[best]
    forward = np.array([-math.sin(yaw), math.cos(yaw)])
    right = np.array([math.cos(yaw), math.sin(yaw)])
    place = camera[:2] - reach * forward - beside * right
    slant = math.acos(min(max(-view[0] / distance, -1.0), 1.0))
    return CameraStation((float(place[0]), float(place[1]), yaw), angles, distance, slant)


def is_clear(station: CameraStation) -> bool:
    """Return whether a station is on the field and clear of the card's path."""
    x, y, _ = station.place
    nearest = min(max(y, -1.0), 0.15)  # of the other rover's path and the slot
    return math.hypot(x, y - nearest) > _CLEAR and max(abs(x), abs(y)) < _FIELD


def camera_arm(robot: RobotDescription) -> tuple[SerialChain, StereoHeadDescription]:
    """Return a rover's arm that carries its stereo head, and the head.

    Args:
        robot: Description of the rover.

    Raises:
        ValueError: If the rover has no arm or no stereo head, naming the rover.
    """
    if robot.arm is None or robot.head is None:
        raise ValueError(
            f"robot {robot.name!r} has no stereo head on an arm: it cannot look around"
        )
    return SerialChain.of_robot(robot), robot.head


def stereo_geometry(robot: RobotDescription) -> StereoGeometry:
    """Return the nominal geometry of a rover's stereo head, with the errors that it may have."""
    head = camera_arm(robot)[1]
    return StereoGeometry(*head.camera.intrinsics, head.baseline, head.calibration)
