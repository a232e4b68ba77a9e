"""Robots with stereo heads on their arms build one map together, view by view.

Each robot looks around until it sees the target, and so knows where it stands (Thesis section
3.2.2). From then on what it sees goes into the common map (3.2.3), its camera's pose is corrected
by the scene itself (3.2.5), and it chooses its next view (3.2.4) while the others do the same:
cells that a chosen view is about to see are claimed, so that no other robot looks there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from controllers.mapping.arm_views import (
    ArmViews,
    Collides,
    Lens,
    RatedViews,
    ViewError,
)
from controllers.mapping.localiser import Localiser
from controllers.mapping.localization import RobotLocalization
from controllers.mapping.looking import Look, MapperConfig, RobotBrief
from controllers.mapping.searching import TargetSearch
from controllers.mapping.shared_map import SharedMap
from controllers.motion.arm_move import ArmMove
from perception.registration.target import TargetCad, possible_markers
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoMatcher
from perception.voxels.map import VoxelMap
from perception.voxels.views import planning_grid
from twin.robot import Command, Observation, WheelMode

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]


@dataclasses.dataclass(frozen=True)
class _Waiting:
    """A look that waits until its robot knows its place.

    Attributes:
        place: In the list of all looks.
        tilt: (2,) pitch and roll then [rad].
        arms: (joints,) angles of all arms then, as far as they were known [rad].
    """

    place: int
    tilt: FloatArray
    arms: dict[str, FloatArray]


@dataclasses.dataclass
class _Head:
    """One robot's state.

    Attributes:
        brief: What is known of it.
        search: For the target.
        move: Of its arm to the present view.
        standing: Where it stands; None until it has seen the target.
        offsets: (12,) numbers of what its looks err by alike, in the map of fiducials.
        looks: Looks taken.
        waiting: Looks taken before it knew where it stands.
        rated: Candidates of the decision for the present goal.
        claims: Cells that the present goal is about to see.
        raster: Next place of the raster.
        done: Whether it has taken all its looks, or found no view to go to.
    """

    brief: RobotBrief
    search: TargetSearch
    move: ArmMove
    standing: RobotLocalization | None = None
    offsets: IndexArray = dataclasses.field(default_factory=lambda: np.zeros(0, np.intp))
    looks: int = 0
    waiting: list[_Waiting] = dataclasses.field(default_factory=list)
    rated: RatedViews | None = None
    claims: BoolArray | None = None
    raster: int = 0
    done: bool = False


class StereoMapper:
    """Drives all robots' arms; a `twin.robot.Controller`.

    Attributes:
        shared: The map that they build.
        geometry: Of the stereo heads.
        localiser: The scene's fiducials.
        looks: All looks so far, in the order in which they were taken. One that was taken before
            its robot knew its place is completed when the robot does.
    """

    def __init__(
        self,
        robots: Mapping[str, RobotBrief],
        geometry: StereoGeometry,
        cad: TargetCad,
        voxels: VoxelMap,
        config: MapperConfig,
        rng: np.random.Generator,
        on_look: Callable[[Look], None] | None = None,
        begun: SharedMap | None = None,
        standings: Mapping[str, RobotLocalization] | None = None,
    ) -> None:
        """Prepare; nothing moves before the first `step`.

        Args:
            robots: By name.
            geometry: Of their stereo heads.
            cad: The target's markers.
            voxels: An empty map; the target will be at its origin.
            config: How they move, look and choose.
            rng: Draws candidates.
            on_look: Called after each look, once, for recording.
            begun: A map to go on with, in place of ``voxels``.
            standings: Where robots stand, of those that know already; needs a map with a frame.
        """
        self.shared = begun or SharedMap(voxels, geometry, cad, config.stereo.stride, config.reach)
        self._known = dict(standings or {})
        self.looks: list[Look] = []
        self._config, self._rng, self._on_look = config, rng, on_look
        self.localiser = Localiser(geometry, config.localiser)
        self.geometry = geometry
        self._matcher = StereoMatcher(geometry, config.stereo)
        self._lens = Lens(_rays(geometry, config.rays), config.reach)
        self._cad = cad
        self._briefs = dict(robots)
        self._heads: dict[str, _Head] = {}
        self.reset()

    @property
    def done(self) -> bool:
        """True when no robot will look again."""
        return all(head.done for head in self._heads.values())

    @property
    def standings(self) -> Mapping[str, RobotLocalization]:
        """Where the robots stand, of those that know."""
        heads = self._heads.items()
        return {name: head.standing for name, head in heads if head.standing is not None}

    def reset(self) -> None:
        """Forget where the robots are and what they were about to do; the map stays."""
        self._heads = {}
        for name, brief in self._briefs.items():
            search = TargetSearch(
                brief.arm,
                brief.home,
                self._config.views.survey,
                self._cad.extent,
                self._config.search,
            )
            head = self._heads[name] = _Head(brief, search, self._move_to(search.first()))
            if name in self._known:
                head.standing = self._known[name]
                head.offsets = self.localiser.fiducials.share(head.standing.shared_covariance())

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return one command for each robot.

        A decision takes tenths of a second, in which the robots stand still.
        """
        arms = _arms(observations)
        return {name: self.step_robot(name, observations[name], arms) for name in self._heads}

    def step_robot(self, name: str, seen: Observation, arms: Mapping[str, FloatArray]) -> Command:
        """Return one robot's command.

        Args:
            name: Name of the robot.
            seen: Observation of the robot.
            arms: (joints,) angles of all robots' arms now, as far as they are known [rad].
        """
        head = self._heads[name]
        known = seen.inclinometer.usable and seen.stereo.usable
        if not head.done and known and head.move.sees(seen):
            self._look(name, head, seen, arms)
        return head.move.command(seen)

    def _move_to(self, goal: FloatArray) -> ArmMove:
        """Return the way to a view (joints,) [rad]; the wheels get no voltage."""
        c = self._config
        return ArmMove(goal, c.speed, c.rest, c.near, c.patience, WheelMode.DUTY)

    def _look(
        self, name: str, head: _Head, seen: Observation, arms: Mapping[str, FloatArray]
    ) -> None:
        """Take the pair in, and choose where to look next."""
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        tilt = np.asarray(seen.inclinometer.value, dtype=float)
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        look = Look(
            name,
            head.looks,
            seen.time,
            angles,
            pair,
            self._matcher.match(pair),
            None,
            None,
            head.rated,
        )
        head.looks += 1
        if head.standing is None:
            head.standing = self.shared.locate(
                head.brief.arm,
                angles,
                tilt,
                pair,
                self._config.marker_sigma,
                self._config.standing,
            )
            if head.standing is not None:
                shared = head.standing.shared_covariance()
                head.offsets = self.localiser.fiducials.share(shared)
        head.waiting.append(_Waiting(len(self.looks), tilt, dict(arms)))
        self.looks.append(look)
        if head.standing is not None:
            for taken in head.waiting:
                self._take(taken, head.standing, head.offsets)
            head.waiting.clear()
        if self._on_look is not None:
            self._on_look(self.looks[-1])
        self._choose(name, head, look, tilt)

    def _take(self, taken: _Waiting, standing: RobotLocalization, offsets: IndexArray) -> None:
        """Fuse a look into the map."""
        look = self.looks[taken.place]
        guess = standing.camera(look.angles, taken.tilt)
        prior = standing.prior(look.angles, taken.tilt, offsets)
        correction = self.localiser.locate(look.pair, look.seen, prior)
        self.shared.fuse(correction.camera, look.seen, self._bodies(taken.arms))
        self.looks[taken.place] = dataclasses.replace(look, guess=guess, correction=correction)

    def _bodies(self, arms: Mapping[str, FloatArray]) -> FloatArray:
        """Return (M, 4) spheres about the robots that are known to stand somewhere."""
        spheres = [np.zeros((0, 4))]
        for name, standing in self.standings.items():
            if name not in arms:
                continue
            points = standing.arm.cover_points(arms[name][None])[0]
            radii = np.full((len(points), 1), standing.arm.cover_radius)
            local = np.vstack([np.hstack([points, radii]), self._briefs[name].body])
            local[:, :3] = standing.transform_level_to_world.apply(local[:, :3])
            spheres.append(local + [0.0, 0.0, 0.0, self._config.aura])
        return np.concatenate(spheres)

    def _choose(self, name: str, head: _Head, look: Look, tilt: FloatArray) -> None:
        """Choose the next view of a robot, and set its arm off."""
        head.claims, head.rated = None, None
        spare = self._config.search_scans if head.standing is None else 0
        if head.looks >= self._config.scans + spare:
            head.done = True
            return
        try:
            goal = self._goal(name, head, look, tilt)
        except ViewError:
            head.done = True
            return
        head.move = self._move_to(goal)

    def _goal(self, name: str, head: _Head, look: Look, tilt: FloatArray) -> FloatArray:
        angles = look.angles
        if head.standing is None:
            hints = possible_markers(look.pair, self.geometry, self._cad)
            goal = head.search.after(angles, hints, tilt)
            if goal is None:
                raise ViewError("the target is nowhere around")
            return goal
        views = ArmViews(
            head.brief.arm,
            head.standing.transform_level_to_world,
            self._lens,
            self._config.views,
        )
        collides = self._collides(views)
        if self._config.method == "raster":
            return self._next_of_raster(head, views, angles, collides)
        if self._config.method == "random":
            return views.draw(angles, collides, 1, self._rng)[0]
        drawn = views.draw(angles, collides, self._config.views.candidates, self._rng)
        grid = planning_grid(self.shared.voxels)
        head.rated = views.rate(grid, self._claims(name), angles, drawn)
        head.claims = views.claims(grid, None, head.rated.angles[0])
        return head.rated.angles[0]

    def _next_of_raster(
        self, head: _Head, views: ArmViews, angles: FloatArray, collides: Collides
    ) -> FloatArray:
        for view in views.raster()[head.raster :]:
            head.raster += 1
            if views.are_reachable(angles, view[None], collides)[0]:
                return view
        raise ViewError("the raster has ended")

    def _claims(self, name: str) -> BoolArray | None:
        """Return what the other robots are about to see."""
        others = [h.claims for n, h in self._heads.items() if n != name and h.claims is not None]
        return np.logical_or.reduce(others) if others else None

    def _collides(self, views: ArmViews) -> Collides:
        """Return which points may not be free for one robot's arm."""
        base = views.arm.transform_base_to_robot.translation
        to_robot = views.transform_robot_to_world.inv()
        radius, height = self._config.clear

        def collides(points: FloatArray) -> BoolArray:
            local = to_robot.apply(points) - base
            clear = (np.hypot(local[:, 0], local[:, 1]) <= radius) & (local[:, 2] >= height)
            occupied, free = self.shared.occupied_and_free(points)
            return occupied | ~(free | clear)

        return collides


def _rays(geometry: StereoGeometry, counts: tuple[int, int]) -> FloatArray:
    """Return (R, 3) unit vectors over the field of view of the left camera."""
    rays = geometry.rays(geometry.pixel_grid(*counts)).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _arms(observations: Mapping[str, Observation]) -> dict[str, FloatArray]:
    """Return (joints,) angles of the arms whose angles are known [rad]."""
    return {
        name: np.asarray(seen.arm_angles.value, dtype=float)
        for name, seen in observations.items()
        if seen.arm_angles.usable
    }
