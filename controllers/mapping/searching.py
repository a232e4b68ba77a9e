"""Search for the target, before a robot is localized (Thesis section 3.2.2).

The head turns from view to view in all directions. A possible marker is a hint: the head turns to
it at once, so that the whole target comes into view. The arm uses only postures in the space that
is free at the robot's start, for no other space is known to be free yet. The wrist compensates the
robot's tilt, so that the view is level on a slope too.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import tilt_to_level
from perception.geometry.arrays import FloatArray
from perception.registration.target import PossibleMarkers


@dataclasses.dataclass(frozen=True)
class TargetSearchConfig:
    """Configuration of the search for the target.

    Attributes:
        turns: Yaws of the views in their order, ahead first [rad]. The steps are smaller than the
            field of view, for one marker in either image is a sufficient hint.
        lift: Turn of the wrist from the home posture [rad].
        bend: Greatest turn of the wrist from its posture's, to a hint or against a tilt [rad].
        alike: Greatest difference of a joint between two equivalent views [rad].
        slack: Greatest measured distance of two markers of one target, over the target's extent.
        alone: Weight of a possible marker in only one image, relative to one in both.
    """

    turns: tuple[float, ...] = (0.0, 0.55, -0.55, 1.1, -1.1, 1.65, -1.65, 2.2, -2.2)
    lift: float = 0.2
    bend: float = 0.7
    alike: float = 0.08
    slack: float = 1.25
    alone: float = 0.5


class TargetSearch:
    """Sequence of one robot's search views.

    Args:
        arm: Chain of the arm, with the left camera as its tool.
        home: (joints,) initial posture of the arm with the head low [rad].
        survey: (joints,) posture with the head above obstacles ahead [rad].
        extent: Greatest distance between two markers of the target [m].
        config: Configuration of the search; None for the default.
    """

    def __init__(
        self,
        arm: SerialChain,
        home: ArrayLike,
        survey: ArrayLike,
        extent: float,
        config: TargetSearchConfig | None = None,
    ) -> None:
        self._arm, self._config = arm, config or TargetSearchConfig()
        low, high = np.array(home, dtype=float), np.array(survey, dtype=float)
        low[-1] += self._config.lift
        self._postures = (low, high)
        self._extent = extent
        self._tried: list[FloatArray] = []
        self._rest = self._views()

    def first(self) -> FloatArray:
        """Return the first view (joints,) [rad]."""
        return self._turned(self._postures[0], self._config.turns[0])

    def after(
        self, angles: FloatArray, hints: PossibleMarkers, tilt: FloatArray
    ) -> FloatArray | None:
        """Return the next view (joints,) [rad]; None when all have been tried.

        Args:
            angles: (joints,) angles of the last view [rad].
            hints: Possible markers in the last view.
            tilt: (2,) pitch and roll of the robot at the last view [rad].
        """
        self._tried.append(angles)
        point, weight = likeliest_target(hints, self._extent, self._config)
        if weight > 0.0:
            wanted = self._arm.tool_in_robot(angles).apply(point)
            for posture in sorted(self._postures, key=lambda p: float(np.abs(p - angles)[1])):
                view = aim(self._arm, wanted, posture, self._config.bend)
                if self._is_new(view):
                    return view
        level = (self._tilt_compensated(view, tilt) for view in self._rest)
        return next((view for view in level if self._is_new(view)), None)

    def _views(self) -> Iterator[FloatArray]:
        """Yield the views in all directions: ahead from both postures, then the others."""
        ahead, *sides = self._config.turns
        order = [(posture, ahead) for posture in self._postures]
        order += [(posture, turn) for posture in self._postures for turn in sides]
        return (self._turned(posture, turn) for posture, turn in order)

    def _turned(self, posture: FloatArray, turn: float) -> FloatArray:
        view = posture.copy()
        view[0] += turn
        return np.clip(view, *self._arm.limits.T)

    def _tilt_compensated(self, view: FloatArray, tilt: FloatArray) -> FloatArray:
        """Return a view with the wrist turned against its elevation by the robot's tilt."""
        ahead = np.array([-np.sin(view[0]), np.cos(view[0]), 0.0])
        raised = float(np.arcsin(tilt_to_level(tilt).apply(ahead)[2]))
        level = view.copy()
        level[-1] -= np.clip(raised, -self._config.bend, self._config.bend)
        return np.clip(level, *self._arm.limits.T)

    def _is_new(self, view: FloatArray) -> bool:
        return all(np.abs(view - tried).max() > self._config.alike for tried in self._tried)


def likeliest_target(
    hints: PossibleMarkers, extent: float, config: TargetSearchConfig
) -> tuple[FloatArray, float]:
    """Return the middle (3,) of the heaviest hints that fit in one target, and their weight.

    Args:
        hints: Possible markers.
        extent: Greatest distance between two markers of the target [m].
        config: Configuration of the search.

    Returns:
        Middle, camera frame [m], and weight, 1 for each marker in both images and 0 without any.
    """
    points = np.concatenate([hints.paired, hints.alone])
    if not len(points):
        return np.zeros(3), 0.0
    weights = np.repeat([1.0, config.alone], [len(hints.paired), len(hints.alone)])
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    together = apart <= config.slack * extent
    best = int(np.argmax(together @ weights))
    chosen = together[best]
    middle = np.average(points[chosen], axis=0, weights=weights[chosen])
    return middle, float(weights[chosen].sum())


def aim(arm: SerialChain, place: ArrayLike, posture: ArrayLike, bend: float = np.pi) -> FloatArray:
    """Return a posture with yaw and wrist such that the left camera points at a position.

    Args:
        arm: Chain of the arm, with the left camera as its tool.
        place: (3,) position to point at [m], robot frame.
        posture: (joints,) posture whose joints between yaw and wrist are unchanged [rad].
        bend: Greatest turn of the wrist from the posture's [rad].

    Returns:
        (joints,) posture within the limits that points as closely as they allow [rad].
    """
    fixed, point = np.asarray(posture, dtype=float), np.asarray(place, dtype=float)
    limits, turn = arm.limits, fixed[-1] + bend * np.array([-1.0, 1.0])
    low = np.array([limits[0, 0], max(limits[-1, 0], turn[0])])
    high = np.array([limits[0, 1], min(limits[-1, 1], turn[1])])

    def view(turns: FloatArray) -> FloatArray:
        return np.concatenate([turns[:1], fixed[1:-1], turns[1:]])

    def off_axis(turns: FloatArray) -> FloatArray:
        seen = arm.tool_in_robot(view(turns)).apply(point, inverse=True)
        return seen / np.linalg.norm(seen) - [0.0, 0.0, 1.0]

    away = point - arm.transform_base_to_robot.translation
    start = np.array([np.arctan2(-away[0], away[1]), fixed[-1]])  # At yaw 0 along y.
    found = least_squares(off_axis, np.clip(start, low, high), bounds=(low, high))
    return view(found.x)
