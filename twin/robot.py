"""The contract of every rover, whether simulated, emulated or real.

Body frame of a rover: x to the right, y forward, z up (Thesis fig. 2-2), so that pitch, roll and
yaw are rotations about x, y and z.
"""

import dataclasses
import enum
import math
import weakref
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray, ImageArray
from twin.description import RobotDescription

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
ARM_JOINTS = ("base_yaw", "shoulder", "elbow", "wrist")
AXES = (*WHEELS, *ARM_JOINTS)
"""Motors of the thesis' rover; any robot's are in its description."""


class RobotError(RuntimeError):
    """A robot could not follow a request and was stopped, as far as its message says."""


class Validity(enum.Enum):
    """Trustworthiness of a channel."""

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
        value: Sample in SI units, read-only; empty when missing.
        stamp: Robot time of the sample [s]; NaN when missing.
        validity: Validity of the sample.
    """

    value: NDArray[np.generic]
    stamp: float
    validity: Validity

    @property
    def usable(self) -> bool:
        """True when the value was measured or predicted."""
        return self.validity in (Validity.MEASURED, Validity.PREDICTED)


class DeferredImages:
    """A stereo pair that is drawn or fetched when it is read first.

    The function that draws it is stored outside it, and lives as long as it does: no controller
    reaches the scene through an observation.

    Args:
        make: Function that returns the images (2, height, width) uint8, read-only; called until
            a `read` succeeds.
    """

    __slots__ = ("__weakref__", "_images")

    def __init__(self, make: Callable[[], ImageArray]) -> None:
        self._images: ImageArray | None = None
        _MAKERS[self] = make

    def read(self) -> ImageArray:
        """Return the images (2, height, width) uint8, left and right, read-only."""
        if self._images is None:
            self._images = _MAKERS[self]()
            del _MAKERS[self]
        return self._images


_MAKERS: weakref.WeakKeyDictionary[DeferredImages, Callable[[], ImageArray]] = (
    weakref.WeakKeyDictionary()
)


class ImageChannel(Channel):
    """A channel of images that are drawn or fetched when `value` is read first.

    Copies made by `_replace`, of the channel or of its observation, share the images and draw
    nothing; nor do `copy` and `deepcopy`. A pickle holds the images.
    """

    __slots__ = ()

    @classmethod
    def deferred(cls, make: Callable[[], ImageArray], stamp: float) -> "ImageChannel":
        """Return a measured pair.

        Args:
            make: See `DeferredImages`.
            stamp: Robot time of the pair [s].
        """
        return cls(DeferredImages(make), stamp, Validity.MEASURED)  # pyright: ignore[reportArgumentType]

    @property
    def drawn(self) -> bool:
        """Whether somebody has read the images."""
        held: DeferredImages | NDArray[np.generic] = self[0]
        return held not in _MAKERS if isinstance(held, DeferredImages) else True

    @property
    def value(self) -> NDArray[np.generic]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The images (2, height, width) uint8, left and right, read-only."""
        held: DeferredImages | NDArray[np.generic] = self[0]
        return held.read() if isinstance(held, DeferredImages) else held

    def __copy__(self) -> "ImageChannel":
        return self

    def __deepcopy__(self, memo: object) -> "ImageChannel":
        return self

    def __reduce__(self) -> tuple[type[Channel], tuple[object, ...]]:
        return Channel, (self.value, self.stamp, self.validity)


MISSING = Channel(np.empty(0), float("nan"), Validity.MISSING)


class Observation(NamedTuple):
    """All that a controller learns of a robot.

    Attributes:
        time: Robot time [s], by the robot's own clock, as are all stamps.
        wheel_speeds: (wheels,) [rad/s], in the order of the description, positive forward.
        centre_angle: (1,) roll of the rear half relative to the front half [rad].
        arm_angles: (joints,) [rad], in the order of the description.
        arm_rates: (joints,) [rad/s].
        inclinometer: (2,) pitch about x and roll about y of the front half [rad].
        arm_base_wrench: (6,) force [N] and moment [N m] by the rover on the arm, in and about the
            arm base frame; at rest the force is the arm's weight, upward.
        accelerometer: (3,) specific force in the front half's frame [m/s^2].
        gyro: (3,) angular velocity in the front half's frame [rad/s].
        heading: (1,) yaw about the vertical [rad].
        stereo: (2, height, width) uint8, left and right grey images; an `ImageChannel` where
            they are drawn or fetched when they are read.
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


NOTHING = np.empty(0)
"""Zeros for all wheels or joints of a robot, however many; read-only."""
NOTHING.flags.writeable = False


class WheelMode(enum.Enum):
    """Meaning of the wheel numbers of a command."""

    DUTY = "duty"
    EFFORT = "effort"
    SPEED = "speed"


class ArmMode(enum.Enum):
    """Meaning of the arm numbers of a command."""

    DUTY = "duty"
    EFFORT = "effort"
    RATE = "rate"
    POSITION = "position"


_ARRAY, _DOUBLE = np.ndarray, np.dtype(np.float64)
_WHEEL_DUTY, _ARM_DUTY = WheelMode.DUTY, ArmMode.DUTY


@dataclasses.dataclass(frozen=True, init=False)
class Command:
    """A request to a robot, which holds until the next command.

    A robot refuses more or fewer numbers than it has wheels or joints; `NOTHING` fits every robot.

    Attributes:
        wheels: (wheels,) duty in [-1, 1], effort [N m] or speed [rad/s], in the order of the
            robot's description.
        arm: (joints,) duty in [-1, 1], effort [N m], rate [rad/s] or position [rad], likewise.
        wheel_mode: Meaning of `wheels`.
        arm_mode: Meaning of `arm`.
        arm_rates: (joints,) feed-forward rates [rad/s], used with ``ArmMode.POSITION`` only.
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
        """Refuse what no robot could follow; the arrays are copied, and the copies read-only.

        Raises:
            ValueError: If an array is not one-dimensional or holds a NaN or an infinity, or a mode
                is none.
        """
        # Every tick makes one for each robot, with cold caches: as few steps as possible.
        if type(wheel_mode) is not WheelMode or type(arm_mode) is not ArmMode:
            _refuse_modes(wheel_mode, arm_mode)
        if _surely_finite(wheels, arm):
            wheels, arm = wheels.copy(), arm.copy()
            wheels.flags.writeable = arm.flags.writeable = False
        else:
            wheels, arm = _finite_row("wheels", wheels), _finite_row("arm", arm)
        if arm_rates is not NOTHING:
            arm_rates = _finite_row("arm_rates", arm_rates)
        fields = self.__dict__  # frozen otherwise
        fields["wheels"], fields["arm"], fields["arm_rates"] = wheels, arm, arm_rates
        fields["wheel_mode"], fields["arm_mode"] = wheel_mode, arm_mode


def applied_command(wheels: FloatArray, arm: FloatArray) -> Command:
    """Return the applied duty as a command, without the checks of a request.

    Args:
        wheels: (wheels,) finite duty in [-1, 1].
        arm: (joints,) finite duty in [-1, 1].
    """
    command = Command.__new__(Command)
    fields = command.__dict__
    fields["wheels"], fields["arm"] = wheels, arm
    fields["wheel_mode"], fields["arm_mode"] = _WHEEL_DUTY, _ARM_DUTY
    fields["arm_rates"] = NOTHING
    return command


def _surely_finite(wheels: FloatArray, arm: FloatArray) -> bool:
    """Return whether these are surely rows of finite numbers, in few steps."""
    try:
        if type(wheels) is _ARRAY and wheels.dtype is _DOUBLE:
            if type(arm) is _ARRAY and arm.dtype is _DOUBLE:
                # Finite numbers have a finite sum, unless they are absurdly large.
                return math.isfinite(sum(wheels.tolist(), sum(arm.tolist())))
    except TypeError:
        pass  # not one-dimensional
    return False


def _finite_row(name: str, values: FloatArray) -> FloatArray:
    """Return a read-only copy of finite numbers in a row, or refuse."""
    try:
        values = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"command {name}: {values!r} are no numbers") from None
    if values.ndim != 1:
        raise ValueError(f"command {name}: expected numbers in a row, got shape {values.shape}")
    if not all(map(math.isfinite, values.tolist())):
        raise ValueError(f"command {name}: {values} is not finite; nothing was sent")
    values.flags.writeable = False
    return values


def _refuse_modes(wheel_mode: object, arm_mode: object) -> None:
    for name, mode, kind in (
        ("wheel_mode", wheel_mode, WheelMode),
        ("arm_mode", arm_mode, ArmMode),
    ):
        if type(mode) is not kind:
            there = ", ".join(f"{kind.__name__}.{each.name}" for each in kind)
            raise ValueError(f"command {name}: {mode!r}; expected one of {there}")


class Robot(Protocol):
    """Four methods; the same controller drives any implementation unchanged.

    Attributes:
        name: Name of the robot.
        description: The robot as drawn; readable in every state.
    """

    name: str
    description: RobotDescription

    @property
    def fault(self) -> str:
        """Reason for the state ERROR; empty in the other states."""
        ...

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
        """Drive, and return the duty that was applied, after limits.

        Whatever is raised, the robot was stopped first, and is in ERROR if it was ACTIVE.

        Raises:
            RobotError: If the robot is not ACTIVE.
            ValueError: If the robot has another number of wheels or joints than the command.
        """
        ...

    def deactivate(self) -> None:
        """Zero all axes and go to INACTIVE.

        Raises:
            RobotError: If it is not known that all axes are zero; the robot is in ERROR.
        """
        ...


class Controller(Protocol):
    """Observations in, commands out, and nothing else of the world."""

    def reset(self) -> None:
        """Go back to the state after construction."""
        ...

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return one command for each robot that it drives, by robot name."""
        ...
