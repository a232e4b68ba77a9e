"""How far simulated robots and their sensors are from their drawings: sets by name."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from models.as_made import AsMade
from models.compose import RobotPlacement
from models.datasheets import (
    CLOCK,
    HARSH_CLOCK,
    HARSH_RADIO,
    HARSH_SENSOR_ERRORS,
    HARSH_TOLERANCES,
    RADIO,
    SENSOR_ERRORS,
    TOLERANCES,
    ClockSheet,
    SensorErrorSheet,
    Tolerances,
)
from twin.description import RobotDescription
from twin.hardware.emulator.modem import ModemConfig
from twin.optics.realism import CAMERA_SETS, IDEAL_CAMERA, CameraRealism, RealismName
from twin.sensors import DATASHEET, SensorSuite, with_errors

_MAKING, _ERRORS = 11, 12  # Streams of random numbers of a connection's seed.


@dataclasses.dataclass(frozen=True)
class Realism:
    """What is true of simulated robots and stands in no drawing.

    Attributes:
        suite: Sensors of simulated robots as their makers state them; boards have their own.
        sensor_errors: Largest errors of each robot's sensors; None for none.
        tolerances: Tolerances from which each robot is made; None for robots that are their
            drawings.
        cameras: Light, lenses and mountings of the stereo heads.
        modems: Delay, byte errors and losses of the radio between two robots.
        clock: How far each robot's clock is off; None for the world's time.
    """

    suite: SensorSuite = DATASHEET
    sensor_errors: SensorErrorSheet | None = None
    tolerances: Tolerances | None = None
    cameras: CameraRealism = IDEAL_CAMERA
    modems: ModemConfig = ModemConfig()
    clock: ClockSheet | None = None


REALISMS: Mapping[RealismName, Realism] = MappingProxyType(
    {
        "ideal": Realism(),
        "default": Realism(
            sensor_errors=SENSOR_ERRORS,
            tolerances=TOLERANCES,
            cameras=CAMERA_SETS["default"],
            modems=ModemConfig.of(RADIO),
            clock=CLOCK,
        ),
        "harsh": Realism(
            sensor_errors=HARSH_SENSOR_ERRORS,
            tolerances=HARSH_TOLERANCES,
            cameras=CAMERA_SETS["harsh"],
            modems=ModemConfig.of(HARSH_RADIO),
            clock=HARSH_CLOCK,
        ),
    }
)
"""Sets by name: robots and sensors as drawn, for verification; new and calibrated ones; old ones
in changing weather."""


def realism_of(named: RealismName | Realism) -> Realism:
    """Return a set by its name.

    Args:
        named: Name of a set, or a set of one's own.

    Raises:
        ValueError: If there is no such set.
    """
    if isinstance(named, Realism):
        return named
    if named not in REALISMS:
        raise ValueError(f"unknown realism {named!r}; available: {', '.join(REALISMS)}")
    return REALISMS[named]


def make_robots(
    robots: Sequence[RobotPlacement], named: RealismName | Realism, seed: int
) -> tuple[RobotPlacement, ...]:
    """Return robots as made, of which no two are alike; one seed makes the same robots again.

    A robot that is made already stays as it is, and so does one of a model of the user's own, whose
    tolerances nobody knows.

    Args:
        robots: Robots of a scene.
        named: Set with the tolerances.
        seed: Random seed of the connection, as `twin.connect.connect` takes it.
    """
    tolerances = realism_of(named).tolerances
    if tolerances is None:
        return tuple(robots)
    seeds = np.random.SeedSequence([seed, _MAKING]).generate_state(len(robots), np.uint64)
    return tuple(
        robot
        if robot.made or robot.model
        else dataclasses.replace(robot, made=AsMade(own, tolerances))
        for robot, own in zip(robots, seeds.tolist())
    )


def sensor_suites(
    suite: SensorSuite,
    errors: SensorErrorSheet | None,
    robots: Sequence[RobotDescription],
    seed: int,
) -> list[SensorSuite]:
    """Return each robot's sensors with the errors that they keep.

    Args:
        suite: Sensors as their makers state them, or those behind the robots' boards.
        errors: Largest errors; None for none.
        robots: Robots of a scene as drawn.
        seed: Random seed of the connection, as `twin.connect.connect` takes it.
    """
    if errors is None:
        return [suite] * len(robots)
    return [
        with_errors(suite, errors, robot, np.random.default_rng([seed, _ERRORS, index]))
        for index, robot in enumerate(robots)
    ]


def as_stated(robot: RobotDescription, named: RealismName | Realism) -> RobotDescription:
    """Return a robot as drawn that states how far robots of a set may be off, as makers do.

    Args:
        robot: Description of the robot.
        named: Set with the tolerances, never what was drawn for one robot.
    """
    chosen = realism_of(named)
    stated = with_cameras(robot, chosen.cameras)
    if stated.arm is None:
        return stated
    zero = chosen.sensor_errors.encoder_zero if chosen.sensor_errors else 0.0
    (least, most), length = (
        (chosen.tolerances.backlash, chosen.tolerances.length)
        if chosen.tolerances
        else ((0.0, 0.0), 0.0)
    )
    # All are uniform: zeros and lengths to either side, a gear's play between its limits.
    joints = [
        dataclasses.replace(
            joint,
            zero_sigma=math.hypot(zero, 0.25 * (most - least)) / math.sqrt(3.0),
            rest=0.25 * (least + most),
            place_sigma=length / math.sqrt(3.0),
        )
        for joint in stated.arm.joints
    ]
    return dataclasses.replace(stated, arm=dataclasses.replace(stated.arm, joints=tuple(joints)))


def with_cameras(robot: RobotDescription, cameras: CameraRealism) -> RobotDescription:
    """Return a robot as drawn whose stereo head states its calibration's errors and its exposure.

    Args:
        robot: Description of the robot; one without a head stays as it is.
        cameras: Deviations and exposure of such heads, never what was drawn for one of them.
    """
    if robot.head is None:
        return robot
    head = dataclasses.replace(
        robot.head, calibration=cameras.calibration, exposure=cameras.exposure
    )
    return dataclasses.replace(robot, head=head)
