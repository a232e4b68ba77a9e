"""Camera poses that a rover with a camera on its arm can take: where it drives, how it bends.

A candidate is a place for the camera, which looks straight at the target. Either the arm brings it
there from where the rover stands, or the rover drives, with its arm folded over it, over ground
that is known to be free to the nearest place from which the arm can. Ground is level; the robot
frame keeps its height.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.arm_inverse import STRAIGHT, ArmGeometry, arm_solutions
from controllers.mapping.arm_views import Collides
from controllers.mapping.looking import RobotBrief
from controllers.placement.task import PlacementError, View

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class ReachConfig:
    """How a standing place is looked for.

    Attributes:
        along: Step of the camera's distance from the arm's base in the arm's plane [m].
        turn: Step of the arm's yaw against the rover [rad].
        step: Greatest turn of a joint between two checks of a path [rad].
        carry: (joints,) of the arm while the rover drives, within its own outline [rad].
        over: Shoulder, elbow and wrist of a raised arm, by which it goes where the straight way in
            joint space is not free [rad].
        tries: Standing places, the nearest first, at which the arm's way is checked.
        clear: Radius about where the arm's base is now of what is free, seen or not [m].
    """

    along: float = 0.02
    turn: float = 0.2
    step: float = 0.1
    carry: tuple[float, float, float, float] = (0.0, 2.3, -2.5, 0.1)
    over: tuple[float, float, float] = (1.3, -0.9, -0.9)
    tries: int = 60
    clear: float = 0.55


@dataclasses.dataclass(frozen=True)
class RoverState:
    """Where a rover is.

    Attributes:
        transform_robot_to_world: Level.
        angles: (joints,) of its arm [rad].
    """

    transform_robot_to_world: RigidTransform
    angles: FloatArray


class DriveMap(Protocol):
    """Where a rover can get to from where it stands: `ground.Drives`, `footprint.PoseDrives`."""

    @property
    def farthest(self) -> float:
        """Longer ways were not looked for [m]."""
        ...

    def lengths(self, places: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Return whether poses (N, 3) x, y, heading are free, and (N,) the way there [m]."""
        ...

    def gaps(self, points: FloatArray) -> FloatArray:
        """Return (N,) how far points (N, 2) are from where the rover can be, at most less [m]."""
        ...

    def way(self, place: ArrayLike) -> FloatArray:
        """Return (n, 2) points of the way to a pose (3,), both ends included [m]."""
        ...


@dataclasses.dataclass(frozen=True)
class ReachPlan:
    """How a camera pose is taken.

    Attributes:
        transform_robot_to_world: Where the rover stands then.
        way: (n, 2) where it drives [m], world; only its present place if it stays.
        length: Of the way [m].
        fold: (m, joints) the arm's path before driving [rad]; empty if the rover stays.
        path: (k, joints) the arm's path there; its last row holds the camera in its pose.
    """

    transform_robot_to_world: RigidTransform
    way: FloatArray
    length: float
    fold: FloatArray
    path: FloatArray

    @property
    def angles(self) -> FloatArray:
        """(joints,) with which the camera is in its pose [rad]."""
        return self.path[-1]


def plan_reach(
    brief: RobotBrief,
    state: RoverState,
    drive: DriveMap | None,
    collides: Collides,
    camera: ArrayLike,
    target: ArrayLike,
    config: ReachConfig | None = None,
) -> ReachPlan:
    """Find how a rover brings its left camera to a place from which it looks at a target.

    Args:
        brief: Its arm and its body.
        state: Where it is.
        drive: Where it can drive to; None if it must stay.
        collides: Tells which points in the world are not known to be free.
        camera: (3,) [m], world.
        target: (3,) [m], world.
        config: How it is looked for.

    Returns:
        The arm alone if that will do, else the shortest drive.

    Raises:
        PlacementError: If it cannot; it names the nearest reason.
        ValueError: If a number is not finite or the arm is of another kind.
    """
    how = config or ReachConfig()
    here = state.transform_robot_to_world
    space = _Space(brief, collides, how, here.apply(_base(brief)))
    eye, seen = np.asarray(camera, dtype=float), np.asarray(target, dtype=float)
    local = here.inv().apply(np.array([eye, seen]))
    for goal in arm_solutions(brief.arm, local[0], local[1]):
        path = space.path(here, state.angles, goal)
        if path is not None:
            place = here.translation[None, :2].copy()
            return ReachPlan(here, place, 0.0, np.zeros((0, len(goal))), path)
    if drive is None:
        raise PlacementError(
            f"camera at {_text(eye)}: the arm cannot bring it there while the rover stays"
        )
    standing = _standing_places(brief, here, eye, seen, how)
    free, lengths = drive.lengths(standing.places)
    _refuse_none(eye, standing, free, lengths, drive.farthest)
    folded = np.array(how.carry)
    fold = space.path(here, state.angles, folded)
    if fold is None:
        raise PlacementError("the arm cannot be folded for driving without touching something")
    order = np.argsort(lengths, kind="stable")[: int(np.isfinite(lengths).sum())]
    for index in order[: how.tries]:
        x, y, heading = standing.places[index]
        there = _robot_at(x, y, float(here.translation[2]), heading)
        for goal in standing.angles[index]:
            if not np.isfinite(goal).all():
                continue
            path = space.path(there, folded, goal)
            if path is not None:
                way = drive.way(standing.places[index])
                length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
                return ReachPlan(there, way, length, fold, path)
    raise PlacementError(
        f"camera at {_text(eye)}: the arm would touch something at each of the "
        f"{min(how.tries, len(order))} nearest of {len(order)} standing places"
    )


@dataclasses.dataclass
class Reach:
    """Says of views, best first, whether a rover can take them: the `accept` of a search.

    Attributes:
        brief: Its arm and its body.
        state: Where it is.
        drive: Where it can drive to; None if it must stay.
        collides: Tells which points in the world are not known to be free.
        targets: Where the targets are [m], world, by name.
        config: How it is looked for.
        most: Refused views after which it is given up.
        apart: A view nearer to a refused one is refused unasked [m].
        plan: How the view last accepted is taken.
        refused: Places of refused views [m].
        reason: Why the last view was refused.
    """

    brief: RobotBrief
    state: RoverState
    drive: DriveMap | None
    collides: Collides
    targets: Mapping[str, FloatArray]
    config: ReachConfig = dataclasses.field(default_factory=ReachConfig)
    most: int = 50
    apart: float = 0.03
    plan: ReachPlan | None = None
    refused: list[FloatArray] = dataclasses.field(default_factory=list)
    reason: str = ""

    def __call__(self, view: View) -> bool:
        """Return whether the rover can take a view.

        Raises:
            PlacementError: If so many were refused that there is no use in going on.
        """
        if self.refused:
            gaps = np.linalg.norm(np.array(self.refused) - view.position, axis=1)
            if gaps.min() < self.apart:
                return False
        if len(self.refused) >= self.most:
            raise PlacementError(
                f"none of the {self.most} best views can be taken; the last: {self.reason}"
            )
        target = self.targets[view.target]
        try:
            self.plan = plan_reach(
                self.brief, self.state, self.drive, self.collides, view.position, target,
                self.config,
            )  # fmt: skip
        except PlacementError as error:
            self.reason = str(error)
            self.refused.append(view.position)
            return False
        return True

    def possible(self, points: FloatArray) -> BoolArray:
        """Return (N,) whether the camera may perhaps be brought to points (N, 3) [m].

        Where it is False no standing place that the rover can get to is near enough; elsewhere only
        asking tells. One look at the map of ways answers for all points.
        """
        here = self.state.transform_robot_to_world.translation
        base, geometry = self.brief.arm.transform_base_to_robot, ArmGeometry.of(self.brief.arm)
        foot = base.translation + base.rotation.apply(geometry.yaw_axis)
        shoulder = np.hypot(*geometry.shoulder)
        up = points[:, 2] - here[2] - foot[2]
        reach = geometry.length + float(shoulder)
        across = np.sqrt(np.maximum(reach**2 - up**2, 0.0) + geometry.beside**2)
        most = np.where(np.abs(up) <= reach, across + np.hypot(foot[0], foot[1]), -np.inf)
        gaps = np.hypot(*(points[:, :2] - here[:2]).T)
        if self.drive is not None:
            gaps = np.minimum(gaps, self.drive.gaps(points[:, :2]))
        return gaps <= most


@dataclasses.dataclass(frozen=True)
class _Standing:
    """Base poses from which the arm reaches: (M, 3) x, y, heading and (M, 2, 4) arm angles."""

    places: FloatArray
    angles: FloatArray


def _standing_places(
    brief: RobotBrief, here: RigidTransform, eye: FloatArray, seen: FloatArray, how: ReachConfig
) -> _Standing:
    """Return all base poses of the family, on ground as high as here."""
    geometry = ArmGeometry.of(brief.arm)
    base = brief.arm.transform_base_to_robot
    if base.rotation.magnitude() > STRAIGHT:
        raise ValueError("the arm's base is turned against the robot: its drives are not known")
    foot = base.translation + geometry.yaw_axis
    height = eye[2] - here.translation[2] - foot[2]
    direction = (seen - eye) / np.linalg.norm(seen - eye)
    count = int(np.ceil(geometry.length / how.along))
    along = how.along * np.arange(-count, count + 1)
    low, high = geometry.limits[0]
    yaws = np.linspace(low, high, max(2, int(np.ceil((high - low) / how.turn))))
    places, angles = [np.zeros((0, 3))], [np.zeros((0, 2, 4))]
    for plane, pitch in _planes(geometry, direction, how.turn):
        bends = geometry.bend(along, np.full(len(along), height), np.full(len(along), pitch))
        kept = np.isfinite(bends[..., 0]).any(axis=1)
        bends, far = bends[kept], along[kept]
        c, s = np.cos(plane), np.sin(plane)
        axis = eye[:2] - np.column_stack(
            [c * geometry.beside - s * far, s * geometry.beside + c * far]
        )
        turn = plane - yaws
        c, s = np.cos(turn), np.sin(turn)
        offset = np.column_stack([c * foot[0] - s * foot[1], s * foot[0] + c * foot[1]])
        xy = axis[:, None] - offset
        heading = np.broadcast_to(turn[:, None], (*xy.shape[:2], 1))
        places.append(np.concatenate([xy, heading], axis=2).reshape(-1, 3))
        wide = (*xy.shape[:2], 2)
        joints = np.concatenate(
            [
                np.broadcast_to(yaws[:, None], wide)[..., None],
                np.broadcast_to(bends[:, None], (*wide, 3)),
            ],
            axis=-1,
        )
        angles.append(joints.reshape(-1, 2, 4))
    return _Standing(np.concatenate(places), np.concatenate(angles))


def _planes(geometry: ArmGeometry, direction: FloatArray, step: float) -> list[tuple[float, float]]:
    """Return (heading, pitch) of the arm's plane in the world with which it looks that way."""
    if np.hypot(direction[0], direction[1]) > STRAIGHT:
        return geometry.headings(direction)
    if geometry.upright < 1.0 - STRAIGHT:
        return []
    pitch = float(np.copysign(np.pi / 2, direction[2]))
    return [(float(turn), pitch) for turn in np.arange(-np.pi, np.pi, step)]


def _refuse_none(
    eye: FloatArray, standing: _Standing, free: NDArray[np.bool_], lengths: FloatArray, far: float
) -> None:
    """Raise unless there is somewhere to go."""
    if len(free) == 0:
        raise PlacementError(f"camera at {_text(eye)}: beyond what the arm reaches from the ground")
    if not free.any():
        raise PlacementError(
            f"camera at {_text(eye)}: none of {len(free)} standing places is known to be free"
        )
    if not np.isfinite(lengths).any():
        raise PlacementError(
            f"camera at {_text(eye)}: no path of at most {far:g} m leads to any of "
            f"{int(free.sum())} free standing places"
        )


@dataclasses.dataclass(frozen=True)
class _Space:
    """What the arm must not touch: the world, and the rover's own body."""

    brief: RobotBrief
    collides: Collides
    how: ReachConfig
    clear_at: FloatArray

    def path(self, there: RigidTransform, start: FloatArray, goal: FloatArray) -> FloatArray | None:
        """Return (k, joints) a free way of the arm, straight or over the top; None if none is."""
        if not self._free(there, goal[None]):
            return None
        above = np.array(self.how.over)
        for corners in ([start, goal], [start, [start[0], *above], [goal[0], *above], goal]):
            path = self._through(np.array(corners))
            if self._free(there, path):
                return path
        return None

    def _through(self, corners: FloatArray) -> FloatArray:
        """Return straight lines in joint space, in steps."""
        parts = [corners[:1]]
        for a, b in zip(corners[:-1], corners[1:], strict=True):
            count = max(1, int(np.ceil(np.abs(b - a).max() / self.how.step)))
            parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
        return np.concatenate(parts)

    def _free(self, there: RigidTransform, angles: FloatArray) -> bool:
        points = self.brief.arm.cover_points(angles).reshape(-1, 3)
        if len(self.brief.body):
            # All spheres of a body have nearly one size: the largest stands for all.
            width = self.brief.arm.cover_radius + float(self.brief.body[:, 3].max())
            near, _ = cKDTree(self.brief.body[:, :3]).query(points, distance_upper_bound=width)
            if np.isfinite(near).any():
                return False
        world = there.apply(points)
        outside = np.hypot(*(world - self.clear_at)[:, :2].T) > self.how.clear
        return not bool(self.collides(world[outside]).any())


def _base(brief: RobotBrief) -> FloatArray:
    return np.asarray(brief.arm.transform_base_to_robot.translation, dtype=float)


def _robot_at(x: float, y: float, z: float, heading: float) -> RigidTransform:
    return RigidTransform.from_components([x, y, z], Rotation.from_euler("z", heading))


def _text(place: Iterable[float]) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in place) + ") m"
