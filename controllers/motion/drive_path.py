"""Drive a rover along a path: regulated pure pursuit, with turns in place at sharp corners.

Pure pursuit (Coulter, 1992, "Implementation of the pure pursuit path tracking algorithm") drives on
the circle to a point of the path a look-ahead distance away. Regulated (Macenski et al., 2023,
"Regulated pure pursuit for robot path tracking"), the look-ahead grows with the speed, and the
speed falls with the curvature and towards the end.

The measured tilt bounds the speed; where it does, a guard may look ahead, and stop a drive that is
likely to tip the rover over (`tipping.tip_guard`).
"""

import dataclasses
import enum
import math

import numpy as np
from numpy.typing import ArrayLike

from controllers.motion.driving import SkidSteer, is_good
from controllers.motion.reckoned_drive import ReckonedDrive, course_along, turning_rate, wrapped
from controllers.motion.tipping.tip_guard import TipGuard
from perception.geometry.arrays import FloatArray
from twin.robot import Observation

_JOINS = 0.1  # Distance from the path within which the rover is on it [m].
_BACK, _ON = 0.3, 0.5  # Parts of the path behind and ahead where the rover may be [m].
_FULL = 0.9  # Share of the wheels' largest speed that is used; the rest is left to their servo.
_BRAKES = 0.8  # Share of the acceleration with which the rover is to slow down.
_STALLED = 0.3  # Share of the commanded wheel speeds below which the wheels stall.
_BLEND = 0.1  # Squared sine of the angle left from which on what is off aside counts less.
_LOOK_EVERY = 0.5  # Time from one look ahead to the next [s].
_COMMANDED = 0.2  # Wheel speed below which nothing is said of a stall [rad/s].


@dataclasses.dataclass(frozen=True)
class DrivePathConfig:
    """Limits and tolerances of a drive along a path.

    Attributes:
        speed: Largest speed [m/s].
        turn: Largest turning rate [rad/s].
        scrub: Largest turning rate that rolling wheels would have [rad/s]: where a slope lets them
            turn the rover hardly, faster wheels do so no more, but let it slide.
        acceleration: Largest change of the speed [m/s^2]. It tilts what an inclinometer measures by
            its share of gravity: 1.2 degrees.
        hold: Largest speed at which a rover that turns in place rolls back to where it began to
            turn [m/s]: on a slope it slides while it turns, as its wheels then slip.
        reach: Farthest that it rolls beyond that beforehand, for what it will yet slide [m].
        turn_acceleration: Largest change of the turning rate [rad/s^2].
        slowing: Speed over the distance to the end, and rate of a turn in place over the remaining
            angle [1/s]; wheels that lag behind their command overshoot without it.
        near: Remaining distance [m] and angle [rad] at which the rover has arrived.
        lookahead: Least and largest look-ahead distance [m].
        ahead: Look-ahead distance over the speed [s].
        corner: Direction of the path from the heading beyond which the rover turns in place [rad].
        slack: Distance up to which points of the path are left aside [m]: half a cell of a grid,
            whose paths wind by that.
        tilts: Tilt from which on the speed falls, and tilt beyond which the rover stops [rad].
        creep: Share of the speed that is left at the second of them.
        patience: Longest time for which the wheels may stall, or not be measured [s].
        period: Servo tick [s].
    """

    speed: float = 0.2
    turn: float = 0.3
    scrub: float = 0.9
    acceleration: float = 0.2
    hold: float = 0.08
    reach: float = 0.05
    turn_acceleration: float = 0.8
    slowing: float = 2.0
    near: tuple[float, float] = (0.005, 0.01)
    lookahead: tuple[float, float] = (0.12, 0.25)
    ahead: float = 1.25
    corner: float = math.radians(50.0)
    slack: float = 0.025
    tilts: tuple[float, float] = (math.radians(15.0), math.radians(30.0))
    creep: float = 0.25
    patience: float = 2.0
    period: float = 0.01


class _Phase(enum.Enum):
    FACE = "face"
    FOLLOW = "follow"
    ALIGN = "align"
    ARRIVED = "arrived"


class DrivePath(ReckonedDrive):
    """Drives one rover along a path, with its arm held where it was.

    Args:
        steer: Wheels of the rover.
        path: (N, 2) points x (to the right), y (ahead) [m], from where the rover is now. The rover
            joins the path where that first passes within 10 cm, or else drives straight to its
            first point.
        heading: Yaw to the left in which the rover ends [rad]; None for that of the path's end.
        config: Limits and tolerances; None for the default.
        backwards: Whether the rover drives backwards.
        guard: Guard of the rover against tipping over; None for a drive without one.

    Attributes:
        odometry: Dead reckoning since the drive began, without corrections.
        blocked: Why the rover has stopped before its end; empty if it has not.

    Raises:
        ValueError: If path or heading are not finite, or the path has no points.
    """

    def __init__(
        self,
        steer: SkidSteer,
        path: ArrayLike,
        heading: float | None = None,
        config: DrivePathConfig | None = None,
        backwards: bool = False,
        guard: TipGuard | None = None,
    ) -> None:
        self._config, self._guard = config or DrivePathConfig(), guard
        super().__init__(steer, self._config.period)
        self._correction = 0.0, 0.0, 0.0  # Pose of the frame of odometry in that of the path.
        self._speed = self._turn = 0.0  # Last commanded.
        self._until_look = 0
        self.replan(path, heading, backwards)

    def replan(
        self, path: ArrayLike, heading: float | None = None, backwards: bool = False
    ) -> None:
        """Follow another path from now on, without stopping unless it needs a turn in place.

        Args:
            path: (N, 2) points [m], in the frame of the first path.
            heading: Yaw in which the rover ends [rad], likewise; None for that of the path's end.
            backwards: Whether the rover drives backwards.

        Raises:
            ValueError: If path or heading are not finite, or the path has no points.
        """
        points = np.asarray(path, dtype=float)
        if points.ndim != 2 or points.shape[1:] != (2,) or not len(points):  # noqa: PLR2004
            raise ValueError(f"path of shape {points.shape}: expected (N, 2) with N > 0")
        if not np.isfinite(points).all() or not (heading is None or math.isfinite(heading)):
            raise ValueError(f"path {points.tolist()}, heading {heading}: expected finite numbers")
        self._heading, self._sign = heading, -1.0 if backwards else 1.0
        route = _simplified(_joined(points, self.place), self._config.slack)
        self._legs = _split(route, self._config.corner)
        self._stopped = False
        # From where the tilt is too large already the rover may creep away.
        self._steep, self._trouble, self.blocked = True, 0.0, ""
        self._begin(_Phase.FOLLOW)

    def correct(self, x: float, y: float, yaw: float) -> None:
        """Take over a measured pose of the rover; the path is followed from there.

        Args:
            x: Place to the right, where the rover is now, in the frame of the first path [m].
            y: Place ahead, likewise [m].
            yaw: Heading to the left, likewise [rad].

        Raises:
            ValueError: If a number is not finite.
        """
        if not all(math.isfinite(number) for number in (x, y, yaw)):
            raise ValueError(f"pose {(x, y, yaw)}: expected finite numbers")
        turn = yaw - self.odometry.yaw
        moved = _turned(self.odometry.place, turn)
        self._correction = x - float(moved[0]), y - float(moved[1]), turn

    def stop(self) -> None:
        """Come to rest, and stay there until another path is given."""
        self._stopped = True

    @property
    def place(self) -> FloatArray:
        """(2,) x, y of the rover in the frame of the first path, corrected [m]."""
        x, y, turn = self._correction
        return np.array([x, y]) + _turned(self.odometry.place, turn)

    @property
    def yaw(self) -> float:
        """Heading to the left in the frame of the first path, corrected [rad]."""
        return self._correction[2] + self.odometry.yaw

    @property
    def done(self) -> bool:
        """Whether the rover has arrived at the end of its path, and rests."""
        return self._phase is _Phase.ARRIVED and not self.moving

    @property
    def moving(self) -> bool:
        """Whether the wheels are commanded to turn."""
        return self._speed != 0.0 or self._turn != 0.0

    @property
    def pivot(self) -> FloatArray | None:
        """(2,) where a turn in place began, in the frame of the first path [m]; None if none."""
        return self._pivot if self._phase in (_Phase.FACE, _Phase.ALIGN) else None

    @property
    def distance(self) -> float:
        """Distance driven, forward and back [m]."""
        return self.odometry.distance

    @property
    def remaining(self) -> float:
        """Length of the path that is left [m]."""
        rest = sum(_length(leg) for leg in self._legs)
        if self._phase in (_Phase.FACE, _Phase.FOLLOW):
            rest += max(float(self._arcs[-1]) - self._gone, 0.0)
        return rest

    @property
    def rest(self) -> FloatArray:
        """(N, 2) vertices of the path that are left, in the frame of the first path [m]."""
        legs = [leg[1:] for leg in self._legs]
        if self._phase in (_Phase.FACE, _Phase.FOLLOW):
            legs.insert(0, self._leg[self._arcs > self._gone])
        return np.vstack([np.zeros((0, 2)), *legs])

    def _begin(self, phase: _Phase) -> None:
        """Begin the next part of the path in a phase, or turn to the final heading."""
        self._phase = phase if self._legs else _Phase.ALIGN
        self._pivot = self.place
        if not self._legs:
            return
        self._leg = self._legs.pop(0)
        steps = np.diff(self._leg, axis=0)
        self._lengths = np.linalg.norm(steps, axis=1)
        self._along = steps / self._lengths[:, None]
        self._arcs = np.concatenate([[0.0], np.cumsum(self._lengths)])
        self._gone = 0.0
        # Half way round a corner the pursued point lies off the course by half the turn.
        turns = _corners(self._leg)
        curves = 2.0 * np.sin(0.5 * turns) / self._config.lookahead[0]
        speeds = self._config.turn / np.maximum(curves, 1e-9)
        # Speed at each point ahead, and the place where it must be reached.
        self._slow = np.append(speeds, 0.0)
        self._slow_at = self._arcs[1:].copy()
        self._slow_at[:-1] -= self._config.lookahead[0]

    def _motion(self, seen: Observation) -> tuple[float, float]:
        """Return speed [m/s] and turning rate [rad/s], within the accelerations."""
        config, steer, tick = self._config, self._steer, self._config.period
        self._watch(seen)
        # Without tachometers nothing moves.
        held = self._stopped or self.blocked or not is_good(seen.wheel_speeds)
        speed, turn = (0.0, 0.0) if held else self._wanted()
        self._speed = _towards(self._speed, speed, config.acceleration * tick)
        # What the wheels have left beside the speed; else the speed would be reduced with the turn.
        left = max(steer.most * steer.wheel_radius - abs(self._speed), 0.0)
        most = min(config.turn, steer.turn_share * min(config.scrub, left / steer.half_track))
        self._turn = _towards(
            self._turn, min(max(turn, -most), most), config.turn_acceleration * tick
        )
        return self._speed, self._turn

    def _watch(self, seen: Observation) -> None:
        """Note whether the wheels turn, and whether the tilt is within its limit."""
        config, why = self._config, ""
        if not is_good(seen.wheel_speeds):
            why = "wheel speeds are not measured"
        else:
            asked = self._wheels(self._speed, self._turn)
            measured = np.asarray(seen.wheel_speeds.value, dtype=float)
            if np.abs(asked).max() > _COMMANDED and measured @ asked < _STALLED * (asked @ asked):
                why = "wheels stall"
        self._trouble = self._trouble + config.period if why else 0.0
        if self._trouble > config.patience and not self.blocked:
            self.blocked = f"{why} for {config.patience:g} s"
        steep = self._tilt() > config.tilts[1]
        if steep and not self._steep and not self.blocked:
            self.blocked = f"tilted beyond {math.degrees(config.tilts[1]):.0f} degrees"
        self._steep = steep
        if not self.blocked and self._is_due(seen):
            self._until_look = round(_LOOK_EVERY / config.period)
            assert self._guard is not None
            self.blocked = self._guard.warning(seen, self._wheels(self._speed, self._turn))

    def _is_due(self, seen: Observation) -> bool:
        """Return whether to look ahead: every now and then on the way, where the tilt is large."""
        self._until_look = max(self._until_look - 1, 0)
        if self._guard is None or self._until_look or not self.moving:
            return False
        usable = seen.arm_angles.usable and seen.inclinometer.usable
        return usable and self._tilt() >= self._config.tilts[0]

    def _tilt(self) -> float:
        """Return the angle between the rover's up and the vertical [rad]."""
        pitch, roll = self.odometry.tilt
        return math.acos(math.cos(pitch) * math.cos(roll))

    def _share(self) -> float:
        """Return the share of the speeds that the tilt leaves."""
        (least, most), creep = self._config.tilts, self._config.creep
        return min(max(1.0 - (1.0 - creep) * (self._tilt() - least) / (most - least), creep), 1.0)

    def _wanted(self) -> tuple[float, float]:
        """Return speed and turning rate to strive for; a phase that has ended gives the next."""
        config, share = self._config, self._share()
        course = self.yaw if self._sign > 0.0 else self.yaw + math.pi
        if self._phase in (_Phase.FACE, _Phase.FOLLOW):
            self._follow()  # On a slope it gets on as it turns, too.
        if self._phase in (_Phase.FACE, _Phase.FOLLOW):
            away = self._pursued() - self.place
            left = wrapped(course_along(away) - course)
            if self._phase is _Phase.FACE and abs(left) <= config.near[1]:
                self._phase = _Phase.FOLLOW
            elif abs(left) > config.corner and self._phase is not _Phase.FACE:
                self._phase, self._pivot = _Phase.FACE, self.place
            if self._phase is _Phase.FACE:
                return self._roll_back(left), turning_rate(
                    left, config.slowing, share * config.turn
                )
            far = max(float(np.linalg.norm(away)), 0.5 * config.lookahead[0])
            curvature = 2.0 * math.sin(left) / far
            speed = self._allowed(share, abs(curvature))
            return self._sign * speed, curvature * speed
        if self._phase is _Phase.ALIGN:
            left = 0.0 if self._heading is None else wrapped(self._heading - self.yaw)
            if abs(left) > config.near[1]:
                return self._roll_back(left), turning_rate(
                    left, config.slowing, share * config.turn
                )
            self._phase = _Phase.ARRIVED
        return 0.0, 0.0

    def _roll_back(self, left: float) -> float:
        """Return the speed that lets a turn end where it began, with what it will yet slide.

        What the rover is off along its heading at the end is made up for then: what is left of it
        is to be made up for along the present heading.

        Args:
            left: Angle that is left of the turn [rad].
        """
        tilt = self.odometry.tilt
        aside, ahead = _turned(self._pivot - self.place, -self.yaw) - self._steer.sliding(
            left, tilt
        )
        s, c = math.sin(left), math.cos(left)
        speed = self._config.slowing * float(ahead + aside * c * s / (s * s + _BLEND))
        # No farther from there than it has room for.
        _, gone = _turned(self.place - self._pivot, -self.yaw)
        if gone * speed > 0.0 and abs(gone) > self._config.reach:
            speed = 0.0
        most, slides = self._config.hold, float(self._steer.sliding(self._turn, tilt)[1])
        return min(max(speed - slides, -most), most) + slides

    def _follow(self) -> None:
        """Find the place along the path; at the end of a part begin the next."""
        ahead = np.sum((self.place - self._leg[:-1]) * self._along, axis=1)
        # Beyond the last point the path goes straight on.
        ends = np.append(self._lengths[:-1], math.inf)
        feet = np.minimum(np.maximum(ahead, 0.0), ends)
        arcs = self._arcs[:-1] + feet
        off = np.linalg.norm(self._leg[:-1] + feet[:, None] * self._along - self.place, axis=1)
        off[(arcs < self._gone - _BACK) | (arcs > self._gone + _ON)] = math.inf
        if np.isfinite(off).any():
            self._gone = float(arcs[np.argmin(off)])
        if self._arcs[-1] - self._gone <= self._config.near[0]:
            self._begin(_Phase.FACE)

    def _pursued(self) -> FloatArray:
        """Return the point (2,) of the path, gone on straight beyond its end, that is pursued."""
        config = self._config
        least, most = config.lookahead
        arc = self._gone + min(max(config.ahead * abs(self._speed), least), most)
        i = min(int(np.searchsorted(self._arcs, arc, side="right")) - 1, len(self._along) - 1)
        return self._leg[i] + (arc - self._arcs[i]) * self._along[i]

    def _allowed(self, share: float, curvature: float) -> float:
        """Return the speed that tilt, curvature, corners and the end allow [m/s]."""
        config, steer = self._config, self._steer
        wheels = _FULL * steer.most * steer.wheel_radius
        wheels /= 1.0 + curvature * steer.half_track / steer.turn_share
        left = np.maximum(self._slow_at - self._gone, 0.0)[self._arcs[1:] > self._gone]
        slow = self._slow[self._arcs[1:] > self._gone]
        ahead = np.sqrt(slow**2 + 2.0 * _BRAKES * config.acceleration * left)
        curved = share * config.turn / max(curvature, 1e-9)
        end = config.slowing * max(float(self._arcs[-1]) - self._gone, 0.0)
        return min(share * config.speed, wheels, curved, float(ahead.min(initial=math.inf)), end)


def _towards(value: float, wanted: float, step: float) -> float:
    """Return a value moved by at most a step towards another."""
    return value + min(max(wanted - value, -step), step)


def _turned(point: FloatArray, angle: float) -> FloatArray:
    """Return a point (2,) turned to the left [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def _joined(points: FloatArray, place: FloatArray) -> FloatArray:
    """Return a path from a place (2,): along another one as soon as that passes near."""
    if len(points) == 1:
        return np.vstack([place, points])
    steps = np.diff(points, axis=0)
    squares = np.maximum(np.sum(steps**2, axis=1), 1e-18)
    shares = np.clip(np.sum((place - points[:-1]) * steps, axis=1) / squares, 0.0, 1.0)
    feet = points[:-1] + shares[:, None] * steps
    off = np.linalg.norm(feet - place, axis=1)
    near = off <= _JOINS
    if not near.any():
        return np.vstack([place, points])
    i = int(np.argmax(near))
    while i + 1 < len(off) and off[i + 1] < off[i]:
        i += 1
    if i + 1 == len(off) and shares[i] == 1.0:
        return np.vstack([place, points[-1]])
    return np.vstack([feet[i], points[i + 1 :]])


def _simplified(points: FloatArray, slack: float) -> FloatArray:
    """Return (n, 2) of the points (N, 2): all lie within the slack of the lines between those.

    Source: Ramer (1972), Douglas and Peucker (1973).
    """
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    open_spans = [(0, len(points) - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:  # noqa: PLR2004
            continue
        chord, inner = points[last] - points[first], points[first + 1 : last] - points[first]
        share = np.clip(inner @ chord / max(float(chord @ chord), 1e-18), 0.0, 1.0)
        off = np.linalg.norm(inner - share[:, None] * chord, axis=1)
        far = int(np.argmax(off))
        if off[far] > slack:
            kept[first + 1 + far] = True
            open_spans += [(first, first + 1 + far), (first + 1 + far, last)]
    return points[kept]


def _split(route: FloatArray, corner: float) -> list[FloatArray]:
    """Return the parts of a path between corners (rad) that are too sharp for a curve."""
    apart = np.linalg.norm(np.diff(route, axis=0), axis=1) > 1e-6  # noqa: PLR2004
    route = route[np.append(True, apart)]
    if len(route) == 1:
        return []
    sharp = 1 + np.flatnonzero(_corners(route) > corner)
    ends = [0, *sharp.tolist(), len(route) - 1]
    return [route[a : b + 1] for a, b in zip(ends[:-1], ends[1:])]


def _corners(route: FloatArray) -> FloatArray:
    """Return (n - 2,) the angles by which a path (n, 2) turns at its inner points [rad]."""
    steps = np.diff(route, axis=0)
    before, after = steps[:-1], steps[1:]
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.abs(np.arctan2(cross, np.sum(before * after, axis=1)))


def _length(route: FloatArray) -> float:
    """Return the length of a path (n, 2) [m]."""
    return float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
