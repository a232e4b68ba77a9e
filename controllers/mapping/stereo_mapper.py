"""Robots with stereo heads on their arms build one map together, view by view.

Each robot searches for the target, which localizes it (Thesis section 3.2.2). From then on its
views are fused into the common map (3.2.3), its camera's pose is corrected by fiducials of the
scene (3.2.5), and it chooses its next view (3.2.4) at the same time as the others: the cells
expected in a chosen view are claimed, so that the other robots ignore them.
"""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.arm_views import ArmViews, Collides, RatedViews, ViewError, ViewRays
from controllers.mapping.fiducial_localizer import FiducialLocalizer
from controllers.mapping.localization import RobotLocalization
from controllers.mapping.searching import TargetSearch
from controllers.mapping.shared_map import SharedMap
from controllers.mapping.stereo_view import MapperConfig, StereoView
from controllers.motion.arm_move import ArmMove
from controllers.motion.tipping.tip_guard import TipGuard
from perception.geometry.arrays import BoolArray, FloatArray, IndexArray
from perception.registration.target import possible_markers
from perception.stereo.matching import StereoMatcher
from perception.voxels.views import planning_grid
from twin.description import RobotDescription
from twin.robot import Command, Observation, WheelMode


@dataclasses.dataclass
class _Head:
    """State of one robot's stereo head.

    Attributes:
        arm: Chain of the arm, with the left camera as its tool.
        search: Search for the target.
        move: Motion of the arm to the present view.
        localization: Localization of the robot; None until it has detected the target.
        offsets: (12,) indices, in the map of fiducials, of the errors common to its views.
        taken: Number of views taken.
        pending: Indices, among all views, of those taken before the robot was localized.
        rated: Candidates of the decision for the present goal.
        claims: Unknown cells expected in the view at the present goal.
        raster: Index of the next view of the raster.
        done: Whether the robot has taken all its views, or no further one is reachable.
    """

    arm: SerialChain
    search: TargetSearch
    move: ArmMove
    localization: RobotLocalization | None = None
    offsets: IndexArray = dataclasses.field(default_factory=lambda: np.zeros(0, np.intp))
    taken: int = 0
    pending: list[int] = dataclasses.field(default_factory=list)
    rated: RatedViews | None = None
    claims: BoolArray | None = None
    raster: int = 0
    done: bool = False


class StereoMapper:
    """Moves the arms of all robots from view to view; a `twin.robot.Controller`.

    Nothing moves before the first `step`.

    Args:
        robots: Robots by name, each with a stereo head on its arm; all heads have one geometry.
        shared: Common map of the robots, empty or partial.
        config: Configuration of the motions, views and decisions.
        rng: Random generator for candidate views.
        on_view: Function called once after each view, for recording.
        localizations: Initial localization of robots that have one, by name; they need a map whose
            frame is known, and begin in the survey posture.
        guards: Guards of robots against tipping over, by name.

    Attributes:
        shared: Common map of the robots.
        localizer: Correction of camera poses by fiducials of the scene.
        views: All views so far, in their order. A view of a robot that was not localized yet is
            completed once it is.
    """

    def __init__(
        self,
        robots: Mapping[str, RobotDescription],
        shared: SharedMap,
        config: MapperConfig,
        rng: np.random.Generator,
        on_view: Callable[[StereoView], None] | None = None,
        localizations: Mapping[str, RobotLocalization] | None = None,
        guards: Mapping[str, TipGuard] | None = None,
    ) -> None:
        self.shared = shared
        self._known, self._guards = dict(localizations or {}), dict(guards or {})
        self.views: list[StereoView] = []
        self._config, self._rng, self._on_view = config, rng, on_view
        geometry = shared.geometry
        self.localizer = FiducialLocalizer(geometry, config.localizer)
        self._matcher = StereoMatcher(geometry, config.stereo)
        self._lens = ViewRays(geometry.directions(*config.rays), config.reach)
        self._robots = dict(robots)
        self._heads: dict[str, _Head] = {}
        self.reset()

    @property
    def done(self) -> bool:
        """Whether all robots have taken their views."""
        return all(head.done for head in self._heads.values())

    @property
    def localizations(self) -> Mapping[str, RobotLocalization]:
        """Localization of each robot that has one, by name."""
        heads = self._heads.items()
        return {name: head.localization for name, head in heads if head.localization is not None}

    def reset(self) -> None:
        """Clear the robots' localizations and goals, but not the map."""
        self._heads = {}
        survey, extent = self._config.views.survey, self.shared.cad.extent
        for name, robot in self._robots.items():
            assert robot.arm is not None
            arm = SerialChain.of_robot(robot)
            search = TargetSearch(arm, robot.arm.home, survey, extent, self._config.search)
            first = np.array(survey) if name in self._known else search.first()
            head = self._heads[name] = _Head(arm, search, self._move_to(name, first))
            if name in self._known:
                head.localization = self._known[name]
                head.offsets = self.localizer.fiducials.share(head.localization.shared_covariance())

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return one command for each robot.

        A decision takes tenths of a second, in which the robots stand still.
        """
        arms = {
            name: np.asarray(seen.arm_angles.value, dtype=float)
            for name, seen in observations.items()
            if seen.arm_angles.usable
        }
        return {name: self.step_robot(name, observations[name], arms) for name in self._heads}

    def step_robot(self, name: str, seen: Observation, arms: Mapping[str, FloatArray]) -> Command:
        """Return one robot's command.

        Args:
            name: Name of the robot.
            seen: Observation of the robot.
            arms: (joints,) present angles of the robots' arms by name, where known [rad].
        """
        head = self._heads[name]
        known = seen.inclinometer.usable and seen.stereo.usable
        if not head.done and known and head.move.sees(seen):
            self._take(name, head, seen, arms)
        return head.move.command(seen)

    def _move_to(self, name: str, goal: FloatArray) -> ArmMove:
        """Return a robot's motion to a view (joints,) [rad]; the wheels get no voltage."""
        c = self._config
        guard = self._guards.get(name)
        return ArmMove(goal, c.speed, c.rest, c.near, c.patience, WheelMode.DUTY, guard)

    def _take(
        self, name: str, head: _Head, seen: Observation, arms: Mapping[str, FloatArray]
    ) -> None:
        """Take a view, and choose the next one."""
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        tilt = np.asarray(seen.inclinometer.value, dtype=float)
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        view = StereoView(
            robot=name,
            number=head.taken,
            time=seen.stereo.stamp,
            angles=angles,
            tilt=tilt,
            arms=dict(arms),
            pair=pair,
            points=self._matcher.match(pair),
            rated=head.rated,
        )
        head.taken += 1
        if head.localization is None:
            c = self._config
            head.localization = self.shared.locate(
                head.arm, angles, tilt, pair, c.marker_sigma, c.localization
            )
            if head.localization is not None:
                shared = head.localization.shared_covariance()
                head.offsets = self.localizer.fiducials.share(shared)
        head.pending.append(len(self.views))
        self.views.append(view)
        if head.localization is not None:
            for index in head.pending:
                self.views[index] = self._fused(self.views[index], head.localization, head.offsets)
            head.pending.clear()
        if self._on_view is not None:
            self._on_view(self.views[-1])
        self._choose(head, view)

    def _fused(
        self, view: StereoView, localization: RobotLocalization, offsets: IndexArray
    ) -> StereoView:
        """Fuse a view into the map, and return it with its camera pose."""
        prediction = localization.camera(view.angles, view.tilt)
        prior = localization.prior(view.angles, view.tilt, offsets)
        correction = self.localizer.locate(view.pair, view.points, prior)
        self.shared.fuse(correction.camera, view.points, self._bodies(view.arms))
        return dataclasses.replace(view, prediction=prediction, correction=correction)

    def _bodies(self, arms: Mapping[str, FloatArray]) -> FloatArray:
        """Return (M, 4) spheres, centre and radius [m], world, about the localized robots."""
        spheres = [np.zeros((0, 4))]
        for name, localization in self.localizations.items():
            if name not in arms:
                continue
            points = localization.arm.cover_points(arms[name][None])[0]
            radii = np.full((len(points), 1), localization.arm.cover_radius)
            local = np.vstack([np.hstack([points, radii]), self._robots[name].body_spheres])
            local[:, :3] = localization.transform_level_to_world.apply(local[:, :3])
            spheres.append(local + [0.0, 0.0, 0.0, self._config.aura])
        return np.concatenate(spheres)

    def _choose(self, head: _Head, view: StereoView) -> None:
        """Choose the next view of a robot, and start its arm's motion there."""
        head.claims, head.rated = None, None
        spare = self._config.search_scans if head.localization is None else 0
        head.done = head.taken >= self._config.scans + spare
        if not head.done:
            try:
                head.move = self._move_to(view.robot, self._goal(head, view))
            except ViewError:
                head.done = True

    def _goal(self, head: _Head, view: StereoView) -> FloatArray:
        """Return the next view (joints,) of a robot [rad].

        Raises:
            ViewError: If no view is left.
        """
        angles = view.angles
        if head.localization is None:
            hints = possible_markers(view.pair, self.shared.geometry, self.shared.cad)
            goal = head.search.after(angles, hints, view.tilt)
            if goal is None:
                raise ViewError("the target is in none of the views")
            return goal
        level = head.localization.transform_level_to_world
        views = ArmViews(head.arm, level, self._lens, self._config.views)
        collides = self._collides(views)
        if self._config.method == "raster":
            return self._next_of_raster(head, views, angles, collides)
        if self._config.method == "random":
            return views.draw(angles, collides, 1, self._rng)[0]
        drawn = views.draw(angles, collides, self._config.views.candidates, self._rng)
        grid = planning_grid(self.shared.voxels)
        head.rated = views.rate(grid, self._claims(view.robot), angles, drawn)
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
        """Return the cells that the other robots claim; None if there are none."""
        others = [h.claims for n, h in self._heads.items() if n != name and h.claims is not None]
        return np.logical_or.reduce(others) if others else None

    def _collides(self, views: ArmViews) -> Collides:
        """Return the collision test of points for one robot's arm."""
        base = views.arm.transform_base_to_robot.translation
        to_robot = views.transform_robot_to_world.inv()
        radius, height = self._config.clear

        def collides(points: FloatArray) -> BoolArray:
            local = to_robot.apply(points) - base
            clear = (np.hypot(local[:, 0], local[:, 1]) <= radius) & (local[:, 2] >= height)
            occupied, free = self.shared.occupied_and_free(points)
            return occupied | ~(free | clear)

        return collides
