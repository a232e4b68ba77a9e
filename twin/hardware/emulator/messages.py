"""What an emulator and the program that steers it say to each other, as JSON."""

from typing import TypedDict


class PoseTable(TypedDict):
    """Pose of a body in the world.

    Attributes:
        rotation: Rotation matrix, rows of (3, 3).
        translation: Position (3,) [m].
    """

    rotation: list[list[float]]
    translation: list[float]


class RobotTruth(TypedDict):
    """What a person beside an emulated robot could measure.

    Attributes:
        arm_angles: Joint angles (4,) [rad].
        angles: Angles (8,) of wheels and joints [rad].
        codes: Duty codes (8,) that the boards put out.
        damage: Number of damaged exchanges with the motor boards, by kind of damage.
        camera: Pose of the left camera; None without cameras.
        bodies: Poses of "chassis", "card" and "slot", as far as they are in the scene.
    """

    arm_angles: list[float]
    angles: list[float]
    codes: list[int]
    damage: dict[str, int]
    camera: PoseTable | None
    bodies: dict[str, PoseTable]
