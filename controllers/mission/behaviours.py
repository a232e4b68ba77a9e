"""Behaviours that stages are made of, each a generator: observations in, commands out.

`seen = yield command` is one servo tick; `yield from` joins behaviours. Each returns the latest
observation.
"""

from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import RobotLocalization
from controllers.mapping.searching import aim
from controllers.mission.navigator import Navigator
from controllers.motion.arm_move import ArmMove
from perception.geometry.arrays import FloatArray
from twin.robot import Command, Observation

Behaviour = Generator[Command, Observation, Observation]
DRIVING = np.array([0.0, 1.6, -0.1, -1.85])
"""Posture of the arm on the way: folded above the rover, the head high, its view 20 degrees below
the horizon [rad]."""
_GLANCE = 0.55  # Distance along a path to a point that is looked at before the rover sets off [m].
_MOST_STALLS = 3  # Largest number of times that a rover may get stuck on one way.
OnPair = Callable[[Observation, RobotLocalization | None], bool]
"""Called with each pair taken on the way; returns whether the drive is to end there."""


class Driven(NamedTuple):
    """End of a drive.

    Attributes:
        seen: Latest observation.
        arrived: Whether the rover is where it was to be, or was ended by a pair.
        reason: Why it is not; empty if it is.
    """

    seen: Observation
    arrived: bool
    reason: str = ""


def posed(seen: Observation, goal: FloatArray) -> Behaviour:
    """Move the arm, until a stereo pair was taken at its goal, at rest.

    Args:
        seen: Latest observation.
        goal: (joints,) posture [rad].
    """
    move = ArmMove(goal)
    while not (move.sees(seen) and seen.inclinometer.usable):
        seen = yield move.command(seen)
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
    goal: tuple[FloatArray, float | None],
    on_pair: OnPair = lambda seen, found: False,
) -> Generator[Command, Observation, Driven]:
    """Drive along planned paths, taking pairs on the way; back off where something holds the rover.

    Before it sets off the head looks at the ground just before the rover, which it cannot see on
    the way after a turn.

    Args:
        seen: Latest observation.
        navigator: Localization, map and drive of the rover.
        arm: Chain of the arm, with the left camera as its tool.
        goal: Place (2,) [m] and heading [rad] in the frame; None for any heading.
        on_pair: Called with each pair taken on the way.
    """
    place, heading = goal
    reason = ""
    for _ in range(_MOST_STALLS):
        first = navigator.first_step(place, _GLANCE)
        if first is None:
            return Driven(seen, False, "there is no path on what is mapped")
        seen = yield from posed(seen, aim(arm, first, DRIVING))
        if on_pair(seen, navigator.take(seen, at_rest=True)):
            return Driven(seen, True)
        seen = yield from posed(seen, DRIVING)
        if on_pair(seen, navigator.take(seen, at_rest=True)):
            return Driven(seen, True)
        if not navigator.set_off(place, heading):
            return Driven(seen, False, "there is no path on what is mapped")
        while not (navigator.arrived or navigator.blocked):
            if navigator.is_due(seen):
                if on_pair(seen, navigator.take(seen, at_rest=False)):
                    navigator.halt()
                    return Driven(seen, True)
                navigator.correct()
            seen = yield navigator.step(seen)
        reason = navigator.blocked
        if not reason:
            navigator.halt()
            return Driven(seen, True)
        seen = yield from retreat(seen, navigator, held=True)
    return Driven(seen, False, f"stuck {_MOST_STALLS} times: {reason}")
