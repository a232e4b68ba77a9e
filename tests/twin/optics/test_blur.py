"""Widths of defocus and motion blur against the moments of a disc and of a line."""

import os
import subprocess
import sys

import numpy as np
import pytest

from twin.optics.blur import LARGEST_STREAK, Defocus, smear
from twin.optics.flow import BLOCK

HEIGHT, WIDTH = 6 * BLOCK - 3, 9 * BLOCK - 1
ASPECT = 871.25 / 677.34


def blocks(value):
    """One value for every block of the image."""
    shape = -(-HEIGHT // BLOCK), -(-WIDTH // BLOCK)
    return np.broadcast_to(np.asarray(value, float), (*shape, *np.shape(value))).copy()


def point():
    """A single bright pixel amid the image."""
    image = np.zeros((HEIGHT, WIDTH), np.float32)
    image[HEIGHT // 2, WIDTH // 2] = 1.0
    return image


def moments(image):
    """Sum, mean (column, row) and covariance (2, 2) of the light [px]."""
    grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)
    light = image / image.sum()
    mean = np.einsum("ij,ijk->k", light, grid)
    away = grid - mean
    return image.sum(), mean, np.einsum("ij,ijk,ijl->kl", light, away, away)


@pytest.mark.parametrize("diameter", [0.5, 1.0, 2.35, 6.0, 13.0])
def test_point_out_of_focus_is_a_disc(diameter):
    total, mean, covariance = moments(Defocus(ASPECT).apply(point(), blocks(diameter)))
    assert total == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(mean, [WIDTH // 2, HEIGHT // 2], atol=1e-3)
    # A disc's variance along any axis is its diameter squared over 16.
    expected = np.diag([diameter**2, (ASPECT * diameter) ** 2]) / 16.0
    np.testing.assert_allclose(covariance, expected, atol=0.01 * expected.max() + 1e-4)


@pytest.mark.parametrize("motion", [(0.6, 0.0), (3.0, 0.0), (0.0, 4.7), (5.0, 3.0), (-9.3, 7.1)])
def test_moving_point_is_a_line(motion):
    total, mean, covariance = moments(smear(point(), blocks(motion)))
    assert total == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(mean, [WIDTH // 2, HEIGHT // 2], atol=1e-3)
    # A line's covariance is the outer product of its ends' distance with itself over 12.
    np.testing.assert_allclose(covariance, np.outer(motion, motion) / 12.0, atol=2e-3)


def test_line_is_even_from_end_to_end():
    row = smear(point(), blocks((12.0, 0.0)))[HEIGHT // 2]
    middle = WIDTH // 2
    np.testing.assert_allclose(row[middle - 4 : middle + 5], 1.0 / 12.0, rtol=0.1)
    np.testing.assert_allclose(row[middle + 8 :], 0.0, atol=1e-6)
    np.testing.assert_allclose(row, row[::-1], atol=1e-6)


def test_evenly_lit_image_stays_as_it_is_up_to_its_edge():
    image = np.full((HEIGHT, WIDTH), 90.0, np.float32)
    for blurred in (Defocus(ASPECT).apply(image, blocks(5.0)), smear(image, blocks((4.0, -7.0)))):
        assert blurred.shape == image.shape
        np.testing.assert_allclose(blurred, 90.0, rtol=1e-4)


def test_blocks_are_blurred_each_by_its_own_width():
    image = np.random.default_rng(0).uniform(0.0, 255.0, (HEIGHT, WIDTH)).astype(np.float32)
    diameters, motion = blocks(0.0), blocks((0.0, 0.0))
    diameters[2, 3], motion[2, 3] = 4.0, (6.0, 2.0)
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[2 * BLOCK : 3 * BLOCK, 3 * BLOCK : 4 * BLOCK] = True
    lens = Defocus(ASPECT)
    for one, everywhere in (
        (lens.apply(image, diameters), lens.apply(image, blocks(4.0))),
        (smear(image, motion), smear(image, blocks((6.0, 2.0)))),
    ):
        np.testing.assert_allclose(one[inside], everywhere[inside], rtol=1e-5)
        np.testing.assert_allclose(one[~inside], image[~inside], rtol=1e-5)


def test_blur_that_nobody_could_see_is_left_out():
    image = point()
    assert Defocus(ASPECT).apply(image, blocks(0.29)) is image
    assert smear(image, blocks((0.2, 0.2))) is image


def test_longest_line_is_limited():
    _, _, covariance = moments(smear(point(), blocks((1e4, 0.0))))
    assert covariance[0, 0] == pytest.approx(LARGEST_STREAK**2 / 12.0, rel=1e-3)


WHOLE_STREAKS = """
import os
import subprocess
import sys

import numpy as np
from twin.optics.blur import Defocus, LARGEST_DISC, LARGEST_STREAK, smear
for length in (1.0, 2.0, 4.0, 9.99, LARGEST_STREAK, 100.0):
    for motion in ((length, 0.0), (0.0, length), (-length, length)):
        smear(np.ones((8, 8), np.float32), np.full((1, 1, 2), motion))
Defocus(1.3).apply(np.ones((8, 8), np.float32), np.full((1, 1), LARGEST_DISC))
"""


def test_blur_reads_nothing_beyond_its_kernel_and_its_image():
    # Compiled code reads whatever lies there; interpreted, NumPy refuses it.
    interpreted = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", WHOLE_STREAKS], env=interpreted, check=True, timeout=120)
