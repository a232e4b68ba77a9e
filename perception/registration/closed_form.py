"""Camera motion from triangulated points, without iteration: eq. 3-18, 3-19, Kabsch, and PnP.

All take the fiducials as seen before and after the motion, and return the pose of the camera after
the motion in the frame before it, with its covariance.
"""

import cv2
import numpy as np

from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import cross_matrix, point_jacobian
from perception.registration.checks import FEWEST, RegistrationError
from perception.registration.reprojection import Pose, Sighting

LARGEST_CONDITION = 1e8
"""Of (r r^T): beyond it the points are taken to lie in one plane."""


def nearest_rotation(matrices: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) nearest to matrices (..., 3, 3), by SVD.

    A least-squares or averaged R is no rotation: its determinant falls to 0.98 at a scatter of 5
    degrees and 0.68 at 20.
    """
    left, _, right = np.linalg.svd(matrices)
    sign = np.linalg.det(left @ right)
    left = left * np.stack([np.ones_like(sign), np.ones_like(sign), sign], axis=-1)[..., None, :]
    return left @ right


def linear(before: Sighting, after: Sighting) -> tuple[Pose, FloatArray]:
    """Solve eq. 3-17 for twelve independent elements: g = u r^T (r r^T)^-1.

    Eq. 3-18 prints u (r^T r)^-1 r^T, which is singular for more than four points. R is projected
    on a rotation; the translation is what the solution holds, as the thesis takes it.

    Args:
        before: N fiducials before the motion, which give the points r.
        after: Sighting of these fiducials after the motion, which give the points u.

    Returns:
        The pose and its (6, 6) covariance, to first order.

    Raises:
        RegistrationError: If all points lie in one plane.
    """
    weights = _linear_weights(before.points())
    matrix = after.points().T @ weights
    rotation = nearest_rotation(matrix[:, :3])
    # To first order the projection keeps the antisymmetric part of R^T dA.
    carried = matrix[:, :3] @ before.point_covariances() @ matrix[:, :3].T
    residual = after.point_covariances() + carried
    turn = 0.5 * rotation @ cross_matrix(weights[:, :3]) @ rotation.T
    by_point = np.concatenate([turn, weights[:, 3, None, None] * np.eye(3)], axis=1)
    covariance = np.sum(by_point @ residual @ np.swapaxes(by_point, -1, -2), axis=0)
    return _inverted(rotation, matrix[:, 3], covariance)


def _linear_weights(before: FloatArray) -> FloatArray:
    """Return (N, 4), r^T (r r^T)^-1 of the homogeneous points r."""
    homogeneous = np.column_stack([before, np.ones(len(before))])
    normal = homogeneous.T @ homogeneous
    scale = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * np.outer(scale, scale)
    if np.linalg.cond(scaled) > LARGEST_CONDITION:
        raise RegistrationError("eq. 3-18 needs four points that are not in one plane")
    return (homogeneous * scale) @ np.linalg.inv(scaled) * scale


def recursive(before: Sighting, after: Sighting) -> tuple[Pose, FloatArray]:
    """Average the solutions of eq. 3-18 from the first 4, 5, ... N points, by eq. 3-19.

    As printed the covariance is biased low; with (x - mean_i)(x - mean_{i+1})^T it is not. It is
    the scatter of the solutions, as the thesis has it, which share points: it is not calibrated.
    The mean of R is projected on a rotation.

    Args:
        before: N fiducials before the motion.
        after: Sighting of these fiducials after the motion.

    Returns:
        The pose and the (6, 6) scatter.

    Raises:
        RegistrationError: If no set of points leaves its plane.
    """
    mean, scatter, count = np.zeros(12), np.zeros((12, 12)), 0
    first, second = before.points(), after.points()
    for points in range(FEWEST, len(first) + 1):
        try:
            weights = _linear_weights(first[:points])
        except RegistrationError:
            continue
        matrix = second[:points].T @ weights
        sample = np.concatenate([nearest_rotation(matrix[:, :3]).ravel(), matrix[:, 3]])
        nearer = (count * mean + sample) / (count + 1)
        scatter = (count * scatter + np.outer(sample - mean, sample - nearer)) / (count + 1)
        mean, count = nearer, count + 1
    if count == 0:
        raise RegistrationError("eq. 3-19 needs four points that are not in one plane")
    rotation = nearest_rotation(mean[:9].reshape(3, 3))
    # Rotation vector of dR R^T, from its antisymmetric part.
    turn = 0.5 * (cross_matrix(np.eye(3)) @ rotation).reshape(3, 9)
    by_element = np.zeros((6, 12))
    by_element[:3, :9], by_element[3:, 9:] = turn, np.eye(3)
    return _inverted(rotation, mean[9:], by_element @ scatter @ by_element.T)


def kabsch_pose(before: FloatArray, after: FloatArray, weights: FloatArray) -> Pose:
    """Return the rigid motion of least squared distance, for one set or many.

    Args:
        before: (..., N, 3) points [m].
        after: (..., N, 3) points [m].
        weights: (..., N) weights of the squared distances.
    """
    share = (weights / weights.sum(axis=-1, keepdims=True))[..., None]
    middle, other = np.sum(share * before, axis=-2), np.sum(share * after, axis=-2)
    crossed = np.swapaxes(before - middle[..., None, :], -1, -2) @ (
        share * (after - other[..., None, :])
    )
    rotation = nearest_rotation(crossed)
    return Pose(rotation, middle - (rotation @ other[..., None])[..., 0])


def kabsch(before: Sighting, after: Sighting) -> tuple[Pose, FloatArray]:
    """Fit a rigid motion to points, weighted by the trace of their covariances.

    Args:
        before: N fiducials before the motion.
        after: Sighting of these fiducials after the motion.

    Returns:
        The pose and its (6, 6) covariance, to first order.
    """
    first, second = before.point_covariances(), after.point_covariances()
    weights = 1.0 / np.maximum(np.trace(first + second, axis1=-2, axis2=-1), 1e-30)
    pose = kabsch_pose(before.points(), after.points(), weights)
    by_pose = point_jacobian(before.points())
    residual = first + pose.rotation @ second @ pose.rotation.T
    return pose, _sandwich(by_pose, weights[:, None, None] * np.eye(3), residual)


def pnp(before: Sighting, after: Sighting) -> tuple[Pose, FloatArray]:
    """Fit the points before to the left image after, disparity unused (SQPnP, refined).

    Args:
        before: N fiducials before the motion.
        after: Sighting of these fiducials after the motion.

    Returns:
        The pose and its (6, 6) covariance, to first order.

    Raises:
        RegistrationError: If OpenCV finds none.
    """
    camera, points = after.geometry.matrix, before.points()
    pixels = np.ascontiguousarray(after.image_points[:, :2])
    try:
        found, turn, shift = cv2.solvePnP(points, pixels, camera, None, flags=cv2.SOLVEPNP_SQPNP)
        if not found:
            raise RegistrationError("PnP found no pose")
        turn, shift = cv2.solvePnPRefineLM(points, pixels, camera, None, turn, shift)
    except cv2.error as error:
        raise RegistrationError(f"PnP failed: {error.err}") from error
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=float).T
    pose = Pose(rotation, -rotation @ np.asarray(shift, dtype=float).ravel())
    by_place = after.geometry.projection_jacobian((points - pose.translation) @ rotation)[:, :2]
    by_place = by_place @ rotation.T
    noise = by_place @ before.point_covariances() @ np.swapaxes(by_place, -1, -2)
    noise = noise + after.noise()[:, :2, :2]
    return pose, _sandwich(-by_place @ point_jacobian(points), np.eye(2), noise)


def _sandwich(by_pose: FloatArray, weights: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the covariance of a least-squares pose whose weights are not the noise's."""
    weighted = np.swapaxes(by_pose, -1, -2) @ weights
    normal = np.sum(weighted @ by_pose, axis=0)
    inverse = np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=float)
    middle = np.sum(weighted @ noise @ np.swapaxes(weighted, -1, -2), axis=0)
    return inverse @ middle @ inverse


def _inverted(
    rotation: FloatArray, shift: FloatArray, covariance: FloatArray
) -> tuple[Pose, FloatArray]:
    """Invert (R, X), whose covariance is of dR R^T and dX, to a pose and that of its xi."""
    # xi of (R, X) has the translation dX - w x X; the inverse's is -Ad of it, in which X cancels.
    turn = np.kron(np.eye(2), rotation.T)
    return Pose(rotation.T, -rotation.T @ shift), turn @ covariance @ turn.T
