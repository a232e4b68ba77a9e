"""Behaviours that stages are made of, each a generator: observations in, commands out.

`seen = yield command` is one servo tick; `yield from` joins behaviours. Each returns the latest
observation.
"""

import math
from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from controllers.insertion.camera_station import camera_arm
from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import RobotLocalization
from controllers.mapping.searching import aim
from controllers.mission.belief import MissionBelief
from controllers.mission.navigator import Navigator
from controllers.motion.arm_move import ArmMove
from perception.geometry.arrays import FloatArray
from twin.robot import Command, Observation

Behaviour = Generator[Command, Observation, Observation]
DRIVING = np.array([0.0, 1.6, -0.2, -1.85])
"""Posture of the arm on the way: folded above the rover, the head high, its view 26 degrees below
the horizon [rad]."""
LOOKING = np.array([0.0, 1.9, -0.9, -1.85])
"""Posture of the arm to look at the ground just beside the rover: 49 degrees below the horizon, and
the wrist 8 degrees before its limit [rad]."""
_ROUND = (-2.4, -1.6, -0.8, 0.0, 0.8, 1.6, 2.4)  # Turns of the arm to look on all sides [rad].
_SPARE = 0.4  # Turn of the arm left to its limit after the rover has turned for it [rad].
_MOST_LOOKS = 12  # Largest number of looks at unseen ground before the rover sets off.
_MOST_STALLS = 4  # Largest number of times that a rover may get stuck on one way.
_BACK = (0.0, 0.5, 1.0, 1.5)
"""Shares of its turn since it recognised something by which an astray rover turns its head back."""
Goal = tuple[FloatArray, float | None]
"""Place (2,) [m] and heading [rad] in the frame of the map; None for any heading."""
OnPair = Callable[[Observation, RobotLocalization | None], bool]
"""Called with each pair taken on the way; returns whether the drive is to end there."""


class Driven(NamedTuple):
    """End of a drive.

    Attributes:
        seen: Latest observation.
        arrived: Whether the rover is where it was to be, or was ended by a pair.
        reason: Why it is not; empty if it is.
        stopped: Whether it has stopped on its way, and may go on.
    """

    seen: Observation
    arrived: bool
    reason: str = ""
    stopped: bool = False


class DrivingPart:
    """One rover's part of a stage that is a single behaviour, `_run`; then the arm is folded.

    Args:
        belief: Estimates of the rover.

    Attributes:
        done: Whether the behaviour has ended.
    """

    def __init__(self, belief: MissionBelief) -> None:
        self.done = False
        self._belief, self._navigator = belief, belief.navigator
        self._arm, _ = camera_arm(belief.robot)
        self._rest = ArmMove(DRIVING, guard=self._navigator.tip_guard)
        self._behaviour: Behaviour | None = None

    def step(self, seen: Observation) -> Command:
        """Return the next command of the behaviour, or to fold the arm when it has ended."""
        self._navigator.observe(seen)
        if not self.done:
            try:
                if self._behaviour is not None:
                    return self._behaviour.send(seen)
                self._behaviour = self._run(seen)
                return next(self._behaviour)
            except StopIteration:
                self.done = True
        return self._rest.command(seen)

    def _run(self, seen: Observation) -> Behaviour:
        """Begin the behaviour at an observation."""
        raise NotImplementedError


def posed(seen: Observation, navigator: Navigator, goal: FloatArray) -> Behaviour:
    """Move the arm, until a stereo pair was taken at its goal, at rest.

    Args:
        seen: Latest observation.
        navigator: Navigator of the rover, which guards the move.
        goal: (joints,) posture [rad].
    """
    move = ArmMove(goal, guard=navigator.tip_guard)
    while not (move.sees(seen) and seen.inclinometer.usable):
        seen = yield move.command(seen)
    return seen


def faced(
    seen: Observation, navigator: Navigator, arm: SerialChain, point: FloatArray
) -> Behaviour:
    """Turn the rover, no more than that takes, until its arm turns to a position, as behind it.

    Args:
        seen: Latest observation.
        navigator: Localization, map and drive of the rover.
        arm: Chain of the arm, with the left camera as its tool.
        point: (3,) position [m], in the rover's frame.
    """
    bearing, (low, high) = math.atan2(-point[0], point[1]), arm.limits[0]
    if low < bearing < high:
        return seen
    turn = bearing - min(max(bearing, low + _SPARE), high - _SPARE)
    seen = yield from posed(seen, navigator, DRIVING)
    seen = yield from _with_room(seen, navigator, turn)
    navigator.follow(navigator.place[None], navigator.yaw + turn)
    return (yield from finished(seen, navigator))


def look_round(seen: Observation, navigator: Navigator) -> Behaviour:
    """Look at the ground on all sides of the rover.

    Args:
        seen: Latest observation.
        navigator: Localization and map of the rover.
    """
    for turn in _ROUND:
        seen = yield from posed(seen, navigator, LOOKING + [turn, 0.0, 0.0, 0.0])
        navigator.take(seen, at_rest=True)
    return (yield from posed(seen, navigator, DRIVING))


def recognised(seen: Observation, navigator: Navigator) -> Behaviour:
    """Let a rover that is astray look back to where it recognised something last.

    Args:
        seen: Latest observation.
        navigator: Localization and map of the rover.
    """
    if not navigator.astray:
        return seen
    back = -navigator.odometry.strayed
    for share in _BACK:
        seen = yield from posed(seen, navigator, DRIVING + [share * back, 0.0, 0.0, 0.0])
        navigator.take(seen, at_rest=True)
        if not navigator.astray:
            return seen
    navigator.resign()
    return seen


def retreat(seen: Observation, navigator: Navigator, held: bool) -> Behaviour:
    """Drive back a little.

    Args:
        seen: Latest observation.
        navigator: Localization, map and drive of the rover.
        held: Whether something before the rover holds it.
    """
    navigator.back_off(held)
    while not (navigator.arrived or navigator.blocked):
        if navigator.is_due(seen):
            navigator.take(seen, at_rest=False)
        seen = yield navigator.step(seen)
    navigator.halt()
    return seen


def drive(
    seen: Observation,
    navigator: Navigator,
    arm: SerialChain,
    goal: Callable[[], Goal],
    on_pair: OnPair | None = None,
    once: bool = False,
) -> Generator[Command, Observation, Driven]:
    """Drive along planned paths, taking pairs on the way; back off where something holds the rover.

    The rover drives over no ground that it has not seen: what the head does not see on the way, as
    beside the rover where a path turns, it looks at beforehand.

    Args:
        seen: Latest observation.
        navigator: Localization, map and drive of the rover.
        arm: Chain of the arm, with the left camera as its tool.
        goal: Returns where it drives; called again after each stop, with what is mapped then.
        on_pair: Called with each pair taken on the way; None to let no pair end the drive.
        once: Whether the drive ends where it first stops, even on its way.
    """
    on_pair = on_pair or _any
    stalls, reason = 0, ""
    while stalls < _MOST_STALLS:
        seen = yield from recognised(seen, navigator)
        place, heading = goal()
        seen, found = yield from _look_along(
            seen, navigator, arm, lambda place=place: navigator.path_to(place), on_pair
        )
        if found:
            return Driven(seen, True)
        seen = yield from _with_room(seen, navigator, _first_turn(navigator, place))
        if navigator.set_off(place, heading):
            seen, found = yield from _go_on(seen, navigator, on_pair)
            reason = navigator.blocked
        else:
            seen = yield from look_round(seen, navigator)
            reason = "there is no path on what is mapped"
        if found or (navigator.arrived and not reason):
            navigator.halt()
            return Driven(seen, True)
        if reason:
            stalls += 1
            seen = yield from retreat(seen, navigator, held=navigator.held)
        if once:
            navigator.halt()
            return Driven(seen, False, reason, True)
    return Driven(seen, False, f"stuck {_MOST_STALLS} times: {reason}")


def drive_along(
    seen: Observation,
    navigator: Navigator,
    arm: SerialChain,
    path: FloatArray,
    heading: float,
    backwards: bool = False,
) -> Behaviour:
    """Drive along a short path as it is, once the ground before the rover was looked at.

    Args:
        seen: Latest observation.
        navigator: Localization, map and drive of the rover.
        arm: Chain of the arm, with the left camera as its tool.
        path: (N, 2) points, in the frame [m].
        heading: Heading at its end, in the frame [rad].
        backwards: Whether the rover drives backwards, where it came from.
    """
    if backwards:
        seen = yield from posed(seen, navigator, DRIVING)
        navigator.take(seen, at_rest=True)
    else:
        seen, _ = yield from _look_along(seen, navigator, arm, lambda: path, _any)
    navigator.follow(path, heading, backwards)
    return (yield from finished(seen, navigator))


def finished(seen: Observation, navigator: Navigator) -> Behaviour:
    """Drive until a drive that has begun ends, wherever that is.

    Args:
        seen: Latest observation.
        navigator: Localization, map and drive of the rover.
    """
    seen, _ = yield from _go_on(seen, navigator, _any)
    navigator.halt()
    return (yield from recognised(seen, navigator))


def _with_room(seen: Observation, navigator: Navigator, angle: float) -> Behaviour:
    """Drive back or forward from where the rover might touch something as it turns [rad]."""
    if not navigator.may_turn(angle):
        seen = yield from retreat(seen, navigator, held=False)
    return seen


def _first_turn(navigator: Navigator, place: FloatArray) -> float:
    """Return the angle by which the rover turns first on its way to a place (2,) [rad]."""
    path = navigator.path_to(place)
    if path is None:
        return 0.0
    across, ahead = path[1] - path[0]
    return math.remainder(math.atan2(-across, ahead) - navigator.yaw, 2.0 * math.pi)


def _look_along(
    seen: Observation,
    navigator: Navigator,
    arm: SerialChain,
    plan: Callable[[], FloatArray | None],
    on_pair: OnPair,
) -> Generator[Command, Observation, tuple[Observation, bool]]:
    """Look at the ground along a path until it was seen; return whether a pair ended that."""
    for _ in range(_MOST_LOOKS):
        path = plan()
        point = None if path is None else navigator.unseen(path)
        if point is None:
            break
        seen = yield from faced(seen, navigator, arm, point)
        point = navigator.to_look_at()
        seen = yield from posed(seen, navigator, aim(arm, point, LOOKING))
        found = navigator.take(seen, at_rest=True)
        navigator.looked()
        if on_pair(seen, found):
            return seen, True
    seen = yield from posed(seen, navigator, DRIVING)
    return seen, on_pair(seen, navigator.take(seen, at_rest=True))


def _go_on(
    seen: Observation, navigator: Navigator, on_pair: OnPair
) -> Generator[Command, Observation, tuple[Observation, bool]]:
    """Drive until the rover has arrived, is held or waits; return whether a pair ended that."""
    while not (navigator.arrived or navigator.blocked or navigator.waits):
        if navigator.is_due(seen):
            if on_pair(seen, navigator.take(seen, at_rest=False)):
                return seen, True
            navigator.correct()
        seen = yield navigator.step(seen)
    return seen, False


def _any(seen: Observation, found: RobotLocalization | None) -> bool:
    """Let no pair end a drive."""
    return False
