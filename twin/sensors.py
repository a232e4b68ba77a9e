"""Specifications of a robot's sensors, channel by channel, and suites of them."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from models.datasheets import DEGREE, FORCE_TORQUE, INCLINOMETER, SensorErrorSheet
from twin.description import RobotDescription
from twin.robot import Observation

CHANNELS = Observation._fields[1:-1]
"""Names of the numeric channels of an `Observation`."""


def channel_widths(robot: RobotDescription) -> dict[str, int]:
    """Return how many values each numeric channel of a robot has, by name in contract order.

    Args:
        robot: Description of the robot; without wheels or joints their channels have no values.
    """
    wheels, joints = len(robot.wheels), len(robot.joint_names)
    return dict(zip(CHANNELS, (wheels, 1, joints, joints, 2, 6, 3, 3, 1), strict=True))


PerComponent = float | tuple[float, ...]
MOST_CROSSED = 6
"""Most components of a channel with cross-talk."""


def _is_square(rows: tuple[tuple[float, ...], ...]) -> bool:
    return len(rows) <= MOST_CROSSED and all(
        len(row) == len(rows) and all(map(math.isfinite, row)) for row in rows
    )


@dataclasses.dataclass(frozen=True)
class ChannelSpec:
    """Specification of one channel; the default is ideal.

    Numbers marked * may be one for all components or one for each.

    Attributes:
        noise: * Standard deviation of the white noise of each sample [unit of the channel].
        bias: * Constant offset [unit].
        scale: * Slope of the reading over the value.
        cross: (width, width) how much of each component (column), after the low pass, shows in
            each reading (row) beside its own, [unit over unit]; None for none. At most
            `MOST_CROSSED` components.
        drift: * Change of the offset from time zero until the sensor is warm [unit].
        warm_up: Time constant of that change [s].
        low: * Lower end of the range [unit].
        high: * Upper end of the range [unit].
        bits: Resolution of the converter over [low, high]; None for none.
        bandwidth: First-order low-pass corner [Hz]; None for none.
        rate: Samples per second [Hz], held between; None for every servo tick.
        delay: Time from sample to reading [s], rounded to whole servo ticks.
        dropout: Probability that a sample is lost, in [0, 1].
        stale_after: Age from which a sample is stale [s]; None for three sampling periods
            (at least 0.1 s) and the delay.
        connected: False for a sensor that the robot lacks.
        force_range: Apparent tilt at which the masses of an inclinometer stop, before the low pass
            [rad]: it refers to the specific force at its place. None for one that shows the
            orientation itself.
    """

    noise: PerComponent = 0.0
    bias: PerComponent = 0.0
    scale: PerComponent = 1.0
    cross: tuple[tuple[float, ...], ...] | None = None
    drift: PerComponent = 0.0
    warm_up: float = 600.0
    low: PerComponent = -math.inf
    high: PerComponent = math.inf
    bits: int | None = None
    bandwidth: float | None = None
    rate: float | None = None
    delay: float = 0.0
    dropout: float = 0.0
    stale_after: float | None = None
    connected: bool = True
    force_range: float | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that describe no sensor.

        Raises:
            ValueError: Naming the field and its value.
        """
        for name in ("bandwidth", "rate", "stale_after", "force_range"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ValueError(f"sensor {name} must be positive, got {value}")
        for name, holds, rule in (
            ("delay", 0.0 <= self.delay < math.inf, "finite and not negative"),
            ("dropout", 0.0 <= self.dropout <= 1.0, "a probability"),
            ("noise", np.all(np.asarray(self.noise) >= 0.0), "positive or zero"),
            ("bias", np.all(np.isfinite(self.bias)), "finite"),
            ("scale", np.all(np.isfinite(self.scale)), "finite"),
            ("drift", np.all(np.isfinite(self.drift)), "finite"),
            ("warm_up", 0.0 < self.warm_up < math.inf, "positive and finite"),
            ("cross", self.cross is None or _is_square(self.cross), "a square of finite numbers"),
        ):
            if not holds:
                raise ValueError(f"sensor {name} must be {rule}, got {getattr(self, name)}")
        if not np.all(np.asarray(self.low) < np.asarray(self.high)):
            raise ValueError(f"sensor range is empty: low {self.low}, high {self.high}")
        if self.bits is not None:
            if self.bits < 1:
                raise ValueError(f"sensor bits must be at least 1, got {self.bits}")
            if not (np.all(np.isfinite(self.low)) and np.all(np.isfinite(self.high))):
                raise ValueError("sensor bits need a finite range: give low and high")

    @property
    def age_limit(self) -> float:
        """Age from which a sample is stale [s]."""
        if self.stale_after is not None:
            return self.stale_after
        return max(0.1, 3.0 / self.rate if self.rate else 0.0) + self.delay


@dataclasses.dataclass(frozen=True)
class SensorSuite:
    """A named set of channel specifications; a channel that is not named is ideal.

    Attributes:
        name: Name of the suite, for messages and records.
        channels: Specification by channel name, among `CHANNELS`.
    """

    name: str
    channels: Mapping[str, ChannelSpec] = dataclasses.field(default_factory=dict[str, ChannelSpec])

    def __post_init__(self) -> None:
        """Refuse unknown channels.

        Raises:
            ValueError: Naming the unknown channel and listing the valid ones.
        """
        for channel in self.channels:
            check_channel(channel)

    def with_channel(self, channel: str, **changes: Any) -> "SensorSuite":
        """Return a copy in which one channel's specification has other fields.

        Args:
            channel: One of `CHANNELS`.
            **changes: Fields of `ChannelSpec`.

        Raises:
            ValueError: If the channel is unknown or the specification invalid.
        """
        check_channel(channel)
        spec = dataclasses.replace(self.channels.get(channel, ChannelSpec()), **changes)
        return SensorSuite(self.name, {**self.channels, channel: spec})


def check_channel(name: str) -> None:
    """Raise a ValueError that names an unknown channel and lists the valid ones."""
    if name not in CHANNELS:
        raise ValueError(f"unknown sensor {name!r}; valid ones are {', '.join(CHANNELS)}")


IDEAL = SensorSuite("ideal")
"""Every channel exact, undelayed, at every servo tick."""

_HALF_TURN = 180.0 * DEGREE

DATASHEET = SensorSuite(
    "datasheet",
    {
        # Assumption: a tachometer good to 0.02 rad/s, read with 12 bits over twice the top speed.
        "wheel_speeds": ChannelSpec(noise=0.02, low=-15.0, high=15.0, bits=12),
        # A potentiometer on a 10-bit converter over its 150 degrees: 0.145 degrees a count.
        "centre_angle": ChannelSpec(low=-75.0 * DEGREE, high=75.0 * DEGREE, bits=10),
        # Assumption: arm encoders of 2^14 counts a turn; rates from the same, 0.01 rad/s.
        "arm_angles": ChannelSpec(low=-_HALF_TURN, high=_HALF_TURN, bits=14),
        "arm_rates": ChannelSpec(noise=0.01),
        "inclinometer": ChannelSpec(
            noise=INCLINOMETER.noise,
            low=-INCLINOMETER.linear_range,
            high=INCLINOMETER.linear_range,
            force_range=INCLINOMETER.linear_range,
            bandwidth=INCLINOMETER.bandwidth,
            rate=25.0,  # Assumption: the analogue board is read every fourth tick
        ),
        "arm_base_wrench": ChannelSpec(
            noise=(FORCE_TORQUE.force_noise,) * 3 + (FORCE_TORQUE.torque_noise,) * 3
        ),
        # Assumption: small MEMS units; the thesis has these three in its simulated study only.
        "accelerometer": ChannelSpec(noise=0.05),
        "gyro": ChannelSpec(noise=0.005),
        "heading": ChannelSpec(noise=1.0 * DEGREE),
    },
)
"""Sensors as the makers and the thesis give them; assumptions are marked in the source."""


def with_errors(
    suite: SensorSuite, errors: SensorErrorSheet, robot: RobotDescription, rng: np.random.Generator
) -> SensorSuite:
    """Return a suite with the errors that one robot's sensors keep.

    Args:
        suite: Sensors as their makers state them, or those behind a robot's boards.
        errors: Largest errors.
        robot: Description of the robot, for its numbers of wheels and joints.
        rng: Random generator of the errors; what is drawn does not depend on the suite.
    """

    def within(most: PerComponent, count: int) -> tuple[float, ...]:
        return tuple((np.asarray(most) * rng.uniform(-1.0, 1.0, count)).tolist())

    def slopes(most: float, count: int) -> tuple[float, ...]:
        return tuple(1.0 + share for share in within(most, count))

    def cross(most: float, full_scale: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
        loads = np.array(full_scale)
        rows = most * rng.uniform(-1.0, 1.0, (len(loads), len(loads)))
        rows *= loads[:, None] / loads
        np.fill_diagonal(rows, 0.0)
        return tuple(tuple(row) for row in rows.tolist())

    loads = FORCE_TORQUE.full_scale
    zeros = tuple(errors.wrench_zero * load for load in loads)
    drifts = tuple(errors.wrench_drift * load for load in loads)
    changes: dict[str, dict[str, Any]] = {
        "wheel_speeds": {"scale": slopes(errors.tachometer_scale, len(robot.wheels))},
        "centre_angle": {
            "bias": within(errors.potentiometer_zero, 1),
            "scale": slopes(errors.potentiometer_scale, 1),
        },
        "inclinometer": {
            "bias": within(errors.inclinometer_zero, 2),
            "scale": slopes(errors.inclinometer_scale, 2),
            "cross": cross(errors.inclinometer_cross, (1.0, 1.0)),
        },
        "arm_base_wrench": {
            "bias": within(zeros, 6),
            "scale": slopes(errors.wrench_scale, 6),
            "cross": cross(errors.wrench_cross, loads),
            "drift": within(drifts, 6),
            "warm_up": errors.wrench_warm_up,
        },
        "accelerometer": {
            "bias": within(errors.accelerometer_bias, 3),
            "scale": slopes(errors.accelerometer_scale, 3),
        },
        "gyro": {"bias": within(errors.gyro_bias, 3), "scale": slopes(errors.gyro_scale, 3)},
        # Last: the others must not depend on whether the rover carries its arm.
        "arm_angles": {"bias": within(errors.encoder_zero, len(robot.joint_names))},
    }
    for channel, fields in changes.items():
        suite = suite.with_channel(channel, **fields)
    return suite
