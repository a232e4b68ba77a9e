"""The last way of a rover to a pose: straight on or back, and then along a curve that ends in it.

A skid-steered rover that turns in place scrubs, and slides on slopes; a curve that makes up for a
few centimetres aside turns it by a few tenths of a radian instead of by twice a quarter turn.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from controllers.motion.reckoned_drive import wrapped
from perception.geometry.arrays import FloatArray

_STRAIGHTS = (0.0, -0.2, 0.2, -0.4, 0.4, -0.6, 0.6, -0.8, 0.8)
"""How far the rover may drive straight first, negative for back [m]."""
_CURVED = 4.0  # Largest curvature of the curve [1/m].
_POINTS = 25  # Of the curve.
_PART, _LENGTH = 0.3, 0.3  # Worth of a part more, and of a metre more, as a turn [rad].
_NEAR = 0.01  # Distance that is no way [m].


class Leg(NamedTuple):
    """A part of the way.

    Attributes:
        path: (N, 2) points [m].
        heading: Heading at its end [rad].
        backwards: Whether the rover drives backwards.
    """

    path: FloatArray
    heading: float
    backwards: bool


IsFree = Callable[[Leg], bool]
"""Returns whether the rover may drive a part of the way."""


def docking(begin: ArrayLike, goal: ArrayLike, is_free: IsFree) -> list[Leg]:
    """Return the way that turns least, of one or two parts; none if there is none.

    Args:
        begin: (3,) x, y [m] and yaw [rad] of the rover.
        goal: (3,) the same where it is to be.
        is_free: Whether it may drive a part.
    """
    x, y, yaw = np.asarray(begin, dtype=float).tolist()
    place = np.array([x, y])
    best: tuple[float, list[Leg]] = math.inf, []
    for straight in _STRAIGHTS:
        turned = place + straight * _ahead(yaw)
        curve = curve_to([*turned, yaw], goal)
        legs = [] if straight == 0.0 else [Leg(np.array([place, turned]), yaw, straight < 0.0)]
        turn, curvature, length = _turns(curve)
        worth = turn + _PART * len(legs) + _LENGTH * (abs(straight) + length)
        if curvature > _CURVED or worth >= best[0]:
            continue
        legs.append(curve)
        if all(is_free(leg) for leg in legs):
            best = worth, legs
    return best[1]


def curve_to(begin: ArrayLike, goal: ArrayLike) -> Leg:
    """Return the cubic that leads from one pose to another, ahead or back.

    Args:
        begin: (3,) x, y [m] and yaw [rad] of the rover.
        goal: (3,) the same where it is to be.
    """
    (x, y, yaw), (*end, heading) = (
        np.asarray(pose, dtype=float).tolist() for pose in (begin, goal)
    )
    place = np.array([x, y])
    chord = end - place
    length = float(np.linalg.norm(chord))
    backwards = float(chord @ (_ahead(yaw) + _ahead(heading))) < 0.0
    along = -length if backwards else length
    t = np.linspace(0.0, 1.0, _POINTS)[:, None]
    path = (
        (2.0 * t**3 - 3.0 * t**2 + 1.0) * place
        + (t**3 - 2.0 * t**2 + t) * along * _ahead(yaw)
        + (3.0 * t**2 - 2.0 * t**3) * end
        + (t**3 - t**2) * along * _ahead(heading)
    )
    return Leg(path, heading, backwards)


def _turns(curve: Leg) -> tuple[float, float, float]:
    """Return the sum of a curve's turns [rad], its largest curvature [1/m] and its length [m]."""
    steps = np.diff(curve.path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    length = float(lengths.sum())
    if length < _NEAR:
        return 0.0, 0.0, length
    courses = np.unwrap(np.arctan2(-steps[:, 0], steps[:, 1]))
    end = curve.heading + (math.pi if curve.backwards else 0.0)
    turns = np.abs(np.append(np.diff(courses), wrapped(end - float(courses[-1]))))
    return float(turns.sum()), float((turns / lengths).max()), length


def _ahead(yaw: float) -> FloatArray:
    """Return the unit vector (2,) along a yaw [rad]."""
    return np.array([-math.sin(yaw), math.cos(yaw)])
