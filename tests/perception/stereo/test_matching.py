"""Disparities, points and their covariance, on pictures whose disparities are known."""

import os
import subprocess
import sys

import cv2
import numpy as np
import pytest

from perception.stereo.matching import StereoError, StereoMatcher, StereoMatcherConfig
from perception.stereo.refinement import refine
from tests.perception.stereo.stereo_pictures import SMALL, pattern, plane_pair

CONFIG = StereoMatcherConfig(nearest=0.25, farthest=4.0)
MATCHER = StereoMatcher(SMALL, CONFIG)
PLANES = [(20.0, 0.0, 0.0), (20.37, 0.0, 0.0), (13.81, 0.03, -0.02), (24.2, -0.02, 0.11)]


def errors_of(pair, truth, matcher=MATCHER):
    found = matcher.match(pair)
    columns, rows = found.pixels.astype(int).T
    return found, found.disparities - truth[rows, columns]


@pytest.mark.parametrize("plane", PLANES)
def test_disparity_of_a_plane_is_found_to_a_hundredth_of_a_pixel(plane):
    found, errors = errors_of(*plane_pair(*plane))
    assert len(found) > 1200  # of 67 x 54 places; a disparity's width has no partner
    assert abs(np.median(errors)) < 0.01
    assert np.std(errors) < 0.02


@pytest.mark.parametrize("brighter", [-15, 12])
def test_unequal_exposure_moves_no_disparity(brighter):
    images, truth = plane_pair(*PLANES[3])
    images[1] = np.clip(images[1].astype(int) + brighter, 0, 255)
    found, errors = errors_of(images, truth)
    assert len(found) > 1000
    assert abs(np.median(errors)) < 0.01
    assert np.std(errors) < 0.03


def test_refinement_removes_the_bias_and_scatter_of_block_matching_on_a_slope():
    pair, truth = plane_pair(24.2, -0.02, 0.11, noise=1.3)
    coarse = MATCHER.disparities(pair) - truth
    found, errors = errors_of(pair, truth)
    assert np.std(errors) < 0.5 * np.nanstd(coarse)


@pytest.mark.parametrize("plane", PLANES)
def test_errors_are_as_large_as_predicted(plane):
    pair, truth = plane_pair(*plane, noise=1.3)
    found, errors = errors_of(pair, truth)
    columns, rows = found.pixels.astype(int).T
    depth = SMALL.fx * SMALL.baseline / truth[rows, columns]
    squares = (found.points[:, 2] - depth) ** 2 / found.covariances[:, 2, 2]
    assert 0.3 < np.mean(squares) < 2.0
    assert np.mean(squares > 25.0) < 0.01
    np.testing.assert_allclose(squares, (errors / found.sigmas) ** 2, rtol=0.2, atol=0.05)


def test_points_lie_on_the_rays_of_their_pixels():
    pair, _ = plane_pair(20.0)
    found = MATCHER.match(pair)
    seen = SMALL.project(found.points)
    np.testing.assert_allclose(seen[:, :2], found.pixels, atol=1e-9)
    np.testing.assert_allclose(seen[:, 2], found.disparities, rtol=1e-12)
    columns, rows = found.pixels.astype(int).T


def test_fit_predicts_the_scatter_over_repeated_noise_up_to_the_noise_factor():
    clean = plane_pair(17.3, 0.01, 0.05)[0].astype(float)
    pixels = np.array([[u, v] for u in range(60, 190, 16) for v in range(20, 150, 16)])
    starts = np.tile([17.3, 0.01, 0.05], (len(pixels), 1))
    starts[:, 0] += 0.01 * (pixels[:, 0] - SMALL.cx) + 0.05 * (pixels[:, 1] - SMALL.cy)
    rng = np.random.default_rng(0)
    draws, sigmas = [], []
    for _ in range(60):
        left, right = (
            (image + 2.0 * rng.standard_normal(image.shape)).astype(np.float32) for image in clean
        )
        fit = refine(left, right, pixels, starts, 5)
        draws.append(fit.disparities)
        sigmas.append(fit.sigmas)
    assert np.mean(np.isnan(draws)) < 0.02  # steps that never settle
    ratio = np.nanstd(draws, axis=0) / np.nanmean(sigmas, axis=0)
    # The fit takes the interpolated pixels' noise as independent; `noise_factor` makes up for it.
    assert 0.9 < np.median(ratio) < StereoMatcherConfig().noise_factor


def test_fit_finds_the_slopes_of_the_plane():
    pair, _ = plane_pair(17.3, 0.02, -0.06)
    pixels = np.array([[100, 80], [150, 40]])
    starts = np.array([[17.3, 0.0, 0.0], [18.0 + 2.6, 0.0, 0.0]])
    fit = refine(*pair.astype(np.float32), pixels, starts, 9)
    np.testing.assert_allclose(fit.slopes, [[0.02, -0.06]] * 2, atol=0.005)


def test_windows_that_leave_the_image_have_no_fit():
    pair, _ = plane_pair(20.0)
    pixels = np.array([[2, 80], [100, 158], [12, 80]])
    fit = refine(*pair.astype(np.float32), pixels, np.tile([20.0, 0, 0], (3, 1)), 5)
    assert np.isnan(fit.disparities).all()


@pytest.mark.parametrize("level", [0, 128, 255])
@pytest.mark.parametrize("noise", [0.0, 1.3])
def test_black_and_untextured_pictures_show_nothing(level, noise):
    rng = np.random.default_rng(0)
    pair = level + noise * rng.standard_normal((2, SMALL.height, SMALL.width))
    found = MATCHER.match(np.clip(np.rint(pair), 0, 255).astype(np.uint8))
    assert len(found) == 0
    assert found.points.shape == (0, 3) and found.covariances.shape == (0, 3, 3)


def test_pictures_that_have_nothing_to_do_with_each_other_show_nothing():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (2, SMALL.height, SMALL.width), dtype=np.uint8)
    assert len(MATCHER.match(noise)) == 0


def test_nothing_is_seen_on_the_blank_half_of_a_wall():
    pair, truth = plane_pair(20.0, noise=1.3)
    blank = 128 + 1.3 * np.random.default_rng(2).standard_normal((2, 80, SMALL.width))
    pair[:, 80:] = np.rint(blank)
    found, errors = errors_of(pair, truth)
    assert len(found) > 400
    assert found.pixels[:, 1].max() <= 80 + CONFIG.window // 2
    assert np.abs(errors).max() < 0.3


def test_a_step_of_depth_leaves_no_false_points():
    """A near square before a far wall: what is hidden from one camera must not be made up."""
    far, near = 9.0, 24.0
    pair, truth = plane_pair(far, noise=0.0)
    columns, rows = np.meshgrid(np.arange(SMALL.width), np.arange(SMALL.height))
    inside = (np.abs(columns - 120) < 35) & (np.abs(rows - 80) < 40)
    own = np.rint(pattern(columns, rows, seed=7)).clip(0, 255)
    truth = np.where(inside, near, truth)
    pair[0][inside] = own[inside]
    pair[1][rows[inside], columns[inside] - int(near)] = own[inside]
    found, errors = errors_of(pair, truth)
    assert np.mean(np.abs(errors) > 1.0) < 0.002
    assert np.mean(np.abs(errors) > 4.0 * found.sigmas) < 0.03
    columns, rows = found.pixels.astype(int).T
    assert inside[rows, columns].sum() > 200 and (~inside[rows, columns]).sum() > 600


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        (np.zeros((0,), np.uint8), r"\(0,\) uint8, needs \(2, 160, 200\) uint8"),
        (np.zeros((2, 160, 200)), "float64, needs"),
        (np.zeros((2, 200, 160), np.uint8), r"\(2, 200, 160\) uint8, needs"),
        (np.zeros((2, 160, 200, 3), np.uint8), "needs"),
        ([np.zeros((160, 200), np.uint8), np.zeros((150, 200), np.uint8)], r"\(150, 200\)"),
    ],
)
def test_what_is_no_pair_is_refused_with_what_is_needed(pair, message):
    for call in (MATCHER.match, MATCHER.disparities):
        with pytest.raises(StereoError, match=message):
            call(pair)


@pytest.mark.parametrize(
    "change",
    [
        {"nearest": 0.0},
        {"nearest": 5.0},
        {"block": 6},
        {"window": 3},
        {"stride": 0},
        {"neighbours": 9},
        {"most_sigma": 0.0},
        {"smoothing": -1.0},
    ],
)
def test_impossible_configuration_is_refused_by_name(change):
    with pytest.raises(StereoError, match=next(iter(change))):
        StereoMatcherConfig(**change)


def test_search_wider_than_the_picture_is_refused():
    with pytest.raises(StereoError, match="nearest: got 0.05 m"):
        StereoMatcher(SMALL, StereoMatcherConfig(nearest=0.05))


def test_same_pair_gives_the_same_points():
    pair, _ = plane_pair(20.0, noise=1.3)
    np.testing.assert_array_equal(MATCHER.match(pair).points, MATCHER.match(pair).points)
    smooth = cv2.GaussianBlur(pair[0], (0, 0), 2.0)
    assert len(MATCHER.match(np.stack([smooth, smooth]))) == 0  # everything at infinity


MATCHED = """
import hashlib
from tests.perception.stereo.test_matching import MATCHER, PLANES, plane_pair
print(hashlib.sha256(MATCHER.match(plane_pair(*PLANES[3])[0]).points.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_points_are_the_same_bits_whether_just_compiled_or_from_the_cache(tmp_path):
    own_cache = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    words = [sys.executable, "-c", MATCHED]
    compiled, cached = (
        subprocess.run(words, env=own_cache, check=True, capture_output=True, timeout=300).stdout
        for _ in range(2)
    )
    assert len(compiled) == 65 and compiled == cached
