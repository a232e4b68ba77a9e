"""What spoils the markers' images, against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from experiments.bench.image_conditions import (
    BLUR,
    CLEAN,
    CONDITIONS,
    DEFOCUS,
    LINEARISED,
    NOISE,
    OVEREXPOSED,
    UNDEREXPOSED,
    blurred,
    take,
)
from models.datasheets import CAMERA


def moments(image):
    """Sum, mean (2,) and covariance (2, 2) of an image's grey levels [px]."""
    rows, columns = np.indices(image.shape)
    points = np.stack([columns.ravel(), rows.ravel()])
    weights = image.ravel() / image.sum()
    mean = points @ weights
    return image.sum(), mean, (points - mean[:, None]) * weights @ (points - mean[:, None]).T


def spot():
    """A smooth spot between pixels, which no blur between pixels aliases."""
    rows, columns = np.indices((90, 80))
    return 200.0 * np.exp(-((columns - 40.3) ** 2 + (rows - 44.6) ** 2) / (2.0 * 3.0**2))


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
def test_motion_has_the_second_moment_of_a_uniform_line(angle):
    total, mean, before = moments(spot())
    image = blurred(spot()[None], BLUR, angle)[0]
    after_total, after_mean, after = moments(image)
    along = np.array([math.cos(angle), math.sin(angle)])
    assert after_total == pytest.approx(total, rel=1e-9)
    assert after_mean == pytest.approx(mean, abs=1e-6)
    assert after - before == pytest.approx(BLUR.motion**2 / 12.0 * np.outer(along, along), abs=1e-5)


def test_defocus_has_the_second_moments_of_a_disc_that_is_round_on_the_sensor():
    _, _, before = moments(spot())
    _, _, after = moments(blurred(spot()[None], DEFOCUS, 0.0)[0])
    pitch = np.array([CAMERA.sensing_width / CAMERA.width, CAMERA.sensing_height / CAMERA.height])
    diameter = DEFOCUS.defocus * pitch[0] / pitch
    assert after - before == pytest.approx(np.diag(diameter**2 / 16.0), abs=1e-5)


def test_an_edge_of_the_image_stays_as_it_is():
    image = np.full((1, 40, 50), 77.0)
    image[:, 20:] = 140.0
    for condition in (BLUR, DEFOCUS):
        spread = blurred(image, condition, 0.0)
        assert spread[0, 2] == pytest.approx(77.0, abs=0.1)
        assert spread[0, -2] == pytest.approx(140.0, abs=0.1)


@pytest.mark.parametrize("condition", [UNDEREXPOSED, OVEREXPOSED])
def test_exposure_saturates_and_goes_through_the_cameras_gamma(condition):
    quiet = dataclasses.replace(condition, noise_db=math.inf)
    levels = np.array([[[0.0, 20.0, 60.0, 100.0, 200.0, 255.0]]])
    got = take(levels, quiet, 0.0, np.random.default_rng(0))
    light = np.minimum(condition.gain * levels, 255.0) / 255.0
    assert got == pytest.approx(255.0 * light**CAMERA.gamma, abs=0.5)
    # 0.31 of white, two stops over, is white.
    assert (got == 255).sum() == (3 if condition is OVEREXPOSED else 0)


def test_linearised_images_are_proportional_to_radiance():
    quiet = dataclasses.replace(LINEARISED, noise_db=math.inf)
    levels = np.array([[[0.0, 20.0, 60.0, 100.0, 200.0, 250.0]]])
    got = take(levels, quiet, 0.0, np.random.default_rng(0))
    assert got == pytest.approx(levels * 255.0 / 250.0, abs=4.5)  # of 4 a level


@pytest.mark.parametrize("condition", [CLEAN, NOISE])
def test_noise_has_the_stated_ratio_to_full_scale(condition):
    images = np.full((2, 300, 300), 128.0)
    got = take(images, condition, 0.0, np.random.default_rng(1)).astype(float)
    stated = 255.0 * 10.0 ** (-condition.noise_db / 20.0)
    # Rounding to whole levels adds 1/12; 180,000 samples are good to 0.2 %.
    assert got.std() == pytest.approx(math.sqrt(stated**2 + 1.0 / 12.0), rel=0.01)
    assert abs(np.corrcoef(got[0].ravel(), got[1].ravel())[0, 1]) < 0.02


def test_methods_get_the_same_noise():
    images = np.full((2, 60, 60), 128.0)
    other = images.copy()
    other[:, :10] = 100.0
    one, two = (
        take(exact, NOISE, 0.0, np.random.default_rng((3, 4))).astype(int)
        for exact in (images, other)
    )
    assert (one[:, 10:] == two[:, 10:]).all()
    assert len({condition.name for condition in CONDITIONS}) == len(CONDITIONS)
