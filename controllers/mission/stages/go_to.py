"""Stages ``place`` and ``approach``: a rover drives to its place, and localizes itself there.

The master drives to the best camera station on its map (chapter 4), then the slave to where the
drawing wants it before the slot. Paths are planned on what is mapped. Where the heading matters,
the rover stops short of its place, finds the panel again, and docks (`docking`). Where the arm can
make up for the heading, the rover arrives as its path leads it. At its place it finds the panel
again; if it has missed it, it drives anew.
"""

import contextlib
import math
from collections.abc import Callable

import numpy as np

from controllers.insertion.camera_station import stereo_geometry
from controllers.mapping.searching import TargetSearch, aim
from controllers.mapping.stereo_view import MapperConfig
from controllers.mission.behaviours import (
    DRIVING,
    Behaviour,
    DrivingPart,
    Goal,
    drive,
    drive_along,
    finished,
    posed,
    retreat,
)
from controllers.mission.belief import MissionBelief
from controllers.mission.stage import StageError
from controllers.motion.arm_move import ArmMove
from controllers.motion.docking import Leg, curve_to, docking
from controllers.motion.reckoned_drive import course_along
from perception.geometry.arrays import FloatArray
from perception.registration.target import possible_markers
from twin.robot import Command, Observation

_MOST_DRIVES = 10  # Largest number of drives to the place.
_MOST_TURNS = 3  # Largest number of turns to its heading at the end of one.
_STRETCHES = (-0.5, -0.4, 0.5, 0.4)
"""Where along its heading the rover may stop short of its place [m]: behind it, or ahead of it,
from where it drives back; the first one with room is taken."""
_NEAR, _ALONG = 0.7, 0.9  # Distance [m] and heading [rad] from its place of a rover that docks.
_ANY_WAY = 0.8  # Tolerance of a heading from which on the rover arrives as its path leads it [rad].
_CLOSE = 0.3  # Distance up to which a rover has missed its place, and nothing holds it [m].
_NO_NEARER = 0.7  # Share of its distance that is left of a drive that something holds.
_INNER = 0.2  # How far within its tolerance a heading is that the rover turns to [rad].
_EVERY = 10.0  # Time from one look of a rover that waits to the next [s].
_VIEWS = 8  # Views in which the panel is searched for at the place.


class GoToPlace(DrivingPart):
    """Drives one rover to a place in the ground frame, and localizes it there by the panel.

    Args:
        name: Name of the stage.
        belief: Estimates of the rover; updated with its localization at the place.
        choose: Returns x, y [m] and yaw [rad] of the place, ground frame; called again after a
            drive that did not get there.
        near: Tolerances of the place: distance [m] and heading [rad].
        suits: Returns whether the rover can do there what it is to do, at an observation at rest;
            else another place is chosen. None if it always can.

    Attributes:
        place: (3,) place to drive to, ground frame.
        stops: Number of drives that have ended.
    """

    def __init__(
        self,
        name: str,
        belief: MissionBelief,
        choose: Callable[[], tuple[float, float, float]],
        near: tuple[float, float],
        suits: Callable[[Observation], bool] | None = None,
    ) -> None:
        super().__init__(belief)
        self.name, self.place, self.stops = name, choose(), 0
        self._suits = suits
        self._choose, self._near = choose, near
        self._reason = ""  # Why the last drive has not arrived.
        self._docks = False  # Whether it was to stop short of the place.

    def _run(self, seen: Observation) -> Behaviour:
        suited = False
        while not suited:
            if self.stops == _MOST_DRIVES:
                off, turn = self._off()
                why = f": {self._reason}" if self._reason else ""
                raise StageError(
                    self.name,
                    f"{1e3 * off:.0f} mm and {math.degrees(turn):.0f} degrees off its place after "
                    f"{_MOST_DRIVES} drives{why}",
                )
            before, _ = self._off()
            seen = yield from self._go(seen)
            self.stops += 1
            seen = yield from self._look(seen)
            after, _ = self._off()
            docks = self._near[1] < _ANY_WAY
            if not (docks or self._reason) and after > max(self._near[0], _NO_NEARER * before):
                self._reason = "it gets no nearer"
                seen = yield from retreat(seen, self._navigator, held=after > _CLOSE)
            elif not self._missed():
                suited = self._suits is None or self._suits(seen)
                self._reason = "" if suited else "it cannot see what it is to watch"
        return seen

    def _go(self, seen: Observation) -> Behaviour:
        """Drive to the place once; dock if there is room for that."""
        if self._reason:
            with contextlib.suppress(StageError):  # Else the place of before, once a way is found.
                self.place = self._choose()
            self._reason = ""
        if self._near[1] >= _ANY_WAY:
            return (yield from self._drive(seen, self._as_led))
        off, turn = self._off()
        if off > _NEAR or turn > _ALONG:
            seen = yield from self._drive(seen, self._before_place)
            if self._reason or not self._docks:
                return seen
            seen = yield from self._look(seen)
        return (yield from self._dock(seen))

    def _dock(self, seen: Observation) -> Behaviour:
        """Drive the last way to the place, as `docking` finds it; else along a planned path."""
        navigator, (place, heading) = self._navigator, self._goal()
        legs = docking([*navigator.place, navigator.yaw], [*place, heading], self._is_free)
        if not legs:
            return (yield from self._drive(seen, self._goal))
        if len(legs) > 1:
            seen = yield from drive_along(seen, navigator, self._arm, *legs[0])
            legs = [curve_to([*navigator.place, navigator.yaw], [*place, heading])]
        seen = yield from drive_along(seen, navigator, self._arm, *legs[0])
        # Wheels tell small turns badly: the head tells what is left.
        for _ in range(_MOST_TURNS):
            seen = yield from posed(seen, navigator, DRIVING)
            navigator.take(seen, at_rest=True)
            off, turn = self._off()
            if off > self._near[0] or turn < 0.5 * self._near[1]:
                break
            navigator.follow(navigator.place[None], heading)
            seen = yield from finished(seen, navigator)
        return seen

    def _is_free(self, leg: Leg) -> bool:
        """Return whether nothing stands in a part of the way, and it was seen if driven back."""
        if not self._navigator.is_clear(leg.path):
            return False
        return not leg.backwards or self._navigator.unseen(leg.path, math.inf) is None

    def _before_place(self) -> Goal:
        """Return where the rover stops short of its place; that itself where it cannot."""
        place, heading = self._goal()
        for stretch in _STRETCHES:
            begin = place + stretch * _ahead(heading)
            self._docks = self._navigator.is_clear(np.array([begin, place])) and bool(
                np.isfinite(self._navigator.lengths_to(begin[None])[0])
            )
            if self._docks:
                return begin, heading
        return place, heading

    def _as_led(self) -> Goal:
        """Return place (2,) [m], and heading [rad] unless the path ends in one that will do."""
        place, heading = self._goal()
        path = self._navigator.path_to(place)
        if path is None:
            return place, None
        away = path[-1] - path[-2]
        led = course_along(away) if np.linalg.norm(away) > self._near[0] else self._navigator.yaw
        off = math.remainder(led - heading, 2.0 * math.pi)
        most = self._near[1] - _INNER
        turned = led if abs(off) < self._near[1] else heading + math.copysign(most, off)
        place = self._arm_base(place, heading) - self._arm_base(np.zeros(2), turned)
        return place, None if turned == led else turned

    def _drive(self, seen: Observation, goal: Callable[[], Goal]) -> Behaviour:
        """Drive to a place along planned paths."""
        driven = yield from drive(seen, self._navigator, self._arm, goal)
        self._reason = driven.reason
        return driven.seen

    def _goal(self) -> tuple[FloatArray, float]:
        """Return place (2,) [m] and heading [rad] in the frame of the map."""
        to_map = self._belief.transform_ground_to_map
        x, y, yaw = self.place
        ahead = to_map.rotation.apply([-math.sin(yaw), math.cos(yaw), 0.0])
        return np.asarray(to_map.apply([x, y, 0.0]))[:2], math.atan2(-ahead[0], ahead[1])

    def _off(self) -> tuple[float, float]:
        """Return how far the rover's arm is from its place [m], and the rover from its heading."""
        (place, heading), navigator = self._goal(), self._navigator
        turn = math.remainder(heading - navigator.yaw, 2.0 * math.pi)
        there, here = (
            self._arm_base(*pose) for pose in ((place, heading), (navigator.place, navigator.yaw))
        )
        return math.dist(there, here), abs(turn)

    def _arm_base(self, place: FloatArray, heading: float) -> FloatArray:
        """Return where the base of the arm is (2,) of a rover at a place (2,) [m] and heading."""
        return place + float(self._arm.transform_base_to_robot.translation[1]) * _ahead(heading)

    def _missed(self) -> bool:
        """Return whether the rover is too far from its place."""
        off, turn = self._off()
        return off > self._near[0] or turn > self._near[1]

    def _look(self, seen: Observation) -> Behaviour:
        """Find the panel again; where it does not show itself, odometry tells the place."""
        belief, navigator, config = self._belief, self._navigator, MapperConfig()
        target, to_map = belief.site.target, belief.map.transform_target_to_world
        assert to_map is not None
        search = TargetSearch(self._arm, DRIVING, DRIVING, target.extent, config.search)
        panel = navigator.odometry.pose().apply(to_map.translation, inverse=True)
        goal: FloatArray | None = aim(self._arm, panel, DRIVING)
        for _ in range(_VIEWS):
            if goal is None:
                break
            seen = yield from posed(seen, navigator, goal)
            found = navigator.take(seen, at_rest=True)
            if found is not None:
                belief.localize(found)
                return seen
            angles = np.asarray(seen.arm_angles.value, dtype=float)
            pair = np.asarray(seen.stereo.value, dtype=np.uint8)
            hints = possible_markers(pair, stereo_geometry(belief.robot), target)
            goal = search.after(angles, hints, np.asarray(seen.inclinometer.value, dtype=float))
        belief.stay()
        return seen


def _ahead(heading: float) -> FloatArray:
    """Return the unit vector (2,) along a heading [rad]."""
    return np.array([-math.sin(heading), math.cos(heading)])


class Wait:
    """A rover's part of a stage that the other rover does: it stands, its arm folded.

    Now and then it looks whether it still stands as it did: on a slope a rover at rest creeps, and
    turns by a degree in two minutes.

    Args:
        name: Name of the stage.
        belief: Estimates of the rover; its localization follows what the looks show.

    Attributes:
        done: Always true: the other rover's part ends the stage.
    """

    done = True

    def __init__(self, name: str, belief: MissionBelief) -> None:
        self.name, self._belief = name, belief
        self._rest = ArmMove(DRIVING, guard=belief.navigator.tip_guard)
        self._due = -math.inf  # Time of the next look [s].

    def step(self, seen: Observation) -> Command:
        """Return the command of the arm."""
        self._belief.navigator.observe(seen)
        command = self._rest.command(seen)
        if self._rest.sees(seen) and seen.inclinometer.usable and seen.stereo.stamp > self._due:
            self._due = seen.stereo.stamp + _EVERY
            self._look(seen)
        return command

    def _look(self, seen: Observation) -> None:
        """Move the estimate by a pair that was taken at rest."""
        belief = self._belief
        found = belief.navigator.take(seen, at_rest=True)
        if found is not None:
            belief.localize(found)
        elif belief.localization is not None:
            belief.stay()
