"""Where a rover is, what stands on the ground about it, and how it drives around that.

One for each rover: visual odometry from pair to pair, an elevation map in the same frame, and paths
planned on it anew as it grows. The frame is level: first the rover's own, from where it began; from
its first localization on that of the panel, which both rovers share.
"""

import dataclasses
import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm, stereo_geometry
from controllers.mapping.ground_paths import (
    GroundPathConfig,
    MappedRises,
    obstacles,
    path_lengths,
    plan_path,
    standing_places,
)
from controllers.mapping.localization import CameraPose, LocalizationConfig, RobotLocalization
from controllers.mapping.map_sharing import completed
from controllers.mapping.panel_search import Ground
from controllers.mapping.shared_map import SharedMap, within
from controllers.mapping.visual_odometry import VisualOdometry, levelled
from controllers.motion.drive_path import DrivePath, DrivePathConfig
from controllers.motion.driving import SkidSteer
from controllers.motion.tipping.tip_guard import TipGuard
from perception.elevation.alignment import aligned
from perception.elevation.grid import ElevationGrid
from perception.elevation.map import ElevationMap
from perception.elevation.submaps import Submaps, filled, rises_by_map
from perception.geometry.arrays import BoolArray, FloatArray
from perception.stereo.matching import StereoMatcher, StereoMatcherConfig, StereoPoints
from twin.description import RobotDescription
from twin.robot import Command, Observation

_SLIPPED, _SLIPS = 0.8, 3
"""Slip from which on a rover hardly moves, and successive pairs that must show it."""
_BEFORE, _ON = 2, (0.3, 0.7)
"""Pairs after which it goes straight on instead, and how far its wheels then go before it steers
again, and its path [m]: where it slips uphill, what it steers takes what holds it."""
_BUMP, _BUMPS = 0.1, 3
"""Radius of what seemed to hold the rover [m], and how many such places are rather gone around: it
may be but smooth ground uphill."""
_FINE = 0.003  # Distance up to which points of a path that was not planned are left aside [m].
_AROUND = 3.0  # Length of a path over the distance from which on it is a long way around.
_LAST = 0.15  # Length before the end of a path that is driven as it was planned [m].
_STRAIGHT = 0.24  # Radius about each point of a straight drive that holds the rover [m].
_TURNING = 0.27  # Radius about a rover that turns in place that holds it [m].
_LEFT, _MOST_SLIDE = 0.5, 0.25
"""Share of its slide that the wheels do not make up for, as they do ahead and back, and most of
that which is made room for [m]."""
_TURNS, _AWAY = 6, 0.3  # Other paths that a rover takes until it has come this far [m].
_SLIDING = 0.32  # Radius about one that slides as it turns that holds it [m].
_SLID = 0.05  # Slide of a turn in place that ends it where something is near [m].
_ASTRAY = 2  # Pairs in a row on the way that show nothing known from which on a rover is astray.
_FEW = 16  # Cells not seen below it over which it may slide.
_NO_NEARER = 0.01  # What a rover that backs off may come nearer to something [m].
_BACK = 0.25  # Distance by which a rover backs off in the open [m].
_WAYS = np.array([-0.25, 0.25, -0.5, 0.5, -0.75, 0.75, -0.125, 0.125])
"""How far a rover may back off, or go forward where there is no room for that [m]."""
_USUAL = 1.0  # Turn that follows after it has backed off [rad].
_ROOM = 0.4  # Radius about its end that is enough [m].
_LONGER = 0.1  # Room that is worth a way longer by a metre [m].
_SAME, _ELSEWHERE = 0.4, 0.5
"""Distance within which a rover backs off from the same place again [m], and room that is worth
getting away from there by a metre then [m]."""
_CLEAR = 0.4  # Radius of the ground about where it is dropped that nothing stands on [m].
_SEEN = 0.24  # Radius about each point of a path of the ground that must have been seen [m].
_LOOKED_AT = 0.2  # Radius of the ground that a look is for [m].
_CLEARED = 100  # Count of looks at ground that needs none.
_UNGUARDED = DrivePathConfig(tilts=(math.pi, 2.0 * math.pi))  # No tilt slows or stops it.
_CONTRADICTED = 0.2  # Share of a view's level cells from which on the map has drifted.
_ROVER = 0.5  # Radius of a disc that holds a rover, and where it drives in a second [m].
_MOST_LOOKS = 2  # Looks at ground after which it counts as seen, as none shows what lies behind.


@dataclasses.dataclass(frozen=True)
class NavigatorConfig:
    """How far a rover maps, and how often it looks on the way.

    Attributes:
        half_side: Half the side of the elevation map, about the frame's origin [m].
        cell: Side of its cells [m].
        reach: Nearest and farthest depth that enters it [m]; of points farther away one in a
            hundred is off by a rock's height.
        stride: Distance between matched pixels on the way [px].
        apart: Distance [m] and turn [rad] after which a new pair is taken on the way.
        longest: Time after which one is taken at the latest [s]: on a slope a rover may turn though
            its wheels hardly do.
        ahead: Length of a path that must have been seen before the rover sets off [m], and on the
            way.
        marker_sigma: (3,) standard deviations of a marker's column, row and disparity [px], as
            measured on 324 markers in 87 views of drawn fields from 1.2 to 2.8 m.
        localization: Standard deviations of localizations by the panel. On a slope of 10 degrees
            the inclinometer mistakes a share, at most 0.04, of one axis' tilt for the other's.
        climb: Deviation of the odometry's height over the distance since a localization: the head
            is pitched by some milliradians more or less than stated.
        aura: Margin about the rover's own spheres that is excluded from the map [m].
        touches: Height from which on things are kept off by turns in place and straight drives, as
            mapped: 5 mm less than as they stand [m].
        paths: Size of the rover and limits of obstacles. Where six drawn fields are known as they
            are, the best paths between 1000 pairs of places cost 2.8 times their distance in the
            median, so unknown ground does, too.
    """

    half_side: float = 12.0
    cell: float = 0.025
    reach: tuple[float, float] = (0.35, 1.6)
    stride: int = 3
    apart: tuple[float, float] = (0.2, 0.3)
    longest: float = 1.5
    ahead: tuple[float, float] = (0.6, 0.3)
    marker_sigma: tuple[float, float, float] = (0.07, 0.07, 0.045)
    localization: LocalizationConfig = LocalizationConfig(tilt_zero=0.004)
    climb: float = 0.01
    aura: float = 0.03
    touches: float = 0.02
    paths: GroundPathConfig = GroundPathConfig(
        radius=0.28,
        climb=0.016,
        most_climb=0.035,
        over_cost=8.0,
        margin=0.3,
        near_cost=5.0,
        unknown_cost=1.8,
        corner=0.4,
        least=2,
        pool=2,
    )


class Navigator:
    """Localizes one rover, maps the ground before it, and drives it.

    Args:
        robot: Description of the rover.
        panel: Map whose frame the panel defines, which recognises it in a view.
        steer: Wheels of the rover, with the turn share as known beforehand.
        config: How far it maps and how often it looks; None for the default.
        blind: Whether paths are planned as if nothing stood on the ground.
        guarded: Whether drives and moves of the arm are slowed before they would tip the rover
            over.
        once: Whether the panel localizes the rover once, and never again.

    Attributes:
        tip_guard: Guard of the rover against tipping over; None for a rover without it.
        odometry: Pose of the rover in the frame.
        ground: Elevation maps in the frame.
        localized: Whether the frame is that of the panel.
        received: Elevation map of the other rover, as far as it was received, in the same frame;
            None before. Paths are planned on it, too, where the rover has mapped nothing itself.
        hindered: Whether there was no path where it was to drive last, or but a long way around.
        partner: Returns the places (K, 2) of the other rover in the frame [m], none or one, where
            nothing is mapped.
        keep_off: Returns discs (M, 3) in the frame that paths keep off beside what is mapped: x, y
            and radius [m].
    """

    def __init__(
        self,
        robot: RobotDescription,
        panel: SharedMap,
        steer: SkidSteer,
        config: NavigatorConfig | None = None,
        blind: bool = False,
        guarded: bool = True,
        once: bool = False,
    ) -> None:
        self._robot, self._panel, self._once = robot, panel, once
        self._config, self._blind = config or NavigatorConfig(), blind
        self.tip_guard = TipGuard(robot) if guarded else None
        self._driving = DrivePathConfig() if guarded else _UNGUARDED
        self._arm, _ = camera_arm(robot)
        geometry = stereo_geometry(robot)
        self._matcher = StereoMatcher(geometry, StereoMatcherConfig(stride=self._config.stride))
        half, cell = self._config.half_side, self._config.cell
        count = round(2.0 * half / cell)
        grid = ElevationGrid((-half, -half), (count, count), cell)
        self.odometry = VisualOdometry(self._arm, geometry, steer)
        self.ground = Submaps(grid)
        self.localized = False
        self.received: ElevationMap | None = None
        self.hindered = False
        # Height of the map over that by odometry, which drifts, where the rover is [m].
        self._over = 0.0
        self.partner: Callable[[], FloatArray] = lambda: np.zeros((0, 2))
        self.keep_off: Callable[[], FloatArray] = lambda: np.zeros((0, 3))
        self._steer = steer
        self._slow = False
        self._localized = 0.0  # Distance by the wheels at which it was localized last [m].
        self._stamp, self._taken = -math.inf, (-math.inf, 0.0)
        self._drive: DrivePath | None = None
        self._looks = np.zeros(grid.shape, np.uint8)
        self._looks[np.hypot(*np.moveaxis(grid.centres, -1, 0)) < _CLEAR] = _CLEARED
        self._look_at = np.zeros(2)
        self._start = RigidTransform.identity()
        self._goal: tuple[FloatArray, float | None] | None = None
        self._slips, self._waits, self._slides = 0, False, False
        self._steers = -math.inf  # Distance by the wheels from which on it steers.
        self._anchor, self._turns = np.zeros(2), 0
        self._bumps: list[FloatArray] = []
        self._backed = np.full(2, np.inf)  # From where it backed off last.

    @property
    def place(self) -> FloatArray:
        """(2,) place of the rover in the frame [m]."""
        return np.asarray(self.odometry.level_pose().translation)[:2]

    @property
    def yaw(self) -> float:
        """Heading of the rover in the frame [rad]; 0 looks along y."""
        return float(self.odometry.level_pose().rotation.as_euler("ZXY")[0])

    @property
    def astray(self) -> bool:
        """Whether its wheels alone tell where the rover is, as it recognises nothing on the way."""
        return self.odometry.astray >= _ASTRAY

    @property
    def heights(self) -> FloatArray:
        """(rows, columns) heights of the map as seen from the estimate, which drifts [m]."""
        return self.ground.heights - self._over

    def steer(self) -> SkidSteer:
        """Return the kinematics of the wheels with the turn share and the slide seen so far."""
        seen = self.odometry
        return dataclasses.replace(
            self._steer, turn_share=seen.turn_share, turn_sigma=seen.turn_sigma, slide=seen.slide
        )

    def observe(self, seen: Observation) -> None:
        """Take one tick's sensors; to be called every tick.

        Args:
            seen: Observation of the rover.
        """
        self.odometry.update(seen)

    def sight_lines(self) -> Ground:
        """Return what is mapped of the ground, for lines of sight."""
        grid = self.ground.grid
        return Ground(self.heights, np.asarray(grid.corner), grid.cell)

    def is_due(self, seen: Observation) -> bool:
        """Return whether a rover on its way should take the pair that it has now."""
        if not (seen.stereo.usable and seen.stereo.stamp > self._stamp):
            return False
        if seen.stereo.stamp > self._stamp + self._config.longest:
            return True
        far, turn = self._config.apart
        distance, turned = self._taken
        odometry = self.odometry
        return odometry.distance - distance > far or abs(odometry.turned - turned) > turn

    def take(self, seen: Observation, at_rest: bool) -> RobotLocalization | None:
        """Move the estimate by the present pair, and map it.

        Args:
            seen: Observation of the rover, with a pair.
            at_rest: Whether the pair was taken at rest: then the panel may define the frame.

        Returns:
            Localization of the rover by the panel, if the pair shows it; once it is localized, of a
            pair at rest alone.
        """
        pair, stamp = np.asarray(seen.stereo.value, dtype=np.uint8), seen.stereo.stamp
        points = self._matcher.match(pair)
        self.odometry.see(stamp, pair[0], points)
        self._slips = self._slips + 1 if self.odometry.slip > _SLIPPED else 0
        self._stamp, self._taken = stamp, (self.odometry.distance, self.odometry.turned)
        camera, covariance = self.odometry.camera(stamp)
        if not self.astray:
            self._map(seen, points, camera, covariance)
        if self.localized and (self._once or not at_rest):
            return None
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        tilt = np.asarray(seen.inclinometer.value, dtype=float)
        sigma, config = self._config.marker_sigma, self._config.localization
        found = self._panel.locate(self._arm, angles, tilt, pair, sigma, config)
        if found is None and self.localized:
            found = self._in_shade(seen, camera)
        if not at_rest:
            self._panel.transform_target_to_world = None  # On the way the tilt is not known well.
        return found

    def _map(
        self,
        seen: Observation,
        points: StereoPoints,
        camera: RigidTransform,
        covariance: FloatArray,
    ) -> None:
        """Enter the points of a view whose camera has a pose with covariance (6, 6) in the map."""
        near, far = self._config.reach
        depth = points.points[:, 2]
        kept = (depth >= near) & (depth <= far)
        turn = camera.rotation.as_matrix()
        places = camera.apply(points.points[kept])
        outside = ~within(places, self._own_spheres(seen))
        over = np.array([0.0, 0.0, self._over])
        eye = camera.translation + over
        fitted = aligned(self.ground.newest, places[outside] + over, eye, covariance)
        if fitted.contradicted > _CONTRADICTED:
            self.ground.begin()
            fitted = aligned(self.ground.newest, places[outside] + over, eye, covariance)
        self._over += fitted.rise
        spread = (turn @ points.covariances[kept] @ turn.T)[outside]
        self.ground.newest.insert(fitted.points, spread, fitted.covariance)
        for place in self.partner():
            for each in self.ground.maps:
                each.forget(place, _ROVER)
        if self.received is not None:
            self.received.forget(self.place, _ROVER)

    def _in_shade(self, seen: Observation, camera: RigidTransform) -> RobotLocalization | None:
        """Return the localization by a panel whose markers are dim, where it is expected."""
        to_world = self._panel.transform_target_to_world
        assert to_world is not None
        place = camera.apply(to_world.translation, inverse=True)
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        sighted = self._panel.sight(pair, np.atleast_2d(place))
        return None if sighted is None else self.localized_by(seen, sighted)

    def localized_by(self, seen: Observation, sighted: CameraPose) -> RobotLocalization:
        """Return the localization of the rover by a view of the panel.

        Args:
            seen: Observation of the rover.
            sighted: Pose of the left camera in the panel's frame, by its pair.
        """
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        tilt = np.asarray(seen.inclinometer.value, dtype=float)
        config = self._config.localization
        return self._panel.localized(self._arm, angles, tilt, sighted, config)

    def localize(self, found: RobotLocalization) -> None:
        """Take over a localization by the panel; the map moves into the panel's frame.

        Args:
            found: Localization of the rover at its latest pair, at rest.
        """
        before, self._localized = self.odometry.level_pose(), self.odometry.distance
        self.odometry.localize(found, self._stamp)
        after = self.odometry.level_pose()
        if self.localized:
            self._over += float(before.translation[2] - after.translation[2])
        else:
            down = RigidTransform.from_translation([0.0, 0.0, -self._over])
            self._over = 0.0
            moved = after * before.inv()
            self.ground = self.ground.moved(levelled(moved) * down, self.odometry.covariance)
            self._looks[...] = 0
            self._bumps = [np.asarray(moved.apply([*place, 0.0]))[:2] for place in self._bumps]
        self.localized = True

    def localization(self) -> RobotLocalization:
        """Return the rover's localization by its odometry since the panel was seen."""
        odometry, count = self.odometry, len(self._arm)
        by_arm = np.zeros((6, 6 + count))
        climb = self._config.climb * (odometry.distance - self._localized)
        covariance = odometry.covariance + np.diag([0.0] * 5 + [climb**2])
        return RobotLocalization(
            self._arm, odometry.level_pose(), covariance, by_arm, self._config.localization
        )

    def lengths_to(self, places: FloatArray) -> FloatArray:
        """Return the lengths (N,) of the paths to places (N, 2) in the frame [m]; inf for none."""
        if self._blind:
            return np.linalg.norm(places - self.place, axis=1)
        paths, discs, doubted = self._config.paths, self.keep_off(), self._doubted()
        return path_lengths(self._mapped(), self.place, places, discs, paths, doubted)

    def standing_places(self, room: float | None) -> Callable[[ArrayLike], bool]:
        """Return whether the rover gets to a place (2,) in the frame [m], and has room there.

        Args:
            room: Distance from the rover within which nothing stands [m]; None where what is low
                may stand even below it.
        """
        if self._blind:
            return lambda _: True
        paths, discs, doubted = self._config.paths, self.keep_off(), self._doubted()
        return standing_places(self._mapped(), self.place, room, discs, paths, doubted)

    def high_places(self) -> FloatArray:
        """Return the places (N, 3) of mapped cells that a rover that turns may touch [m], frame."""
        paths = self._config.paths
        high = obstacles(rises_by_map(self.ground.maps), self._config.touches, paths.least)
        rows, columns = np.nonzero(high)
        centres = self.ground.grid.centres[rows, columns]
        return np.column_stack([centres, self.heights[rows, columns]])

    def columns(self, least: float) -> FloatArray:
        """Return points (N, 3) of what stands on the mapped ground, in the frame [m].

        They are one above the other, from the ground to the top of each cell, a cell's side apart.

        Args:
            least: Least height above the ground [m].
        """
        (grid, above), heights = self._mapped(), self.ground.heights
        if self.received is not None:
            heights = completed(self.ground, self.received)
        cells, step = above > least, grid.cell
        tall, tops = above[cells], heights[cells] - self._over
        counts = np.ceil(tall / step).astype(np.int64)
        which = np.repeat(np.arange(len(tops)), counts)
        below = step * (np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts))
        return np.column_stack([grid.centres[cells][which], tops[which] - below])

    def path_to(self, place: FloatArray, kept: FloatArray | None = None) -> FloatArray | None:
        """Return the path from the rover to a place.

        Args:
            place: (2,) in the frame [m].
            kept: (N, 2) path there that is kept unless another one is clearly cheaper; None for
                none.

        Returns:
            (N, 2) points in the frame [m]; None for none.
        """
        if self._blind:
            return np.array([self.place, place])
        paths, discs, doubted = self._config.paths, self.keep_off(), self._doubted()
        return plan_path(self._mapped(), self.place, place, discs, paths, kept, doubted)

    def unseen(self, path: FloatArray, far: float | None = None) -> FloatArray | None:
        """Return ground that the rover has not seen and would soon drive over.

        Args:
            path: (N, 2) path from where the rover is, frame [m].
            far: Length of the path that counts [m]; None for what is to be seen before a start.

        Returns:
            Middle (3,) of the first such ground, in the rover's frame [m]; None if there is none.
        """
        if self._blind:
            return None
        radius = self._config.paths.radius
        step = 2.0 * self.ground.grid.cell
        points = _along(path, self._config.ahead[0] if far is None else far, step)
        places = self._unshown(points)
        places = places[np.linalg.norm(places - self.place, axis=1) > radius]
        for point in points:
            over = places[np.linalg.norm(places - point, axis=1) < _SEEN]
            if len(over):
                amid = over[np.argmin(np.linalg.norm(over - over.mean(axis=0), axis=1))]
                about = np.linalg.norm(places - amid, axis=1) < _LOOKED_AT
                self._look_at = places[about].mean(axis=0)
                return self.to_look_at()
        return None

    def _unshown(self, points: FloatArray) -> FloatArray:
        """Return the middles (K, 2) of cells about points (N, 2) that no look has shown [m]."""
        grid, radius = self.ground.grid, self._config.paths.radius
        low = np.maximum(grid.cells_of([points.min(axis=0) - radius])[0], 0)
        high = grid.cells_of([points.max(axis=0) + radius])[0] + 1
        box = slice(low[0], high[0]), slice(low[1], high[1])
        shown = filled(self.ground.known[box], grown=1) | (self._looks[box] >= _MOST_LOOKS)
        return grid.centres[box][~shown]

    def _unshown_at(self, place: FloatArray) -> int:
        """Return the number of cells below a rover at a place (2,) that no look has shown."""
        if self._blind:
            return 0
        cells = self._unshown(place[None])
        return int(np.count_nonzero(np.linalg.norm(cells - place, axis=1) < _SEEN))

    def to_look_at(self) -> FloatArray:
        """Return the ground (3,) that `unseen` gave last, in the rover's frame as it is now [m]."""
        pose = self.odometry.pose()
        local = pose.apply([*self._look_at, pose.translation[2]], inverse=True)
        return np.array([*local[:2], -self._robot.centre_height])

    def looked(self) -> None:
        """Take note that a pair was taken of the ground that `unseen` gave last."""
        centres = self.ground.grid.centres
        near = np.hypot(*np.moveaxis(centres - self._look_at, -1, 0)) < _LOOKED_AT
        self._looks[near] += 1

    def is_clear(self, path: FloatArray) -> bool:
        """Return whether nothing is mapped in the way of a rover that drives straight.

        Args:
            path: (N, 2) points that it drives over, in the frame [m].
        """
        return self._gap(path) > _STRAIGHT

    def may_turn(self, angle: float) -> bool:
        """Return whether there is room to turn in place, and to slide downhill meanwhile.

        Args:
            angle: Angle to the left or to the right [rad].
        """
        return self._gap(self._slide(self.place, angle)) > _TURNING

    def _downhill(self) -> FloatArray:
        """Return the direction (2,) downhill where the rover is, as long as its slope."""
        x, y, upright = self.odometry.pose().rotation.apply([0.0, 0.0, 1.0])
        return np.array([x, y]) / upright

    def _slide(self, place: FloatArray, angle: float) -> FloatArray:
        """Return how far uphill and downhill a turn leads (2, 2), on the slope where it is."""
        rate = _LEFT * self.odometry.slide / self.odometry.turn_share
        slide = rate * abs(angle) * self._downhill()
        length = max(float(np.linalg.norm(slide)), 1e-9)
        uphill = min(1.0, self._driving.reach / length)
        return place + np.array([[-uphill], [min(1.0, _MOST_SLIDE / length)]]) * slide

    def _gap(self, path: FloatArray, kept_off: FloatArray | None = None) -> float:
        """Return the distance of a path from discs, or else from all that is kept off [m].

        Args:
            path: (N, 2) points, in the frame [m].
            kept_off: (M, 3) x, y and radius [m]; None for `_kept_off`.
        """
        discs = self._kept_off() if kept_off is None else kept_off
        points = _along(path, math.inf, self.ground.grid.cell)
        away = np.linalg.norm(points[:, None] - discs[:, :2], axis=2) - discs[:, 2]
        return float(away.min(initial=math.inf))

    def _kept_off(self) -> FloatArray:
        """Return discs (M, 3) of all that the rover keeps off, some of them mapped cells [m]."""
        if self._blind:
            return np.zeros((0, 3))
        high = self.high_places()[:, :2]
        return np.vstack([self.keep_off(), np.column_stack([high, np.zeros(len(high))])])

    def _slides_near(self, pivot: FloatArray) -> bool:
        """Return whether the rover has slid from where it began to turn (1, 2), and is not to.

        That is towards something, or over ground that it has not seen.
        """
        if math.dist(pivot[0], self.place) < _SLID:
            return False
        if self._unshown_at(self.place) > self._unshown_at(pivot[0]) + _FEW:
            return True
        return self._gap(self.place[None]) < min(_TURNING, self._gap(pivot) - _NO_NEARER)

    def set_off(self, place: FloatArray, heading: float | None) -> bool:
        """Begin a drive to a place; return whether there is a path.

        Args:
            place: (2,) where it ends, in the frame [m].
            heading: Heading at its end, in the frame [rad]; None for any.
        """
        path = self.path_to(place)
        far = _AROUND * (math.dist(self.place, place) + _LAST)
        self.hindered = path is None or _length(path) > far
        if path is None:
            return False
        self._begin(path, heading, False, self._driving)
        self._goal = place, heading
        return True

    def follow(self, path: FloatArray, heading: float | None, backwards: bool = False) -> None:
        """Begin a drive along a path that is not planned anew.

        Args:
            path: (N, 2) points, in the frame [m].
            heading: Heading at its end, in the frame [rad]; None for any.
            backwards: Whether the rover drives backwards.
        """
        self._begin(path, heading, backwards, dataclasses.replace(self._driving, slack=_FINE))

    def _begin(
        self, path: FloatArray, heading: float | None, backwards: bool, driving: DrivePathConfig
    ) -> None:
        """Begin a drive along a path (N, 2) [m] of the frame."""
        self._goal, self._slips, self._waits, self._slides = None, 0, False, False
        self._anchor, self._turns = self.place, 0
        self._start = self.odometry.level_pose()
        local = self._in_start(path)
        turn = self._turn(heading)
        self._drive = DrivePath(self.steer(), local, turn, driving, backwards, self.tip_guard)

    @property
    def arrived(self) -> bool:
        """Whether the drive has ended, or there is none."""
        return self._drive is None or self._drive.done

    @property
    def waits(self) -> bool:
        """Whether it has stopped on its way: astray, without a path, or before unseen ground."""
        return self._waits and self._drive is not None and not self._drive.moving

    @property
    def blocked(self) -> str:
        """Reason why the drive makes no progress; empty while it does."""
        if self._drive is None:
            return ""
        if self._slips >= _SLIPS:
            return "the wheels turn, but the rover does not move"
        if self._slides:
            return "it slides towards something as it turns"
        if self._turns > _TURNS:
            return "it turns from one path to another"
        return self._drive.blocked

    @property
    def held(self) -> bool:
        """Whether something before the rover holds it, so that its drive makes no progress."""
        if self._drive is None or self._drive.pivot is not None:
            return False  # Where wheels do not turn it, the ground is steep and smooth.
        return bool(self.blocked) and self._turns <= _TURNS

    def resign(self) -> None:
        """Go on from where the wheels have it, if nothing is recognised any more."""
        self.odometry.astray = 0

    def forget(self) -> None:
        """Forget the map, of a rover that it encloses: it came here, so something is not there.

        What was mapped before its estimate drifted stands as cliffs about what it maps now. For a
        rover that the panel has not localized: the map of the site is in the panel's frame.
        """
        self.ground, self._over = Submaps(self.ground.grid), 0.0
        self._looks[...] = 0

    def back_off(self, held: bool) -> None:
        """Begin to drive back, or else forward, to where there is more room.

        Args:
            held: Whether something before the rover holds it, which is rather gone around then.
        """
        pose = self.odometry.level_pose()
        again = math.dist(self._backed, self.place) < _SAME
        if held or again:  # Where it could not turn twice, it is to turn elsewhere.
            ahead = self._config.paths.radius + 0.1 if held else 0.0
            bump = np.asarray(pose.apply([0.0, ahead, 0.0]))[:2]
            self._bumps = [*self._bumps[1 - _BUMPS :], bump]
        self.halt()
        paths = [_moved(pose, np.array([0.0, way])) for way in _WAYS]
        discs = self._kept_off()
        beside, here = (
            self._gap(places, discs) for places in (paths[0][:1], self._slide(self.place, _USUAL))
        )
        gaps = np.array([self._gap(path, discs) for path in paths])
        ends = np.array([self._gap(self._slide(path[1], _USUAL), discs) for path in paths])
        free = (gaps > min(_STRAIGHT, beside - _NO_NEARER)) & ((ends > _SLIDING) | (ends > here))
        most = self._unshown_at(self.place) + _FEW
        free &= np.array([self._unshown_at(path[1]) <= most for path in paths])
        if free.any():
            self._backed = self.place
            longer = -_ELSEWHERE if again else _LONGER
            worth = np.minimum(ends, _ROOM) - longer * np.maximum(np.abs(_WAYS), _BACK)
            best = int(np.argmax(np.where(free, worth, -math.inf)))
            self.follow(paths[best], None, backwards=_WAYS[best] < 0.0)

    @property
    def course(self) -> FloatArray:
        """(N, 2) path of the drive from where the rover is, in the frame [m]; none without one."""
        if self._drive is None:
            return np.zeros((0, 2))
        return np.vstack([self.place, self._in_frame(self._drive.rest)])

    def slow(self) -> None:
        """Drive at half the speeds from the next drive on: something of the rover changed."""
        if not self._slow:
            usual = self._driving
            self._driving = dataclasses.replace(
                usual, speed=0.5 * usual.speed, turn=0.5 * usual.turn
            )
        self._slow = True

    def halt(self) -> None:
        """End the drive where the rover is."""
        self._drive = None

    def step(self, seen: Observation) -> Command:
        """Return the command of the drive; the wheels rest without one."""
        if self._drive is None:
            return Command(np.zeros(4))
        return self._drive.step(seen)

    def correct(self) -> None:
        """Correct the drive by the estimate, and plan anew around what was mapped since."""
        if self._drive is None:
            return
        here = self._start.inv() * self.odometry.level_pose()
        x, y, _ = here.translation
        self._drive.correct(float(x), float(y), float(here.rotation.as_euler("ZXY")[0]))
        if self.astray:
            self._wait()
            return
        if self._drive.pivot is not None:
            self._slides = self._slides_near(self._in_frame(self._drive.pivot[None]))
        if self._goal is None or self._drive.remaining < _LAST or self._goes_straight():
            return
        place, heading = self._goal
        kept = self.course
        # After it has gone straight on it has no path there.
        leads = len(kept) > 0 and math.dist(kept[-1], place) < _LAST
        path = self.path_to(place, kept if leads else None)
        if path is None or self.unseen(path, self._config.ahead[1]) is not None:
            self._wait()
        elif path is not kept:
            if math.dist(self.place, self._anchor) > _AWAY:
                self._anchor, self._turns = self.place, 0
            self._turns += 1
            self._drive.replan(self._in_start(path), self._turn(heading))

    def _wait(self) -> None:
        """Come to rest on the way."""
        assert self._drive is not None
        self._waits = True
        self._drive.stop()

    def _goes_straight(self) -> bool:
        """Return whether the rover goes straight on, as it slips while it follows its path."""
        assert self._drive is not None
        gone = self.odometry.distance
        if self._slips == _BEFORE and self._drive.pivot is None and gone > self._steers + _ON[1]:
            straight = _moved(self.odometry.level_pose(), np.array([0.0, _ON[1]]))
            if self.is_clear(straight):
                self._slips, self._steers = 0, gone + _ON[0]
                self._drive.replan(self._in_start(straight))
        return gone < self._steers

    def _doubted(self) -> BoolArray:
        """Return cells that looks have not shown, or where something seemed to hold the rover."""
        doubted = (self._looks >= _MOST_LOOKS) & (self._looks < _CLEARED)
        if doubted.any():
            doubted &= ~filled(self.ground.known, grown=1)
        grid, marked = self.ground.grid, doubted.view(np.uint8)
        for row, column in grid.cells_of(np.array(self._bumps).reshape(-1, 2)).tolist():
            cv2.circle(marked, (column, row), round(_BUMP / grid.cell), 1, -1)
        return doubted

    def _mapped(self) -> MappedRises:
        """Return what paths are planned on."""
        maps = self.ground.maps if self.received is None else [*self.ground.maps, self.received]
        return MappedRises(self.ground.grid, rises_by_map(maps))

    def _in_start(self, path: FloatArray) -> FloatArray:
        """Return a path (N, 2) in the frame of the rover's pose at the drive's beginning."""
        flat = np.column_stack([path, np.full(len(path), self._start.translation[2])])
        return np.asarray(self._start.inv().apply(flat))[:, :2]

    def _in_frame(self, places: FloatArray) -> FloatArray:
        """Return places (N, 2) in the frame of the rover's pose at the drive's beginning [m]."""
        flat = np.column_stack([places, np.zeros(len(places))])
        return np.asarray(self._start.apply(flat))[:, :2]

    def _turn(self, heading: float | None) -> float | None:
        """Return a heading in the frame of the rover's pose at the drive's beginning [rad]."""
        if heading is None:
            return None
        begin = float(self._start.rotation.as_euler("ZXY")[0])
        return math.remainder(heading - begin, 2.0 * math.pi)

    def _own_spheres(self, seen: Observation) -> FloatArray:
        """Return (M, 4) spheres about the rover, centre and radius [m], in the frame."""
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        points = self._arm.cover_points(angles[None])[0]
        radii = np.full((len(points), 1), self._arm.cover_radius)
        local = np.vstack([np.hstack([points, radii]), self._robot.body_spheres])
        local[:, :3] = self.odometry.pose().apply(local[:, :3])
        return local + [0.0, 0.0, 0.0, self._config.aura]


def _moved(pose: RigidTransform, along: FloatArray) -> FloatArray:
    """Return places (N, 2) at distances along a rover's heading (N,), in the frame of its pose."""
    local = np.column_stack([np.zeros_like(along), along, np.zeros_like(along)])
    return np.asarray(pose.apply(local))[:, :2]


def _length(path: FloatArray) -> float:
    """Return the length of a path (N, 2) [m]."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _along(path: FloatArray, far: float, step: float) -> FloatArray:
    """Return points (K, 2) of a path (N, 2), a step apart, up to a length of it."""
    arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.append(np.arange(0.0, min(far, arcs[-1]), step), min(far, arcs[-1]))
    return np.column_stack([np.interp(at, arcs, path[:, axis]) for axis in (0, 1)])
