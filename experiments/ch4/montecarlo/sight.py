"""Visibility of markers in ``ch4-montecarlo``, and the variance of their sightings.

Positions are in the frame of `scenario`: the goal is the origin, the slot faces y.
"""

import math

import numba
import numpy as np

from controllers.placement.planar.sight import separated
from experiments.ch4.montecarlo.scenario import Scenario
from perception.geometry.arrays import FloatArray


@numba.njit(cache=True)
def focus(scenario: Scenario, gap: float, sigma: float) -> tuple[float, float]:
    """Return the distances that keep all of the gap in view and in focus at any direction.

    Args:
        scenario: Parameters of the scenario.
        gap: Gap between the markers [m].
        sigma: Standard deviation of the object's position [m].
    """
    reach = math.hypot(0.5 * gap + scenario.marker, scenario.marker) + 2.0 * sigma
    return max(
        scenario.near + reach, reach / math.sin(0.5 * scenario.field_of_view)
    ), scenario.far - reach


@numba.njit(cache=True)
def marker_side(scenario: Scenario, target: int) -> float:
    """Return x of a target's markers [m]; target 0 is the primary one, 1 the secondary."""
    x = 0.5 * scenario.width + scenario.ear
    return x if target == 0 else -x


@numba.njit(cache=True)
def object_corners(scenario: Scenario, gap: float, error: float) -> FloatArray:
    """Return the object's corners (4, 2) [m], with an error across the slot [m]."""
    low, high = error - 0.5 * scenario.width, error + 0.5 * scenario.width
    top = gap + scenario.length
    return np.array([[low, gap], [high, gap], [high, top], [low, top]])


@numba.njit(cache=True)
def sighting_variance(
    scenario: Scenario,
    corners: FloatArray,
    camera: FloatArray,
    target: int,
    gap: float,
    error: float,
) -> float:
    """Return the variance across the slot of what the camera really measures of a target [m^2].

    The camera points at the estimated middle of the gap.

    Args:
        scenario: Parameters of the scenario.
        corners: (N, `SIDES`, 2) of the obstacles [m].
        camera: (2,) position of the camera [m].
        target: Target to watch: 0 primary, 1 secondary.
        gap: Gap between the markers [m].
        error: Error of the object's position across the slot [m].

    Returns:
        The variance; 0 if a marker is not seen.
    """
    side = marker_side(scenario, target)
    ax, ay = side - camera[0], 0.5 * gap - camera[1]
    away = math.hypot(ax, ay)
    body = object_corners(scenario, gap, error)
    widest = math.cos(0.5 * scenario.field_of_view)
    variance = 0.0
    marker = np.empty((2, 2))
    for which in range(2):
        x, y = (side, 0.0) if which == 0 else (side + error, gap)
        dx, dy = x - camera[0], y - camera[1]
        distance = math.hypot(dx, dy)
        upright = -dy / distance
        if upright <= 0.0 or not scenario.near <= distance <= scenario.far:
            return 0.0
        for end in range(2):
            marker[end, 0], marker[end, 1] = x + (2 * end - 1) * scenario.marker, y
            ex, ey = marker[end, 0] - camera[0], y - camera[1]
            if ax * ex + ay * ey < widest * away * math.hypot(ex, ey):
                return 0.0
        if not separated(camera[0], camera[1], marker, body):
            return 0.0
        for obstacle in corners:
            if not separated(camera[0], camera[1], marker, obstacle):
                return 0.0
        across = scenario.pixel * distance / scenario.focal * dy / distance
        along = scenario.disparity * distance**2 / (scenario.focal * scenario.baseline)
        along *= dx / distance
        variance += (across**2 + along**2) / upright
    return variance
