"""Stage ``search``: a rover drives until it has found the panel, mapping the ground on its way.

It knows where the panel is only as well as where it began. `PanelSearch` chooses the next view, and
the path there is planned on what is mapped. The panel localizes the rover, and its frame becomes
that of the map (thesis sections 3.2.2 to 3.2.4).
"""

import math

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import CameraPose, RobotLocalization
from controllers.mapping.panel_search import (
    Cloud,
    PanelSearch,
    PanelSearchConfig,
    Viewpoint,
)
from controllers.mapping.searching import aim
from controllers.mission.behaviours import (
    DRIVING,
    Behaviour,
    DrivingPart,
    drive,
    faced,
    look_round,
    posed,
    retreat,
)
from controllers.mission.belief import MissionBelief
from controllers.mission.navigator import Navigator
from controllers.mission.radio import MissionRadio
from controllers.mission.stage import StageError
from perception.geometry.arrays import FloatArray
from twin.robot import Observation

_PLACES = 2000  # Possible places of the panel.
_SEEN_PLACES = 200  # Those of a panel that was sighted.
_VIEWPOINTS = 60  # Viewpoints that are compared for each decision.
_PATIENCE = 900.0  # Longest search [s].
_ATTITUDE = 0.012  # Standard deviation of an attitude that is known well [rad].
_PARTNER = 0.25  # Radius of the other rover, which hides what is behind it [m].
_WORTH = 2e-3  # Rate below which a rover that gives way takes no view from where it is [1/s].
_LEAST = 2e-4  # Rate of the best view below which nothing is left to be searched [1/s].
_MOST_RETREATS = 5  # Number of times that a rover backs off where nothing is left to be seen.
_NEAR = 3.0  # Distance from the panel within which both rovers do not drive at once [m].
_APART = (0.5, 0.4)
"""Distance [m] and turn [rad] after which a pair on the way is searched for a panel far away:
that takes 0.1 s."""
_MAPPED = 1.6  # Distance from the slot up to which the site is mapped from where the rover is [m].
_BEFORE, _BEARINGS = (1.0, 1.3), 24
"""Distances from the slot [m], and number of directions, of places that the site is mapped from."""
_NEARER = 0.75  # Part of the way from a panel from which a view tells more of it.
_PLANE_CELLS = 400  # Mapped cells from which on they tell the slope of the field.


class SearchPanel(DrivingPart):
    """Drives one rover until the panel has localized it.

    Until one is localized neither rover knows where the other is. So near the panel only one of
    them drives at a time: the one that has sighted it, if only one has.

    Args:
        belief: Estimates of the rover; gets its localization.
        radio: The rover's end of the radio.
        first: Whether the rover drives where both are near the panel and have or have not sighted
            it; else it gives way. The first also comes near the site, to map it.
        rng: Random generator for possible places and for viewpoints.

    Attributes:
        search: Where the panel may be; None before the search begins.
    """

    name = "search"

    def __init__(
        self, belief: MissionBelief, radio: MissionRadio, first: bool, rng: np.random.Generator
    ) -> None:
        super().__init__(belief)
        self._radio, self._first, self._rng = radio, first, rng
        self.search: PanelSearch | None = None
        self._glimpsed: RobotLocalization | None = None
        self._far_view = 0.0, 0.0

    def _run(self, seen: Observation) -> Behaviour:
        seen = yield from self._search(seen)
        if self._first:
            seen = yield from self._come_near(seen)
        self._radio.near = False
        return seen

    def _search(self, seen: Observation) -> Behaviour:
        """Take views until the panel has localized the rover."""
        navigator = self._navigator
        begun = seen.time
        seen = yield from posed(seen, navigator, DRIVING)
        search = self.search = self._possible_places()
        navigator.keep_off = lambda: search.likely_discs(self._belief.discs())
        retreats, wanted = 0, np.zeros((0, 2))
        while seen.time < begun + _PATIENCE:
            self._settle(search)
            search.stands(navigator.sight_lines())
            waits = self._gives_way()
            search.hiding = np.vstack([self._partner(), self._belief.site.slot_discs])
            places, lengths, heights = self._viewpoints(search, wanted, 0 if waits else _VIEWPOINTS)
            kept = wanted[0] if len(wanted) else None
            view = search.best(places, lengths, heights, navigator.sight_lines(), kept)
            if waits and view.rate < _WORTH:
                seen = yield from posed(seen, navigator, DRIVING)
                continue
            if view.rate < _LEAST and retreats < _MOST_RETREATS:
                retreats += 1
                navigator.hindered = True
                if len(places) == 1:
                    navigator.forget()
                seen = yield from look_round(seen, navigator)
                seen = yield from retreat(seen, navigator, held=False)
                continue
            if view.rate < _LEAST:
                raise StageError(self.name, f"the panel is in none of {search.views} views")
            if np.any(view.place != places[0]):
                driven = yield from drive(
                    seen,
                    navigator,
                    self._arm,
                    lambda place=view.place: (place, None),
                    self._glimpse,
                    once=True,
                )
                # It goes on to what it has decided on, unless something is in the way.
                goes_on = driven.stopped and not driven.reason
                seen, wanted = driven.seen, view.place[None][:goes_on]
                if self._glimpsed is None:
                    # Time passes before another decision.
                    if not (driven.arrived or driven.stopped):
                        seen = yield from posed(seen, navigator, DRIVING)
                    continue
                panel = self._glimpsed.transform_level_to_world.inv().translation
                view = None
            else:
                local = navigator.odometry.pose().apply(view.target, inverse=True)
                seen = yield from faced(seen, navigator, self._arm, local)
                panel = navigator.odometry.pose().apply(view.target, inverse=True)
            seen = yield from _at(seen, navigator, self._arm, panel)
            self._glimpsed = None
            found = navigator.take(seen, at_rest=True)
            sighted = [] if found is not None else self._sight(seen)
            if len(sighted) == 1 and _is_enough(sighted[0]):
                found = self._navigator.localized_by(seen, sighted[0])
            if found is not None:
                self._belief.localize(found)
                return seen
            if sighted:
                away = np.linalg.norm(sighted[0].transform_camera_to_world.translation)
                search.within = _NEARER * float(away)
            else:
                self._miss(seen, view)
        raise StageError(self.name, f"the panel was not found in {_PATIENCE:.0f} s")

    def _come_near(self, seen: Observation) -> Behaviour:
        """Drive to where the site can be mapped from; find the panel again if it shows itself."""
        belief, navigator = self._belief, self._navigator
        slot = np.asarray(belief.transform_ground_to_map.translation)[:2]
        if math.dist(navigator.place, slot) < _MAPPED:
            return seen
        bearings = np.linspace(-math.pi, math.pi, _BEARINGS, endpoint=False)
        around = np.column_stack([np.cos(bearings), np.sin(bearings)])
        places = np.vstack([slot + far * around for far in _BEFORE])
        lengths = navigator.lengths_to(places)
        if not np.isfinite(lengths).any():
            return seen
        nearest = places[np.argmin(lengths)]
        seen = (yield from drive(seen, navigator, self._arm, lambda: (nearest, None))).seen
        to_map = belief.map.transform_target_to_world
        assert to_map is not None
        for look in (faced, _at):
            panel = navigator.odometry.pose().apply(to_map.translation, inverse=True)
            seen = yield from look(seen, navigator, self._arm, panel)
        found = navigator.take(seen, at_rest=True)
        if found is None:
            belief.stay()
        else:
            belief.localize(found)
        return seen

    def _gives_way(self) -> bool:
        """Return whether both rovers are near the panel, and the other one drives.

        That is the one that has a path, or has sighted it; of two alike the first.
        """
        assert self.search is not None
        radio, here = self._radio, self._navigator.place
        radio.near = self.search.odds_within(here, _NEAR) > 0.5  # noqa: PLR2004
        radio.sighted = self.search.sighted
        if radio.silent or not (radio.near and radio.partner.near):
            return False
        mine = not radio.blocked, radio.sighted, self._first
        return mine < (not radio.partner.blocked, radio.partner.sighted, not self._first)

    def _partner(self) -> FloatArray:
        """Return the disc (1, 3) of the other rover in the ground frame [m]; none if unknown."""
        place = self._belief.partner_place()
        return np.zeros((0, 3)) if place is None else np.array([[*place, _PARTNER]])

    def _glimpse(self, seen: Observation, found: RobotLocalization | None) -> bool:
        """Take note of a pair that was taken on the way; return whether the drive is to end."""
        assert self.search is not None
        self._glimpsed = found
        if found is not None:
            return True
        far = self._is_far_view_due()
        sighted = far and not self.search.sighted and len(self._sight(seen)) > 0
        if not sighted:
            self._miss(seen, far=far)
        return sighted or self._gives_way()

    def _is_far_view_due(self) -> bool:
        """Return whether a pair on the way should be searched for the panel far away."""
        odometry, (distance, turned) = self._navigator.odometry, self._far_view
        far = odometry.distance - distance > _APART[0] or abs(odometry.turned - turned) > _APART[1]
        if far:
            self._far_view = odometry.distance, odometry.turned
        return far

    def _miss(
        self, seen: Observation, intended: Viewpoint | None = None, far: bool = False
    ) -> None:
        """Take note of a pair without the panel."""
        assert self.search is not None
        camera = self._navigator.odometry.camera(seen.stereo.stamp)[0]
        self.search.miss(camera, self._navigator.sight_lines(), intended, far)

    def _sight(self, seen: Observation) -> list[CameraPose]:
        """Return the poses that the camera may have in the panel's frame if a pair shows that."""
        assert self.search is not None
        navigator = self._navigator
        camera = navigator.odometry.camera(seen.stereo.stamp)[0]
        places = self.search.in_sight(np.asarray(camera.translation), navigator.sight_lines())
        local = np.asarray(camera.apply(places, inverse=True)).reshape(-1, 3)
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        sighted = self._belief.map.sights(pair, local)
        if sighted:
            counts = np.bincount(np.arange(_SEEN_PLACES) % len(sighted)).tolist()
            clouds = (
                self._seen_places(camera, pose, count)
                for pose, count in zip(sighted, counts, strict=True)
            )
            self.search.sight(*clouds)
        return sighted

    def _seen_places(self, camera: RigidTransform, sighted: CameraPose, count: int) -> Cloud:
        """Return where the panel may be by a view of it from far.

        Args:
            camera: Pose of the camera in the frame, by odometry.
            sighted: Pose of the camera in the panel's frame, by the view.
            count: Number of places.
        """
        xi = self._rng.multivariate_normal(np.zeros(6), sighted.covariance, count)
        views = RigidTransform.from_exp_coords(xi) * sighted.transform_camera_to_world
        panel_to_ground = self._belief.site.transform_panel_to_ground
        return self._cloud(camera * views.inv() * panel_to_ground.inv())

    def _possible_places(self) -> PanelSearch:
        """Return where the panel may be, by what is known of the initial pose."""
        site, odometry = self._belief.site, self._navigator.odometry
        panel = site.transform_panel_to_ground
        robots = site.draw_initial_poses(self._belief.robot.name, _PLACES, self._rng)
        began = RigidTransform.from_components(
            np.column_stack([robots[:, :2], np.full(_PLACES, self._belief.robot.centre_height)]),
            Rotation.from_euler("z", robots[:, 2:]),
        )
        self._height = float(panel.translation[2])
        return PanelSearch(self._cloud(odometry.pose() * began.inv()))

    def _cloud(self, ground_to_frame: RigidTransform) -> Cloud:
        """Return the places of the panel for possible transforms (N,) from the ground frame."""
        panel = self._belief.site.transform_panel_to_ground
        face = panel.rotation.apply([0.0, 0.0, 1.0])
        places, tips, origins, ahead = (
            np.asarray(ground_to_frame.apply(point))
            for point in (panel.translation, panel.translation + face, np.zeros(3), [1.0, 0.0, 0.0])
        )
        normals = (tips - places)[:, :2]
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        along = ahead - origins
        yaws = np.arctan2(along[:, 1], along[:, 0])
        return Cloud(places, normals, np.column_stack([origins[:, :2], yaws]))

    def _settle(self, search: PanelSearch) -> None:
        """Set the possible places on the slope that the map shows."""
        plane = self._plane()
        search.places[:, 2] = _above(plane, search.places[:, :2]) + self._height

    def _plane(self) -> FloatArray:
        """Return (3,) height and slopes along x and y of the field, as mapped or by the tilt."""
        ground = self._navigator.ground
        rows, columns = np.nonzero(ground.known)
        if len(rows) < _PLANE_CELLS:
            pose = self._navigator.odometry.pose()
            up = pose.rotation.apply([0.0, 0.0, 1.0])
            slopes = -up[:2] / up[2]
            foot = pose.apply([0.0, 0.0, -self._belief.robot.centre_height])
            return np.array([foot[2] - slopes @ foot[:2], *slopes])
        places = ground.grid.centres[rows, columns]
        heights = self._navigator.heights[rows, columns]
        basis = np.column_stack([np.ones(len(rows)), places])
        plane = np.linalg.lstsq(basis, heights, rcond=None)[0]
        low = heights - basis @ plane < 0.05  # noqa: PLR2004
        plane = np.linalg.lstsq(basis[low], heights[low], rcond=None)[0]
        return plane.astype(np.float64)

    def _viewpoints(
        self, search: PanelSearch, wanted: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places (M, 2), lengths (M,) of the paths there, and heights (M,) of the camera.

        The first one is where the rover is; those wanted before (K, 2) are among the others.
        """
        navigator = self._navigator
        drawn = np.vstack([wanted[:count], search.draw_places(count, self._rng)])
        lengths = navigator.lengths_to(drawn)
        near = np.isfinite(lengths)
        here = navigator.odometry.pose() * self._arm.tool_in_robot(DRIVING)
        places = np.vstack([here.translation[:2], drawn[near]])
        foot = navigator.odometry.level_pose().translation
        eye = float(here.translation[2] - _above(self._plane(), foot[None, :2])[0])
        return places, np.array([0.0, *lengths[near]]), _above(self._plane(), places) + eye


def _at(seen: Observation, navigator: Navigator, arm: SerialChain, point: FloatArray) -> Behaviour:
    """Look at a point (3,) in the rover's frame [m]."""
    return (yield from posed(seen, navigator, aim(arm, point, DRIVING)))


def _is_enough(camera: CameraPose) -> bool:
    """Return whether a sighting localizes the rover: from near, or where it tells the attitude."""
    near = np.linalg.norm(camera.transform_camera_to_world.translation)
    worst = math.sqrt(np.linalg.eigvalsh(camera.covariance[:3, :3]).max())
    return bool(near < PanelSearchConfig().reach[1] or worst < _ATTITUDE)


def _above(plane: FloatArray, places: FloatArray) -> FloatArray:
    """Return (N,) heights of a plane (3,) at places (N, 2) [m]."""
    return np.asarray(plane[0] + places @ plane[1:])
