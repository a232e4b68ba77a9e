"""Where to look for the target next, before a robot knows its place (Thesis section 3.2.2).

The head turns from view to view over all sides. What may be a marker is a hint: the head turns to
it at once, so that the whole target comes into view. The arm takes up only postures that lie in the
space which is free when the robot is set down, for nothing else is known to be free yet. The wrist
of a leaning robot turns against the lean, lest it look at the ground or into the sky.
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
    """How a target is looked for.

    Attributes:
        turns: Yaws of the views [rad], in their order: ahead first. Less apart than a field of
            view: one marker in either image is hint enough.
        lift: The wrist's turn from where it is when the robot starts [rad].
        bend: Greatest turn of the wrist from its posture's, to a hint or against a lean [rad].
        alike: Two views no joint of which differs by more show the same [rad].
        slack: Markers of one target lie within its own extent times this: distances are measured.
        alone: Weight of what only one image shows, against 1 of what both show.
    """

    turns: tuple[float, ...] = (0.0, 0.55, -0.55, 1.1, -1.1, 1.65, -1.65, 2.2, -2.2)
    lift: float = 0.2
    bend: float = 0.7
    alike: float = 0.08
    slack: float = 1.25
    alone: float = 0.5


class TargetSearch:
    """One robot's search."""

    def __init__(
        self,
        arm: SerialChain,
        home: ArrayLike,
        survey: ArrayLike,
        extent: float,
        config: TargetSearchConfig | None = None,
    ) -> None:
        """Begin.

        Args:
            arm: The robot's.
            home: (joints,) where the arm starts, low [rad].
            survey: (joints,) where the head is high, and sees over what stands before it [rad].
            extent: Greatest distance between two markers of the target [m].
            config: How it is looked for.
        """
        self._arm, self._config = arm, config or TargetSearchConfig()
        low, high = np.array(home, dtype=float), np.array(survey, dtype=float)
        low[-1] += self._config.lift
        self._postures = (low, high)
        self._extent = extent
        self._tried: list[FloatArray] = []
        self._rest = self._views()

    def first(self) -> FloatArray:
        """Return the first view (joints,) [rad]."""
        low, _ = self._postures
        return self._turned(low, self._config.turns[0])

    def after(
        self, angles: FloatArray, hints: PossibleMarkers, tilt: FloatArray
    ) -> FloatArray | None:
        """Return the next view (joints,) [rad]; None when all have been tried.

        Args:
            angles: (joints,) from which the last look was taken [rad].
            hints: What it showed that may be markers.
            tilt: (2,) pitch and roll of the robot then [rad].
        """
        self._tried.append(angles)
        place = self._likeliest(hints)
        if place is not None:
            wanted = self._arm.tool_in_robot(angles).apply(place)
            for posture in sorted(self._postures, key=lambda p: float(np.abs(p - angles)[1])):
                view = self._aim(wanted, posture)
                if self._is_new(view):
                    return view
        upright = (self._against_lean(view, tilt) for view in self._rest)
        return next((view for view in upright if self._is_new(view)), None)

    def _views(self) -> Iterator[FloatArray]:
        """Yield the views over all sides: ahead from both postures, then around from each."""
        low, high = self._postures
        ahead, *sides = self._config.turns
        order = [(low, ahead), (high, ahead)]
        order += [(posture, turn) for posture in self._postures for turn in sides]
        for posture, turn in order:
            yield self._turned(posture, turn)

    def _turned(self, posture: FloatArray, turn: float) -> FloatArray:
        view = posture.copy()
        view[0] += turn
        return np.clip(view, *self._arm.limits.T)

    def _against_lean(self, view: FloatArray, tilt: FloatArray) -> FloatArray:
        """Return a view with the wrist turned by what the robot's lean raises or lowers it."""
        ahead = np.array([-np.sin(view[0]), np.cos(view[0]), 0.0])
        raised = float(np.arcsin(tilt_to_level(tilt).apply(ahead)[2]))
        level = view.copy()
        level[-1] -= np.clip(raised, -self._config.bend, self._config.bend)
        return np.clip(level, *self._arm.limits.T)

    def _is_new(self, view: FloatArray) -> bool:
        return all(np.abs(view - tried).max() > self._config.alike for tried in self._tried)

    def _likeliest(self, hints: PossibleMarkers) -> FloatArray | None:
        """Return the middle (3,) of the heaviest hints that one target can hold, camera frame."""
        points = np.concatenate([hints.paired, hints.alone])
        if not len(points):
            return None
        weights = np.repeat([1.0, self._config.alone], [len(hints.paired), len(hints.alone)])
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        together = apart <= self._config.slack * self._extent
        best = int(np.argmax(together @ weights))
        return np.average(points[together[best]], axis=0, weights=weights[together[best]])

    def _aim(self, place: FloatArray, posture: FloatArray) -> FloatArray:
        return aim(self._arm, place, posture, self._config.bend)


def aim(arm: SerialChain, place: ArrayLike, posture: ArrayLike, bend: float = np.pi) -> FloatArray:
    """Return a posture with yaw and wrist such that the left camera looks at a point.

    Args:
        arm: That carries the camera.
        place: (3,) [m], robot frame.
        posture: (joints,) [rad]; those between yaw and wrist stay.
        bend: Greatest turn of the wrist from it [rad].

    Returns:
        (joints,) [rad], within the limits; as near to it as they allow.
    """
    stance, point = np.asarray(posture, dtype=float), np.asarray(place, dtype=float)
    limits, turn = arm.limits, stance[-1] + bend * np.array([-1.0, 1.0])
    low = np.array([limits[0, 0], max(limits[-1, 0], turn[0])])
    high = np.array([limits[0, 1], min(limits[-1, 1], turn[1])])

    def view(turns: FloatArray) -> FloatArray:
        return np.concatenate([turns[:1], stance[1:-1], turns[1:]])

    def off_axis(turns: FloatArray) -> FloatArray:
        seen = arm.tool_in_robot(view(turns)).apply(point, inverse=True)
        return seen / np.linalg.norm(seen) - [0.0, 0.0, 1.0]

    away = point - arm.transform_base_to_robot.translation
    start = np.array([np.arctan2(-away[0], away[1]), stance[-1]])  # At yaw 0 along y.
    found = least_squares(off_axis, np.clip(start, low, high), bounds=(low, high))
    return view(found.x)
