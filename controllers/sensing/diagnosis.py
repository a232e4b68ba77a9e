"""What changed on a rover, by name and size: a load on its base, softer springs, a worn tyre.

No two robots are alike, so a robot that differs from its drawing need not have changed. How far the
identifications of unchanged robots lie from their drawing was measured on simulated ones: a change
is named where an identification lies beyond these, in the direction in which the change moves it.
"""

import dataclasses
from collections.abc import Iterable

import numpy as np

from controllers.identification.pitch import search_coordinates
from controllers.motion.base_tilt import drawn_springs
from controllers.sensing.wheel_grip import WheelGrips
from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription

_HEAVIER, _SOFTER = np.eye(5)[0], -np.eye(5)[4]  # of log inertia and of log stiffness
_FEWEST = 3  # Wheels that one can be compared among.
_LOWEST_OF_FOUR = 1.0  # Deviations by which the lowest of four alike usually lags, about.
UNKNOWN = "unknown change"
"""Name of a change that is none of those that there may be."""
NOTICED = 2.6
"""Deviations from unchanged robots from which on a change is named: by chance one in 200 lies
beyond."""
GRIP_SIGMA = 0.09
"""Standard deviation of the logarithm of a wheel's measured friction, where all tyres are alike:
0.068 on 32 rovers as made on rough ground, and a third more for ground that is rougher."""


@dataclasses.dataclass(frozen=True)
class Unchanged:
    """How identifications of unchanged robots lie about their drawing.

    The numbers are of search coordinates: logarithms of inertia, damping and stiffness, and levers
    in m.

    Attributes:
        mean: (5,) of the identified less the drawn.
        covariance: (5, 5) of the same.
    """

    mean: FloatArray
    covariance: FloatArray


@dataclasses.dataclass(frozen=True)
class Finding:
    """A change that a robot may show.

    Attributes:
        name: ``load on the base``, ``soft springs`` or ``worn tyre WHEEL``.
        size: What was added to the inertia about the line of pitching [kg m^2]; or stiffness, or
            friction, over that of an unchanged robot.
        sigma: Standard deviation of the size, in its unit.
        deviations: How far the robot is from unchanged ones, in standard deviations.
    """

    name: str
    size: float
    sigma: float
    deviations: float


ROVER_UNCHANGED = Unchanged(
    np.array([-0.0746, -0.0099, -0.00211, 0.107, -0.0845]),
    np.array(
        [
            [0.00466, 1.02e-05, 3.96e-05, 0.00076, 0.000964],
            [1.02e-05, 0.000211, -3.35e-06, -2.73e-05, 0.000294],
            [3.96e-05, -3.35e-06, 4.44e-06, 0.000126, 4.65e-05],
            [0.00076, -2.73e-05, 0.000126, 0.0143, 0.00189],
            [0.000964, 0.000294, 4.65e-05, 0.00189, 0.01],
        ]
    ),
)
"""125 rovers as made, on rough ground; `ch2-diagnosis` writes the same of its own as a table."""


def beyond_drawing(parameters: FloatArray, robot: RobotDescription) -> FloatArray:
    """Return how far an identification is from the drawing (5,), as `Unchanged` counts it.

    Args:
        parameters: (5,) of an identification, in the order of
            `controllers.identification.pitch.NAMES`.
        robot: The robot as drawn.
    """
    pitch, _ = drawn_springs(robot)
    drawn = np.array([pitch.inertia, *pitch.lever, pitch.damping, pitch.stiffness])
    return search_coordinates(parameters) - search_coordinates(drawn)


def base_changes(
    parameters: FloatArray, robot: RobotDescription, unchanged: Unchanged = ROVER_UNCHANGED
) -> tuple[Finding, ...]:
    """Return how far each change of the base and its springs is from chance.

    Args:
        parameters: (5,) of an identification that can be believed, in the order of
            `controllers.identification.pitch.NAMES`.
        robot: The robot as drawn.
        unchanged: Identifications of unchanged robots.
    """
    off = beyond_drawing(parameters, robot) - unchanged.mean
    precision = np.linalg.inv(unchanged.covariance)

    def shift(along: FloatArray) -> tuple[float, float]:
        """Return the likeliest shift in a direction, and its standard deviation."""
        information = float(along @ precision @ along)
        return float(along @ precision @ off) / information, information**-0.5

    (heavier, heavier_sigma), (softer, softer_sigma) = shift(_HEAVIER), shift(_SOFTER)
    drawn = drawn_springs(robot)[0].inertia
    inertia, kept = drawn * float(np.exp(heavier)), float(np.exp(-softer))
    added = inertia - drawn
    return (
        Finding("load on the base", added, inertia * heavier_sigma, heavier / heavier_sigma),
        Finding("soft springs", kept, kept * softer_sigma, softer / softer_sigma),
    )


def tyre_changes(grips: WheelGrips, robot: RobotDescription) -> tuple[Finding, ...]:
    """Return how far the tyre with the least friction is from chance.

    Args:
        grips: Friction under each wheel.
        robot: The robot as drawn.

    Returns:
        One change; none if fewer than three wheels were measured.
    """
    logs = np.log(grips.friction)
    measured = np.flatnonzero(np.isfinite(logs))
    if len(measured) < _FEWEST:
        return ()
    worst = measured[np.argmin(logs[measured])]
    others = np.setdiff1d(measured, [worst])
    lag = float(np.mean(logs[others]) - logs[worst])
    sigma = GRIP_SIGMA * float(np.sqrt(1.0 + 1.0 / len(others)))
    kept = float(np.exp(-lag))
    name = f"worn tyre {robot.wheel_names[worst]}"
    return (Finding(name, kept, kept * sigma, lag / sigma - _LOWEST_OF_FOUR),)


def noticed(changes: Iterable[Finding]) -> Finding | None:
    """Return the change that is furthest beyond chance; None if none is."""
    beyond = [change for change in changes if change.deviations > NOTICED]
    return max(beyond, key=lambda change: change.deviations, default=None)
