"""Lenses and a crooked mount taken out of a pair, against OpenCV's projection of known points."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.pinhole import DistortedPinhole
from perception.stereo.matching import StereoError
from perception.stereo.rectification import Rectification

SIZE = (400, 360)
LEFT = DistortedPinhole(*SIZE, 500.0, 640.0, 198.0, 181.0, (-0.22, 0.05, 0.001, -0.0005, 0.0))
RIGHT = DistortedPinhole(*SIZE, 506.0, 645.0, 201.0, 178.0, (-0.18, 0.02, -0.0005, 0.001, 0.0))
CROOKED = RigidTransform.from_components(
    [-0.038, 0.001, -0.0008], Rotation.from_rotvec([0.01, -0.015, 0.02])
)
POINTS = np.array([[-0.1, -0.08, 0.6], [0.05, 0.06, 0.5], [0.12, -0.1, 0.8], [-0.05, 0.1, 0.7]])


def spots(lens: DistortedPinhole, points: np.ndarray) -> np.ndarray:
    """Return an image of round spots where a lens shows points, (N, 3) [m] in its frame."""
    points = np.ascontiguousarray(points)
    pixels, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), lens.matrix, np.array(lens.distortion)
    )
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    image = np.zeros(columns.shape)
    for u, v in pixels.reshape(-1, 2):
        image += 250.0 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * 2.0**2))
    return np.rint(image).clip(0, 255).astype(np.uint8)


def centroid(image: np.ndarray, near: np.ndarray) -> np.ndarray:
    u, v = np.rint(near).astype(int)
    rows, columns = np.mgrid[v - 10 : v + 11, u - 10 : u + 11]
    weight = image[v - 10 : v + 11, u - 10 : u + 11].astype(float)
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


def test_rectified_spots_stand_where_the_rectified_geometry_projects_them():
    rectification = Rectification(LEFT, RIGHT, CROOKED)
    raw = np.stack([spots(LEFT, POINTS), spots(RIGHT, CROOKED.apply(POINTS))])
    pair = rectification.apply(raw)
    seen = rectification.geometry.project(POINTS @ rectification.rotation_to_rectified.T)
    assert rectification.geometry.baseline == pytest.approx(np.linalg.norm(CROOKED.translation))
    for u, v, disparity in seen:
        left = centroid(pair[0], np.array([u, v]))
        right = centroid(pair[1], np.array([u - disparity, v]))
        np.testing.assert_allclose(left, [u, v], atol=0.1)
        np.testing.assert_allclose(right, [u - disparity, v], atol=0.1)


def test_aligned_cameras_without_distortion_are_left_as_they_are():
    straight = DistortedPinhole(*LEFT.intrinsics)
    mount = RigidTransform.from_translation([-0.038, 0.0, 0.0])
    rectification = Rectification(straight, straight, mount)
    pair = np.random.default_rng(0).integers(0, 256, (2, SIZE[1], SIZE[0]), dtype=np.uint8)
    inner = (slice(None), slice(2, -2), slice(2, -2))
    np.testing.assert_array_equal(rectification.apply(pair)[inner], pair[inner])
    assert rectification.valid[2:-2, 2:-2].all()


def test_what_no_camera_saw_is_black_and_marked():
    rectification = Rectification(LEFT, RIGHT, CROOKED)
    white = np.full((2, SIZE[1], SIZE[0]), 255, np.uint8)
    seen = rectification.apply(white)
    inner = cv2.erode(rectification.valid.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert (seen[:, inner] == 255).all()
    assert not rectification.valid.all()


def test_cameras_above_each_other_and_wrong_images_are_refused():
    with pytest.raises(StereoError, match="negative x"):
        Rectification(LEFT, RIGHT, RigidTransform.from_translation([0.0, -0.04, 0.0]))
    rectification = Rectification(LEFT, RIGHT, CROOKED)
    with pytest.raises(StereoError, match="needs"):
        rectification.apply(np.zeros((2, 10, 10), np.uint8))
