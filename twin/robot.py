"""The contract that every rover keeps, whether simulated, emulated or real.

Body frame of a rover: x to the right, y forward, z up (Thesis fig. 2-2), so that pitch, roll and
yaw are rotations about x, y and z.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
ARM_JOINTS = ("base_yaw", "shoulder", "elbow", "wrist")


class RobotError(RuntimeError):
    """A robot could not do what it was asked; its axes were zeroed before this was raised."""


class Validity(enum.Enum):
    """How far a channel may be believed."""

    MEASURED = "measured"
    PREDICTED = "predicted"
    STALE = "stale"
    MISSING = "missing"


class Lifecycle(enum.Enum):
    """States of a robot; INACTIVE reads but never drives."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    ERROR = "error"


class Channel(NamedTuple):
    """One sensor's latest sample.

    Attributes:
        value: The sample, in SI units, read-only; empty when missing.
        stamp: Robot time at which it was taken [s]; NaN when missing.
        validity: Whether it was measured, predicted, is stale or missing.
    """

    value: NDArray[np.generic]
    stamp: float
    validity: Validity

    @property
    def usable(self) -> bool:
        """True when the value was measured or predicted."""
        return self.validity in (Validity.MEASURED, Validity.PREDICTED)


MISSING = Channel(np.empty(0), float("nan"), Validity.MISSING)


class Observation(NamedTuple):
    """All that a controller ever learns of a robot.

    Attributes:
        time: Robot time [s].
        wheel_speeds: (4,) [rad/s], in the order of `WHEELS`, positive forward.
        centre_angle: (1,) roll of the rear half relative to the front half [rad].
        arm_angles: (4,) [rad], in the order of `ARM_JOINTS`.
        arm_rates: (4,) [rad/s].
        inclinometer: (2,) pitch about x and roll about y of the front half [rad].
        arm_base_wrench: (6,) force [N] and moment [N m] by the rover on the arm, in and about the
            arm base frame; at rest the force is the arm's weight, upward.
        accelerometer: (3,) specific force in the front half's frame [m/s^2].
        gyro: (3,) angular velocity in the front half's frame [rad/s].
        heading: (1,) yaw about the vertical [rad].
        stereo: (2, height, width) uint8, left and right grey images.
    """

    time: float
    wheel_speeds: Channel = MISSING
    centre_angle: Channel = MISSING
    arm_angles: Channel = MISSING
    arm_rates: Channel = MISSING
    inclinometer: Channel = MISSING
    arm_base_wrench: Channel = MISSING
    accelerometer: Channel = MISSING
    gyro: Channel = MISSING
    heading: Channel = MISSING
    stereo: Channel = MISSING


NOTHING = np.zeros(4)
"""Four zeros, read-only."""
NOTHING.flags.writeable = False


class WheelMode(enum.Enum):
    """What the four wheel numbers of a command mean."""

    DUTY = "duty"
    EFFORT = "effort"
    SPEED = "speed"


class ArmMode(enum.Enum):
    """What the four arm numbers of a command mean."""

    DUTY = "duty"
    EFFORT = "effort"
    RATE = "rate"
    POSITION = "position"


_DOUBLE = np.dtype(np.float64)


@dataclasses.dataclass(frozen=True, init=False)
class Command:
    """What a robot is asked to do until the next command.

    Attributes:
        wheels: (4,) duty in [-1, 1], effort [N m] or speed [rad/s], in the order of `WHEELS`.
        arm: (4,) duty in [-1, 1], effort [N m], rate [rad/s] or position [rad].
        wheel_mode: Meaning of `wheels`.
        arm_mode: Meaning of `arm`.
        arm_rates: (4,) feed-forward rates [rad/s], used with ``ArmMode.POSITION`` only.
    """

    wheels: FloatArray
    arm: FloatArray
    wheel_mode: WheelMode
    arm_mode: ArmMode
    arm_rates: FloatArray

    def __init__(
        self,
        wheels: FloatArray = NOTHING,
        arm: FloatArray = NOTHING,
        wheel_mode: WheelMode = WheelMode.DUTY,
        arm_mode: ArmMode = ArmMode.DUTY,
        arm_rates: FloatArray = NOTHING,
    ) -> None:
        """Refuse what no wire may ever carry.

        Raises:
            ValueError: If an array is not (4,) or holds a NaN or an infinity.
        """
        # Every tick makes two a robot; writing the fields so takes half of the time.
        fields = self.__dict__
        fields["wheels"] = _four("wheels", wheels)
        fields["arm"] = _four("arm", arm)
        fields["wheel_mode"], fields["arm_mode"] = wheel_mode, arm_mode
        fields["arm_rates"] = _four("arm_rates", arm_rates)


def _four(name: str, values: FloatArray) -> FloatArray:
    """Return four finite numbers, or refuse."""
    if values is NOTHING:
        return values
    # Four finite numbers have a finite square sum, unless they are absurdly large.
    if type(values) is np.ndarray and values.dtype is _DOUBLE and values.shape == (4,):
        if math.isfinite(values.dot(values)):
            return values
    values = np.asarray(values, dtype=float)
    if values.shape != (4,):
        raise ValueError(f"command {name}: expected 4 numbers, got shape {values.shape}")
    if not all(map(math.isfinite, values.tolist())):
        raise ValueError(f"command {name}: {values} is not finite; nothing was sent")
    return values


class Robot(Protocol):
    """Four methods; the same controller drives any implementation unchanged."""

    name: str

    @property
    def lifecycle(self) -> Lifecycle:
        """Current state."""
        ...

    def activate(self) -> None:
        """Go to ACTIVE, from INACTIVE or, explicitly, from ERROR.

        Raises:
            RobotError: If the robot cannot be driven.
        """
        ...

    def observe(self) -> Observation:
        """Return the latest observation; works in every state but UNCONFIGURED."""
        ...

    def command(self, command: Command) -> Command:
        """Drive, and return what was really applied, as duty, after limits.

        Raises:
            RobotError: If the robot is not ACTIVE.
        """
        ...

    def deactivate(self) -> None:
        """Zero all axes and go to INACTIVE."""
        ...


class Controller(Protocol):
    """Observations in, commands out; sees nothing else of the world."""

    def reset(self) -> None:
        """Forget everything learnt since construction."""
        ...

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return one command for each robot that it drives, by robot name."""
        ...
