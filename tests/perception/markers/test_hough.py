"""Each step of the thesis' detector does what its formula says."""

import cv2
import numpy as np
import pytest

from perception.markers import hough
from perception.markers.ellipses import MarkerExpectation, project_discs
from perception.markers.hough import (
    black_markers,
    circle_of_three,
    drop_specks,
    equalise,
    fewest_pixels,
    find_rims,
    hough_circles,
    low_pass,
    signed_laplacian,
    threshold_level,
)
from tests.perception.markers.marker_pictures import HEAD, RADIUS, picture

EXPECTED = MarkerExpectation(0.45, 0.55, count=2)
DISCS = np.array([[-0.05, 0.03, 0.5], [0.06, -0.02, 0.5]])


def two_markers():
    ellipses = project_discs(DISCS, [0, 0, -1], RADIUS, HEAD)
    return picture(ellipses, np.random.default_rng(0)), ellipses


def test_equalised_image_is_evenly_distributed():
    ramp = np.tile(np.arange(256, dtype=np.uint8) ** 2 // 255, (8, 1))
    even = equalise(ramp)
    assert even.max() == 1.0
    assert all(np.mean(even <= part) == pytest.approx(part) for part in np.unique(even))


def test_threshold_lets_the_markers_area_through():
    image, ellipses = two_markers()
    bright = (image >= threshold_level(image, HEAD, EXPECTED)).sum()
    area = np.pi * np.sqrt(ellipses[:, 2] * ellipses[:, 4]).sum()
    assert area < bright < 2.5 * area


def test_specks_that_go_are_those_that_opencv_counts_too_few_pixels_of():
    rng = np.random.default_rng(1)
    black = np.where(rng.random((80, 90)) < 0.3, 0, 255).astype(np.uint8)
    labels = np.array(cv2.connectedComponents(255 - black, connectivity=8)[1], dtype=np.intp)
    stays = (labels > 0) & (np.bincount(labels.ravel())[labels] >= 6)
    assert ((drop_specks(black, 6) == 0) == stays).all() and (black[stays] == 0).all()


def test_no_marker_is_dropped_as_a_speck():
    for slant in np.radians([0, 30, 65]):
        away = [0.0, np.sin(slant), -np.cos(slant)]
        ellipses = project_discs([[-0.05, 0.03, 1.2], [0.06, -0.02, 1.2]], away, RADIUS, HEAD)
        image = picture(ellipses, np.random.default_rng(0))
        expected = MarkerExpectation(0.8, 1.2, count=2)
        black = black_markers(image, threshold_level(image, HEAD, expected))
        kept = drop_specks(black, fewest_pixels(HEAD, expected))
        for column, row in np.round(ellipses[:, :2]).astype(int):
            assert kept[row, column] == 0


def test_laplacian_is_the_thesis_mask_about_mid_grey():
    dot = np.zeros((5, 5), np.uint8)
    dot[2, 2] = 100
    mask = (signed_laplacian(dot).astype(int) - 128)[1:4, 1:4] / 25
    assert mask.tolist() == [[0, 1, 0], [1, -4, 1], [0, 1, 0]]
    assert low_pass(dot)[1:4, 1:4].tolist() == [[11] * 3] * 3


def test_circle_of_three_points_is_theirs_in_every_position():
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, y, r = rng.uniform(-9, 9), rng.uniform(-9, 9), rng.uniform(1, 9)
        a = rng.uniform(0, 2 * np.pi, 3)
        points = np.column_stack([x + r * np.cos(a), y + r * np.sin(a)])
        assert circle_of_three(*points.ravel())[:3] == pytest.approx((x, y, r), rel=1e-5, abs=1e-4)
    # Two points in a row, where the slopes of eq. 5-8 divide by zero.
    assert circle_of_three(0, 0, 2, 0, 2, 2) == pytest.approx((1, 1, np.sqrt(2), np.pi / 2))
    assert np.isnan(circle_of_three(0, 0, 1, 1, 2, 2)[0])


def test_tracking_hough_transform_finds_the_rings_about_the_markers():
    image, ellipses = two_markers()
    level, fewest = threshold_level(image, HEAD, EXPECTED), fewest_pixels(HEAD, EXPECTED)
    circles = hough_circles(find_rims(image, level, fewest), HEAD, EXPECTED)
    for ellipse in ellipses:
        near = circles[np.hypot(*(circles[:, :2] - ellipse[:2]).T) < 1.5]
        near = near[np.argmax(near[:, 3])]
        assert near[3] > 0.75
        assert near[2] == pytest.approx(np.sqrt(ellipse[4]) + 1.5, abs=0.8)


def test_rings_drawn_by_opencv_are_found_in_square_pixels():
    square = type(HEAD)(200, 200, 800.0, 800.0, 99.5, 99.5, 0.038)
    rims = np.zeros((200, 200), np.uint8)
    truth = np.array([[50, 60], [140, 90], [90, 150]])
    for centre in truth:
        cv2.circle(rims, tuple(int(c) for c in centre), 7, 1)
    circles = hough_circles(rims > 0, square, MarkerExpectation(0.4, 0.6))
    full = circles[circles[:, 3] > 0.6]
    assert len(full) == 3
    # A rim of whole pixels: three of its points give a centre to about one of them.
    for centre in truth:
        assert np.hypot(*(full[:, :2] - centre).T).min() < 1.0


def test_a_crowd_of_points_does_not_overrun_a_chain(monkeypatch):
    """Compiled code does not look where it writes; interpreted it does."""
    monkeypatch.setattr(hough, "_chain", hough._chain.py_func)
    rows, columns = np.divmod(np.random.default_rng(0).permutation(144).astype(np.int32), 12)
    circles = hough._track.py_func(
        columns, rows, (12, 12), hough.CircleLimits(1.0, 3.0, 12.0, 16.5), 1
    )
    assert circles.shape[1] == 4
