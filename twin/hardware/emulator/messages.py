"""Messages between an emulator and the program that steers it: one line of JSON each.

The emulator begins with a `Started`. Every `Order` is answered by a `SceneTime`, a `Refusal` or, by
robot name, the `RobotTruth`.
"""

from typing import NotRequired, Required, TypedDict


class Ports(TypedDict):
    """Ports at which a host finds a robot's boards.

    Attributes:
        bus: Path of the motor boards' port.
        analogue: Path of the analogue board's port.
        wrench: UDP port of the force/torque sensor.
        stereo: Path of the file of stereo pairs; left out without cameras.
        radio: Path of the radio modem's port; left out without a radio.
    """

    bus: str
    analogue: str
    wrench: int
    stereo: NotRequired[str]
    radio: NotRequired[str]


class SceneTime(TypedDict):
    """Answer to an order that was carried out.

    Attributes:
        time: Time of the scene [s].
    """

    time: float


class Started(SceneTime):
    """First message of an emulator, when its boards have power.

    Attributes:
        ports: Ports by robot name.
        period: Servo tick [s].
    """

    ports: dict[str, Ports]
    period: float


class Refusal(TypedDict):
    """Answer to an order that cannot be carried out.

    Attributes:
        error: Reason.
    """

    error: str


class Order(TypedDict, total=False):
    """An order on the control line.

    Attributes:
        do: Either "tick", "run" (time passes by itself from now on), "state", or "fault" with the
            fields of a `faults.FaultEntry`.
    """

    do: Required[str]
    robot: str
    time: float
    kind: str
    duration: float
    address: int


class PoseTable(TypedDict):
    """Pose of a body in the world.

    Attributes:
        rotation: Rotation matrix, rows of (3, 3).
        translation: Position (3,) [m].
    """

    rotation: list[list[float]]
    translation: list[float]


class RobotTruth(TypedDict):
    """True state of an emulated robot, as a person beside it could measure it.

    Attributes:
        arm_angles: Joint angles (4,) as a jig gives them for homing, with its error [rad].
        angles: True angles (8,) of wheels and joints [rad].
        codes: Duty codes (8,) that drive the motors.
        driven: Latest time at which each motor board drove a motor [s], by address (as "0x80"); -1
            for never.
        time: Time of the scene [s].
        damage: Number of damaged exchanges with the motor boards, by kind of damage.
        camera: Pose of the left camera in the world; None without cameras.
        bodies: Poses of "chassis", "card" and "slot" in the world, as far as the scene has them.
    """

    arm_angles: list[float]
    angles: list[float]
    codes: list[int]
    driven: dict[str, float]
    time: float
    damage: dict[str, int]
    camera: PoseTable | None
    bodies: dict[str, PoseTable]
