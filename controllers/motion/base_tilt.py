"""Tilt of a base on its springs under the weight of its arm, predicted before it is measured.

The suspension that chapter 2 identifies, fed forward: what is fixed in the world moves in the
robot's frame when the arm reaches out, by stiffness and levers (Thesis eq. 2-1 at rest).
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.identification.pitch import NAMES, PitchEstimate
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from twin.description import RobotDescription

_LEVER = 0.03
"""Standard deviation of the levers by the drawing [m]. Assumption: where braked tyres roll."""
_CENTRE_JOINT = 1.0 / 3.0 / math.sqrt(3.0)
"""R.m.s. share by which eq. A-1 makes roll too stiff: none to a third, by the centre joint."""


@dataclasses.dataclass(frozen=True)
class TiltAxis:
    """Tilt of a base about an axis: inertia tilt'' + damping tilt' + stiffness tilt = moment.

    Attributes:
        inertia: Moment of inertia about the line that it tilts about [kg m^2].
        damping: Damping of the tilt [N m s/rad].
        stiffness: Stiffness of the tilt [N m/rad].
        lever: (2,) from that line to the arm's base [m]: forward and up for pitch, leftward and up
            for roll, (ry, rz) of `controllers.identification.pitch`.
        covariance: (3, 3) covariance of the two levers and the stiffness; zeros if they are known.
    """

    inertia: float
    damping: float
    stiffness: float
    lever: tuple[float, float]
    covariance: FloatArray = dataclasses.field(
        default_factory=lambda: np.zeros((3, 3)), compare=False
    )

    def __post_init__(self) -> None:
        """Refuse a base that does not swing back.

        Raises:
            ValueError: Naming the number and what is valid.
        """
        check_numbers("tilt model", self, "inertia", "damping", "stiffness")

    @classmethod
    def of(cls, estimate: PitchEstimate) -> "TiltAxis":
        """Return the axis as it was identified."""
        inertia, ry, rz, damping, stiffness = estimate.parameters.tolist()
        kept = [NAMES.index(name) for name in ("ry", "rz", "k_pitch")]
        return cls(inertia, damping, stiffness, (ry, rz), estimate.covariance[np.ix_(kept, kept)])


def roll_axis(pitch: TiltAxis, robot: RobotDescription) -> TiltAxis:
    """Return the roll of a base on the springs of its pitch, at half its track (eq. A-1).

    Args:
        pitch: Springs and inertia in pitch.
        robot: The rover as drawn.
    """
    ratio = (robot.half_track / robot.half_wheelbase) ** 2
    stiffness, scale = pitch.stiffness * ratio, np.diag([0.0, 1.0, ratio])
    own = np.diag(np.square([_LEVER, 0.0, _CENTRE_JOINT * stiffness]))
    covariance = scale @ pitch.covariance @ scale + own
    lever = (0.0, pitch.lever[1])
    return TiltAxis(pitch.inertia * ratio, pitch.damping * ratio, stiffness, lever, covariance)


def drawn_springs(robot: RobotDescription) -> tuple[TiltAxis, TiltAxis]:
    """Return pitch and roll of a rover by its drawing (Thesis eq. A-1).

    It turns about the line where its tyres meet the ground: braked wheels roll with the body. The
    springs leave the wheels on the ground, so that these add nothing by their distance from the
    middle.

    Args:
        robot: The rover as drawn, with springs and an arm.

    Raises:
        ValueError: If it has none, naming it.
    """
    if robot.arm is None:
        raise ValueError(f"robot {robot.name!r} has no arm: nothing tilts it")
    far = np.array([wheel.centre[1] for wheel in robot.wheels])
    masses, springs, dampers, sigmas = np.array(
        [(wheel.mass, wheel.spring, wheel.damper, wheel.spring_sigma) for wheel in robot.wheels]
    ).T
    body, mount = robot.body, robot.arm.transform_base_to_robot.translation
    height = body.centre[2] + robot.centre_height
    inertia = body.inertia[0, 0] + body.mass * height**2 - masses @ far**2
    lever = (float(mount[1]), float(mount[2]) + robot.centre_height)
    variance = float(np.square(sigmas * springs) @ far**4)  # Each spring by itself.
    covariance = np.diag([_LEVER**2, _LEVER**2, variance])
    pitch = TiltAxis(
        float(inertia), float(dampers @ far**2), float(springs @ far**2), lever, covariance
    )
    return pitch, roll_axis(pitch, robot)


def tilting_moments(pitch: TiltAxis, roll: TiltAxis) -> FloatArray:
    """Return (2, 6), the moments on the base about both axes per wrench on the arm [N m].

    Args:
        pitch: Tilt of the base about x.
        roll: Tilt of the base about y.
    """
    return -np.array(
        [
            [0.0, -pitch.lever[1], pitch.lever[0], 1.0, 0.0, 0.0],
            [roll.lever[1], 0.0, roll.lever[0], 0.0, 1.0, 0.0],
        ]
    )


def moment_variances(pitch: TiltAxis, roll: TiltAxis, change: ArrayLike) -> FloatArray:
    """Return (2,) variances of moments that would tilt as the errors of levers and stiffness do.

    Args:
        pitch: Tilt of the base about x.
        roll: Tilt of the base about y.
        change: (6,) of the wrench by the rover on its arm, in and about the arm's base [N, N m].
    """
    wrench = np.asarray(change, dtype=float)
    moments, (x, y, z) = tilting_moments(pitch, roll) @ wrench, wrench[:3]
    rows = (
        (pitch, np.array([-z, y, -moments[0] / pitch.stiffness])),
        (roll, np.array([-z, -x, -moments[1] / roll.stiffness])),
    )
    return np.array([row @ axis.covariance @ row for axis, row in rows])


class BaseTilt:
    """A base at rest on its springs, under an arm.

    Args:
        pitch: Tilt of the base about x, as identified.
        roll: Tilt of the base about y. By eq. A-1 it is up to a half stiffer than a rover whose
            centre joint is free.
        mount: (3,) the arm's base in the robot frame [m].
    """

    def __init__(self, pitch: TiltAxis, roll: TiltAxis, mount: ArrayLike) -> None:
        stiffness = np.array([[pitch.stiffness], [roll.stiffness]])
        self._give = tilting_moments(pitch, roll) / stiffness
        x, y, z = np.asarray(mount, dtype=float)
        # A point of each line about which the base tilts.
        self._pitch_line = np.array([0.0, y - pitch.lever[0], z - pitch.lever[1]])
        self._roll_line = np.array([x + roll.lever[0], 0.0, z - roll.lever[1]])

    def tilt(self, change: ArrayLike) -> FloatArray:
        """Return (2,) by how much pitch and roll change in the end [rad].

        Args:
            change: (6,) of the wrench by the rover on its arm, in and about the arm's base
                [N, N m].
        """
        return self._give @ np.asarray(change, dtype=float)

    def motion(self, tilt: ArrayLike) -> RigidTransform:
        """Return the transform from the tilted robot frame to the one before.

        Args:
            tilt: (2,) by how much pitch and roll have changed [rad].
        """
        pitch, roll = np.asarray(tilt, dtype=float)
        nod = _about(self._pitch_line, [pitch, 0.0, 0.0])
        return nod * _about(self._roll_line, [0.0, roll, 0.0])


def _about(point: FloatArray, turn: ArrayLike) -> RigidTransform:
    """Return a turn by a rotation vector (3,) [rad] about a point (3,) [m]."""
    rotation = Rotation.from_rotvec(turn)
    return RigidTransform.from_components(point - rotation.apply(point), rotation)
