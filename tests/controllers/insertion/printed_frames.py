"""Required motion by Euler angles of three points, as printed (thesis eqs 5-1 to 5-4): a reference.

It is exact where object and goal differ by a turn about the camera's axis, the planar case. Out of
it Euler angles cannot be subtracted, and those of eq. 5-1 are not even the factors of eq. 5-2, so
control uses the rigid transform from slot to card (`controllers.insertion.guidance`) instead.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class RequiredMotion:
    """Motion that brings the object to the goal, camera frame (thesis eq. 5-4).

    Attributes:
        translation: (3,) motion of the object's origin [m].
        angles: (3,) differences of the Euler angles about x, y and z [rad].
    """

    translation: FloatArray
    angles: FloatArray

    def moved(self, pose: RigidTransform) -> RigidTransform:
        """Return a pose after the motion: its origin shifted, its axes turned by the differences.

        Args:
            pose: The transform from the object to the camera.
        """
        return RigidTransform.from_components(
            pose.translation + self.translation, turn_of(self.angles) * pose.rotation
        )


def three_points(pose: RigidTransform, length: float = 1.0) -> FloatArray:
    """Return (3, 3) the points of a body that eq. 5-1 uses: origin, one along x, one along z.

    Args:
        pose: The transform from the body to the camera.
        length: Length of the axes [m].
    """
    return np.asarray(pose.apply(length * np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]])), dtype=float)


def printed_angles(points: ArrayLike) -> FloatArray:
    """Return the angles of eq. 5-1 to the letter.

    R_y is wrong off the camera's axis: its denominator subtracts two points' distances from that
    axis, where the distance between them is meant, and its sign is the other one. Zero over zero,
    of a body whose points are as far from the axis, gives NaN.

    Args:
        points: (3, 3) origin, one along x, one along z [m], camera frame.

    Returns:
        (3,) about x, y and z, each within a quarter turn [rad].

    Raises:
        ValueError: If the points are not three finite ones.
    """
    first, second, third = _checked(points)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.arctan(
            np.array(
                [
                    np.divide(third[1] - first[1], first[2] - third[2]),
                    np.divide(first[2] - second[2], np.hypot(*first[:2]) - np.hypot(*second[:2])),
                    np.divide(first[1] - second[1], first[0] - second[0]),
                ]
            )
        )


def euler_angles(points: ArrayLike) -> FloatArray:
    """Return the angles of eq. 5-1, mended: R_y by the distance between points, in all quadrants.

    Args:
        points: (3, 3) origin, one along x, one along z [m], camera frame.

    Returns:
        (3,) about x, y and z [rad].

    Raises:
        ValueError: If the points are not three finite ones.
    """
    first, second, third = _checked(points)
    ahead, out = second - first, third - first
    return np.array(
        [
            math.atan2(-out[1], out[2]),
            math.atan2(-ahead[2], math.hypot(ahead[0], ahead[1])),
            math.atan2(ahead[1], ahead[0]),
        ]
    )


def turn_of(angles: ArrayLike) -> Rotation:
    """Return R^x R^y R^z of Euler angles (3,) about x, y and z [rad] (thesis eq. 5-2)."""
    return Rotation.from_euler("XYZ", np.asarray(angles, dtype=float))


def pose_of(points: ArrayLike) -> RigidTransform:
    """Return the transform from a body to the camera by its three points (thesis eq. 5-2).

    Args:
        points: (3, 3) three points as for `euler_angles` [m], camera frame.
    """
    return RigidTransform.from_components(_checked(points)[0], turn_of(euler_angles(points)))


def base_in_camera(
    effector_in_camera: RigidTransform, effector_in_base: RigidTransform
) -> RigidTransform:
    """Return the transform from the arm's base to the camera, by eqs 5-2 and 5-3.

    Args:
        effector_in_camera: A_VT, the transform from the end effector to the camera.
        effector_in_base: A_TS, the transform from the end effector to the arm's base.
    """
    return effector_in_camera * effector_in_base.inv()


def required_motion(goal: ArrayLike, card: ArrayLike) -> RequiredMotion:
    """Return the motion of eq. 5-4, with the angles of `euler_angles`.

    Args:
        goal: (3, 3) the goal's three points [m], camera frame.
        card: (3, 3) the object's three points [m], camera frame.
    """
    turn = euler_angles(goal) - euler_angles(card)
    wrapped = np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi
    return RequiredMotion(_checked(goal)[0] - _checked(card)[0], wrapped)


def _checked(points: ArrayLike) -> FloatArray:
    rows = np.asarray(points, dtype=float)
    if rows.shape != (3, 3) or not np.all(np.isfinite(rows)):
        raise ValueError(f"points {points}: expected three of three finite coordinates")
    return rows
