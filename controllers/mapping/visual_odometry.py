"""Visual odometry of a rover: from pair to pair by features, between pairs by its wheels.

A skid-steered rover's wheels tell distances well and turns badly; its stereo head tells both, where
two views overlap. So the wheels give the guess, and bridge pairs in which nothing is recognised;
the inclinometer keeps the frame level. All errors are carried in one covariance of the pose.
"""

import bisect
import collections
import dataclasses
import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.motion.driving import SkidSteer, downhill
from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.se3 import transport_covariance
from perception.registration.checks import RegistrationError
from perception.registration.features import FeatureMatcher, ViewFeatures
from perception.registration.motion import Motion
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoPoints
from twin.robot import Observation

_KEPT = 8.0  # Time for which past poses are kept [s]: pairs and the boards' answers are older.
_OTHER_TURNS = (0.0, 0.2, -0.2, 0.4, -0.4)
"""Turns beside those of the wheels that are tried in their order [rad]: on smooth slopes a rover
turns by other angles than its wheels tell."""
_VIEWS, _TRIED = 10, 2  # Views that are kept, and of these the nearest that are tried.
_OTHER_POSTURE = 0.02  # Change of a joint from which on its errors count [rad].
_STANDING = 2e-5  # Motion of rolling wheels in a tick below which the rover stands [m, rad].
_STILL = 1e-3  # Motion below which a rover has not moved since its last pair [m, rad].
_TREMBLE = 3e-4
"""Turn of rolling wheels in a tick up to which it may be noise [rad]: the tachometers of a rover at
rest would add up to a turn of 0.4 rad in 100 s."""
_ROLLED = 0.1  # Way of the wheels that tells of slip [m].
_PIVOTED, _SPOT = 0.2, 0.12
"""Turn of rolling wheels on the spot that tells of slip [rad], and their way over that turn up to
which it is one [m/rad]; so is one with less way than tells of slip itself."""
_HELD = 0.6  # Slip from which on something holds the rover, and its turns tell nothing.
_TURNED = 0.05  # Turn of rolling wheels that tells of the turn share [rad].
_QUICK = 0.6  # Turn share by which turns are counted: a pair too many does no harm.
_SHARES = (0.1, 1.0)  # Turn shares that skidding can have.
_SCRUBBED, _ON = 0.3, 0.15
"""Turn of rolling wheels [rad], and most of their way meanwhile [m], that tell how it slides."""
_STEEP = 0.04  # Slope that tells it.
_MOST_SLIDE = 2.0  # Largest slide that scrubbing can bring [m/rad].


@dataclasses.dataclass(frozen=True)
class VisualOdometryConfig:
    """Standard deviations of what moves the estimate.

    Attributes:
        period: Servo tick [s].
        seen: Rotation [rad] and translation [m] of a motion by features, beside its covariance:
            errors of the head's calibration and of the time of the images.
        seen_share: Translation of a motion by features, over its length.
        rolled: Rotation [rad] and translation [m] of a motion by wheels.
        rolled_share: Rotation over the angle turned, translation over the length, by wheels alone.
        pivot: Distance of the pivot of a turn from the rover's middle [m].
        tilt_lag: Time constant that smooths the inclinometer [s].
        tilt_at_rest: Tilt by the inclinometer at rest [rad]: its zero and scale.
        tilt_driving: Tilt by the inclinometer on the way [rad]: it feels acceleration as well.
        arm: Rotation of the camera by the arm's joints between two postures [rad].
        turn_scatter: Turn share of one turn about that of others: it differs by half on patches of
            other friction, and on slopes.
        least_sigma: Deviation that the turn share keeps: the ground changes.
        slide_gain: Part of the latest slide that is taken over: it differs from patch to patch.
    """

    period: float = 0.01
    seen: tuple[float, float] = (0.0015, 0.0015)
    seen_share: float = 0.015
    rolled: tuple[float, float] = (0.01, 0.005)
    rolled_share: tuple[float, float] = (0.05, 0.08)
    pivot: float = 0.1
    tilt_lag: float = 0.3
    tilt_at_rest: float = 0.008
    tilt_driving: float = 0.03
    arm: float = 0.003
    turn_scatter: float = 0.12
    least_sigma: float = 0.05
    slide_gain: float = 0.3


class _Past(NamedTuple):
    """What was measured at a tick.

    Attributes:
        time: [s], by the robot's clock.
        rolled: (2,) distance [m] and turn [rad] of rolling wheels in this tick.
        tilt: (2,) pitch and roll by the inclinometer, smoothed [rad].
        downhill: (2,) direction downhill by that, see `driving.downhill`.
        angles: (joints,) joint angles [rad].
    """

    time: float
    rolled: tuple[float, float]
    tilt: FloatArray
    downhill: FloatArray
    angles: FloatArray

    @property
    def moving(self) -> bool:
        """Whether the wheels turn."""
        return abs(self.rolled[0]) + abs(self.rolled[1]) > _STANDING


class _Steps:
    """Way of the wheels in each tick that is kept, as rows of one array that grows.

    A row holds time [s], distance [m] and turn [rad] of rolling wheels, and the direction downhill
    (2,).
    """

    def __init__(self) -> None:
        self._rows, self._first, self._end = np.zeros((1024, 5)), 0, 0

    def append(self, past: _Past) -> None:
        """Add the newest tick."""
        if self._end == len(self._rows):
            kept = self._rows[self._first : self._end].copy()
            self._rows = np.zeros((2 * len(kept), 5))
            self._rows[: len(kept)], self._first, self._end = kept, 0, len(kept)
        self._rows[self._end] = past.time, *past.rolled, *past.downhill
        self._end += 1

    def drop(self) -> None:
        """Remove the oldest tick."""
        self._first += 1

    def between(self, begin: float, end: float) -> FloatArray:
        """Return the rows (N, 5) after one time and up to another [s]."""
        rows = self._rows[self._first : self._end]
        first, last = np.searchsorted(rows[:, 0], [begin, end], side="right")
        return rows[first:last]


class _Seen(NamedTuple):
    """A view that motions are measured from.

    Attributes:
        features: Features of the view.
        transform_camera_to_frame: Pose of the left camera.
        covariance: (6, 6) covariance of the rover's pose at the view, in the frame.
        past: What was measured at the view.
    """

    features: ViewFeatures
    transform_camera_to_frame: RigidTransform
    covariance: FloatArray
    past: _Past

    def away(self, transform_camera_to_frame: RigidTransform) -> float:
        """Return how far another view is, as an angle [rad] and half a distance [m]."""
        motion = self.transform_camera_to_frame.inv() * transform_camera_to_frame
        return float(motion.rotation.magnitude() + 0.5 * np.linalg.norm(motion.translation))


class VisualOdometry:
    """Pose of one rover in a level frame, with its covariance.

    Args:
        arm: Chain of the arm, with the left camera as its tool.
        geometry: Geometry of the stereo head.
        steer: Wheels of the rover, with the turn share as known beforehand.
        config: Standard deviations; None for the default.

    Attributes:
        covariance: (6, 6) covariance of xi in ``true = from_exp_coords(xi) * pose``, in the frame.
        turn_share: Turn share by the turns seen so far.
        slide: How far the rover slides downhill as its wheels turn it, by the turns seen so far; as
            of `SkidSteer` [m/rad].
        distance: Distance driven by the wheels, forward and back [m].
        turned: Angle turned by the wheels, left positive [rad], at a turn share of 0.6 or more.
        slip: Share of the wheels' last way, or of a turn on the spot with the drawn turn share,
            that features did not see; 0 where they saw nothing.
        seen: Number of motions that features gave.
        missed: Number of motions for which the wheels stood in.
        astray: Number of these since features gave one last; 0 to go on by the wheels.
        strayed: Turn of the rover since features gave a motion last, by its wheels [rad].
    """

    def __init__(
        self,
        arm: SerialChain,
        geometry: StereoGeometry,
        steer: SkidSteer,
        config: VisualOdometryConfig | None = None,
    ) -> None:
        self._arm, self._config = arm, config or VisualOdometryConfig()
        self._matcher = FeatureMatcher(geometry)
        self._rolling = dataclasses.replace(steer, turn_share=1.0, turn_sigma=0.0, slide=0.0)
        self._information = 1.0 / max(steer.turn_sigma, 1e-3) ** 2
        self._pasts: collections.deque[_Past] = collections.deque()
        self._steps = _Steps()
        self._pose = RigidTransform.identity()
        self._at: _Past | None = None
        # Tick and pose of the last prediction, and what it gave.
        self._known: tuple[_Past, RigidTransform, tuple[RigidTransform, FloatArray]] | None = None
        self._views: collections.deque[_Seen] = collections.deque(maxlen=_VIEWS)
        self.turn_share, self.distance, self.turned = steer.turn_share, 0.0, 0.0
        self.slide, self._drawn_share = steer.slide, steer.turn_share
        self.covariance = np.zeros((6, 6))
        self._upright = np.zeros(2)  # Variance of the frame's own tilt [rad^2].
        self.seen, self.missed, self.slip = 0, 0, 0.0
        self.astray, self.strayed = 0, 0.0

    @property
    def turn_sigma(self) -> float:
        """Standard deviation of the turn share in a turn to come."""
        return math.hypot(1.0 / math.sqrt(self._information), self._config.turn_scatter)

    def update(self, seen: Observation) -> None:
        """Take one tick's wheel speeds, tilt and joint angles.

        Args:
            seen: Observation of the rover.
        """
        if not (seen.arm_angles.usable and seen.inclinometer.usable):
            return
        config, tilt = self._config, np.array(seen.inclinometer.value, dtype=float)
        angles = np.array(seen.arm_angles.value, dtype=float)
        rolled = (0.0, 0.0)
        if seen.wheel_speeds.usable:
            forward, turn = self._rolling.motion(seen.wheel_speeds.value)
            rolled = forward * config.period, turn * config.period
        if self._at is None:
            self._at = _Past(seen.time, rolled, tilt, downhill(tilt), angles)
            self._pose = tilt_to_level(tilt)
            self.covariance = np.diag(np.square([config.tilt_at_rest] * 2 + [1e-6] * 4))
        else:
            share = config.period / (config.period + config.tilt_lag)
            tilt = self._pasts[-1].tilt + share * (tilt - self._pasts[-1].tilt)
        self.distance += abs(rolled[0])
        self.turned += max(self.turn_share, _QUICK) * rolled[1]
        self._pasts.append(_Past(seen.time, rolled, tilt, downhill(tilt), angles))
        self._steps.append(self._pasts[-1])
        while self._pasts[0].time < min(seen.time - _KEPT, self._at.time):
            self._pasts.popleft()
            self._steps.drop()

    def estimate(self) -> tuple[RigidTransform, FloatArray]:
        """Return the rover's pose in the frame as of now, and its covariance (6, 6)."""
        return self._predicted(self._pasts[-1])

    def pose(self) -> RigidTransform:
        """Return the transform from the rover's frame to the frame of the estimate, as of now."""
        return self.estimate()[0]

    def level_pose(self) -> RigidTransform:
        """Return the transform from the rover's frame, brought level, to that of the estimate."""
        return levelled(self.pose())

    def camera(self, time: float) -> tuple[RigidTransform, FloatArray]:
        """Return the left camera's pose in the frame at a time, and its covariance (6, 6).

        Args:
            time: Time of the pair, by the robot's clock [s].
        """
        past = self._past(time)
        pose, covariance = self._predicted(past)
        return pose * self._arm.tool_in_robot(past.angles), covariance

    def see(self, time: float, image: ImageArray, points: StereoPoints) -> None:
        """Move the estimate by a new pair.

        Args:
            time: Time of the pair, by the robot's clock [s].
            image: (height, width) uint8, the left image.
            points: Matched points of the pair.
        """
        past = self._past(time)
        pose, covariance = self._predicted(past)
        tool = self._arm.tool_in_robot(past.angles)
        features = self._matcher.find(image, points)
        camera = pose * tool
        nearest = sorted(self._views, key=lambda view: view.away(camera))[:_TRIED]
        for turn, view in itertools.product(_OTHER_TURNS, nearest):
            begin = view.transform_camera_to_frame
            guess = begin.inv() * (_turned(pose, turn) * tool)
            try:
                motion = self._matcher.motion(view.features, features, guess)
            except RegistrationError:
                continue
            moved = motion.transform_after_to_before
            pose = begin * moved * tool.inv()
            covariance = view.covariance + transport_covariance(
                begin, self._motion_covariance(motion, view.past, past)
            )
            self._compare(view, past, pose)
            self.seen += 1
            self.astray, self.strayed = 0, 0.0
            break
        else:
            self.missed += bool(self._views)
            self.slip = 0.0
            if self._views and pose is not self._pose:
                self.astray += 1
                moved = self._pose.inv() * pose
                self.strayed += float(moved.rotation.as_euler("ZXY")[0])
        self._pose, self.covariance, self._at = pose, covariance, past
        self._level(past)
        self._views.append(_Seen(features, self._pose * tool, self.covariance, past))

    def localize(self, found: RobotLocalization, time: float) -> None:
        """Take over a pose that was measured by a target; its frame becomes the estimate's.

        The first one has defined that frame: it is level but for the error of its tilt.

        Args:
            found: Localization of the rover.
            time: Time of the pair, by the robot's clock [s].
        """
        past = self._past(time)
        self._pose = found.transform_level_to_world * tilt_to_level(past.tilt)
        self.covariance, self._at = found.robot_covariance(), past
        self.astray, self.strayed = 0, 0.0
        if not self._upright.any():
            self._upright = np.diag(self.covariance)[:2].copy()
        # Of the views only the one that showed the target keeps its place in the new frame.
        camera = self._pose * self._arm.tool_in_robot(past.angles)
        same = [view for view in self._views if view.past.time == past.time]
        self._views.clear()
        for view in same:
            self._views.append(_Seen(view.features, camera, self.covariance, past))

    def _past(self, time: float) -> _Past:
        """Return the tick nearest to a time."""
        after = bisect.bisect_left(self._pasts, time, key=lambda past: past.time)
        near = [self._pasts[index] for index in (after - 1, after) if 0 <= index < len(self._pasts)]
        return min(near, key=lambda past: abs(past.time - time))

    def _rolled_since(
        self, begin: _Past, end: _Past, slide: float | None = None
    ) -> tuple[RigidTransform, float]:
        """Return the level rover's pose at the end in that at the beginning, by its wheels.

        The second number is the angle that rolling wheels turned, left and right [rad].

        Args:
            begin: Tick at the beginning.
            end: Tick at the end.
            slide: How far it slides, as `slide` [m/rad]; None for that.
        """
        between = self._steps.between(begin.time, end.time)
        if not len(between):
            return RigidTransform.identity(), 0.0
        steps, slopes = between[:, 1:3], between[:, 3:]
        turns = self.turn_share * steps[:, 1]
        yaw = np.cumsum(turns) - 0.5 * turns
        flat = (self.slide if slide is None else slide) * np.abs(steps[:, 1])[:, None] * slopes
        flat[:, 1] += steps[:, 0] / np.sqrt(1.0 + slopes[:, 1] ** 2)
        s, c = np.sin(yaw), np.cos(yaw)
        rise = -np.sum(flat * slopes)
        place = [c @ flat[:, 0] - s @ flat[:, 1], s @ flat[:, 0] + c @ flat[:, 1], rise]
        turn = Rotation.from_euler("z", turns.sum())
        turned = np.abs(steps[:, 1])
        angle = float(turned[turned > _TREMBLE].sum())
        return RigidTransform.from_components(place, turn), angle

    def _predicted(self, past: _Past) -> tuple[RigidTransform, FloatArray]:
        """Return the rover's pose at a tick by its wheels since the last pair, and covariance."""
        if self._known is None or self._known[0] is not past or self._known[1] is not self._pose:
            self._known = past, self._pose, self._reckoned(past)
        return self._known[2]

    def _reckoned(self, past: _Past) -> tuple[RigidTransform, FloatArray]:
        """Reckon what `_predicted` returns."""
        config = self._config
        assert self._at is not None
        level = levelled(self._pose)
        rolled, angle = self._rolled_since(self._at, past)
        pose = level * rolled * tilt_to_level(past.tilt)
        length = float(np.linalg.norm(rolled.translation))
        if length < _STILL and angle < _STILL:
            return self._pose, self.covariance
        (turn, place), (by_angle, by_length) = config.rolled, config.rolled_share
        yaw = math.hypot(turn + by_angle * angle * self.turn_share, self.turn_sigma * angle)
        along = place + by_length * length + config.pivot * angle * self.turn_share
        own = np.diag(np.square([config.tilt_driving] * 2 + [yaw] + [along] * 3))
        return pose, self.covariance + transport_covariance(level, own)

    def _motion_covariance(self, motion: Motion, before: _Past, after: _Past) -> FloatArray:
        """Return the covariance (6, 6) of a motion that features gave, in the camera before it."""
        turn, place = self._config.seen
        length = float(np.linalg.norm(motion.transform_after_to_before.translation))
        place += self._config.seen_share * length
        if np.abs(after.angles - before.angles).max() > _OTHER_POSTURE:
            turn = math.hypot(turn, self._config.arm)
        return motion.covariance + np.diag(np.square([turn] * 3 + [place] * 3))

    def _compare(self, view: _Seen, after: _Past, pose: RigidTransform) -> None:
        """Compare a motion that was seen with that of the wheels: slip and turn share."""
        before, self.slip = view.past, 0.0
        if before.time < self._pasts[0].time:
            return
        tool = self._arm.tool_in_robot(before.angles)
        begin = levelled(view.transform_camera_to_frame * tool.inv())
        motion = begin.inv() * levelled(pose)
        rolled, angle = self._rolled_since(before, after, slide=0.0)
        way = float(np.linalg.norm(rolled.translation))
        turned = float(self._steps.between(before.time, after.time)[:, 2].sum())
        seen = float(motion.rotation.as_euler("ZXY")[0])
        # One that turns on the spot may roll, but to stay there.
        if way > max(_SPOT * angle, _ROLLED):
            self.slip = 1.0 - float(np.linalg.norm(motion.translation)) / way
        elif abs(turned) > _PIVOTED:
            self.slip = 1.0 - seen / (self._drawn_share * turned)
        if abs(turned) > _TURNED and self.slip < _HELD:
            self._learn_turns(seen, turned)
        self._learn_slide(before, after, motion)

    def _learn_slide(self, before: _Past, after: _Past, motion: RigidTransform) -> None:
        """Update the slide by the level rover's motion between two ticks, if it turned on the spot.

        Its wheels may have rolled it back meanwhile.
        """
        rolled, angle = self._rolled_since(before, after, slide=0.0)
        slope = before.downhill
        steep, way = float(np.linalg.norm(slope)), float(np.linalg.norm(rolled.translation))
        if angle < _SCRUBBED or way > _ON or steep < _STEEP:
            return
        slid = float((motion.translation - rolled.translation)[:2] @ slope) / steep
        latest = min(max(slid / (angle * steep), 0.0), _MOST_SLIDE)
        self.slide += self._config.slide_gain * (latest - self.slide)

    def _learn_turns(self, turned: float, rolled: float) -> None:
        """Update the turn share by a turn that was seen, and that of rolling wheels [rad]."""
        variance = (2.0 * self._config.seen[0]) ** 2 + (self._config.turn_scatter * rolled) ** 2
        gain = rolled**2 / variance
        weight = gain / (self._information + gain)
        self.turn_share += weight * (turned / rolled - self.turn_share)
        self.turn_share = min(max(self.turn_share, _SHARES[0]), _SHARES[1])
        self._information = min(self._information + gain, 1.0 / self._config.least_sigma**2)

    def _level(self, past: _Past) -> None:
        """Correct the pose's tilt by the inclinometer, whose zero and scale stay wrong."""
        config, level = self._config, levelled(self._pose)
        sigma = config.tilt_driving if past.moving else config.tilt_at_rest
        lasting = config.tilt_at_rest**2 + self._upright
        covariance = _tilted(self.covariance, lasting, level)
        # Against a pose of the same yaw, of which the inclinometer tells nothing.
        measured = level.rotation * tilt_to_level(past.tilt).rotation
        error = (measured * self._pose.rotation.inv()).as_rotvec()[:2]
        noise = np.diag(sigma**2 + self._upright)
        gain = covariance[:, :2] @ np.linalg.inv(covariance[:2, :2] + noise)
        self._pose = RigidTransform.from_exp_coords(gain @ error) * self._pose
        covariance = covariance - gain @ covariance[:2]
        self.covariance = _tilted(0.5 * (covariance + covariance.T), lasting, level)


def _tilted(covariance: FloatArray, least: FloatArray, pose: RigidTransform) -> FloatArray:
    """Return a covariance (6, 6) of a pose whose tilt about itself is no surer than that.

    Args:
        covariance: (6, 6) covariance in the frame.
        least: (2,) variances of the tilt [rad^2].
        pose: The pose in the frame.
    """
    lacking = np.maximum(least - np.diag(covariance)[:2], 0.0)
    about = RigidTransform.from_translation(pose.translation)
    return covariance + transport_covariance(about, np.diag([*lacking, 0, 0, 0, 0]))


def _turned(pose: RigidTransform, turn: float) -> RigidTransform:
    """Return the pose of a rover that has turned farther about the vertical [rad]."""
    rotation = Rotation.from_euler("z", turn) * pose.rotation
    return RigidTransform.from_components(pose.translation, rotation)


def levelled(pose: RigidTransform) -> RigidTransform:
    """Return a pose without its pitch and roll."""
    yaw = pose.rotation.as_euler("ZXY")[0]
    return RigidTransform.from_components(pose.translation, Rotation.from_euler("z", yaw))
