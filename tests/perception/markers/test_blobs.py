"""The blob detector in images that are noisier or less sharp than its cameras'."""

import dataclasses

import cv2
import numpy as np
import pytest

from perception.markers.blobs import detect_blobs
from perception.markers.ellipses import MarkerExpectation
from tests.perception.markers.marker_pictures import HEAD, RADIUS, picture, seen
from tests.perception.markers.test_bodies import CARD, SLOT, poses

NOISE = 12.8
"""Standard deviation of 26 dB under full scale [grey levels]."""


def pictures(distance, count):
    """Sharp pictures of card and slot, with the true ellipses (4, 5)."""
    rng = np.random.default_rng(3)
    for slant in np.linspace(0.0, 0.9, count):
        bodies = poses(distance, slant, rng)
        truth = np.concatenate([seen(b, c.points)[0] for b, c in zip(bodies, (CARD, SLOT))])
        yield picture(truth, rng), truth


def errors(found, truth):
    """Offsets (M, 2) of the true centres from the nearest found, NaN beyond a pixel; NEES (M,)."""
    off = np.full((len(truth), 2), np.nan)
    nees = np.full(len(truth), np.nan)
    for number, ellipse in enumerate(truth):
        if len(found):
            away = found.centres - ellipse[:2]
            nearest = np.argmin(np.linalg.norm(away, axis=1))
            if np.linalg.norm(away[nearest]) < 1.0:
                off[number] = away[nearest]
                inverse = np.linalg.inv(found.centre_covariances[nearest])
                nees[number] = away[nearest] @ inverse @ away[nearest] / 2.0
    return off, nees


@pytest.mark.parametrize("distance", [0.4, 0.7])
def test_discs_in_noise_are_found_where_it_is_known(distance):
    expected = MarkerExpectation(0.8 * distance, 1.2 * distance, noise=NOISE, sampling=0.0)
    rng, away, consistency = np.random.default_rng(4), [], []
    for image, truth in pictures(distance, 6):
        noisy = np.clip(np.rint(image + NOISE * rng.standard_normal(image.shape)), 0, 255)
        off, nees = errors(detect_blobs(noisy.astype(np.uint8), HEAD, expected), truth)
        away.append(off)
        consistency.append(nees)
        # In the belief of a quiet camera the noise joins all to one blob.
        quiet = dataclasses.replace(expected, noise=1.28)
        assert not len(detect_blobs(noisy.astype(np.uint8), HEAD, quiet))
    assert np.isfinite(away).mean() > 0.9
    assert np.nanmean(np.linalg.norm(away, axis=-1)) < 0.2
    assert np.nanmean(consistency) < 2.0


def kernels():
    line = np.full((1, 5), 0.25)
    line[0, [0, -1]] = 0.125
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 5)).astype(float)
    return {"columns": line, "rows": line.T, "disc": disc / disc.sum()}


@pytest.mark.parametrize("name", kernels())
def test_discs_that_are_blurred_by_four_pixels_are_found_and_no_surer_than_they_say(name):
    found, away, consistency = 0, [], []
    for distance in (0.4, 0.7):
        expected = MarkerExpectation(0.8 * distance, 1.2 * distance)
        for image, truth in pictures(distance, 6):
            soft = cv2.filter2D(image, -1, kernels()[name])
            off, nees = errors(detect_blobs(soft, HEAD, expected), truth)
            found += int(np.isfinite(nees).sum())
            away.append(off)
            consistency.append(nees)
    # Of 48; a fit had to halt at 0.05 px before, and 21 to 27 did.
    assert found >= 38
    assert np.nanmedian(np.linalg.norm(away, axis=-1)) < 0.15
    assert np.nanmean(consistency) < 2.0


def sampled(rng, radius):
    """Return a disc drawn by four samples a pixel, as renderers draw it, and its centre."""
    samples = np.array([[-3, -1], [1, -3], [3, 1], [-1, 3]]) / 8.0
    centre = np.array([255.0, 245.0]) + rng.uniform(-0.5, 0.5, 2)
    y, x = np.mgrid[: HEAD.height, : HEAD.width]
    inside = [
        np.hypot((x + dx - centre[0]) * HEAD.fy / HEAD.fx, y + dy - centre[1]) < radius
        for dx, dy in samples
    ]
    image = 40.0 + 140.0 * np.mean(inside, axis=0)
    soft = cv2.GaussianBlur(image, (3, 3), 0.5) + 1.28 * rng.standard_normal(image.shape)
    return np.clip(np.rint(soft), 0, 255).astype(np.uint8), centre


def test_every_disc_of_a_renderer_is_found_though_its_steps_let_weights_chase_the_fit():
    """Their fits went to and fro by some hundredths of a pixel; one in fourteen was dropped."""
    rng, distance = np.random.default_rng(6), 0.4
    expected = MarkerExpectation(0.8 * distance, 1.2 * distance)
    off, nees = [], []
    for _ in range(120):
        image, centre = sampled(rng, RADIUS * HEAD.fy / distance)
        found = detect_blobs(image, HEAD, expected)
        assert len(found) == 1
        error = found.centres[0] - centre
        off.append(np.hypot(*error))
        nees.append(error @ np.linalg.solve(found.centre_covariances[0], error) / 2.0)
    # Those that went to and fro are worse than the others, and say so.
    assert np.median(off) < 0.06 and max(off) < 0.4
    assert np.mean(nees) < 1.0 and max(nees) < 7.0


@pytest.mark.parametrize("bright", [105.0, 220.0])
def test_discs_beside_an_edge_with_bright_ground_beyond_are_found_where_they_are(bright):
    """A dark face ends 1.6 px beside each disc; the ground beyond is as bright as a dim disc."""
    rng, off, consistency = np.random.default_rng(5), [], []
    for distance in np.linspace(0.4, 0.7, 8):
        bodies = poses(distance, 0.6, rng)
        truth = np.concatenate([seen(b, c.points)[0] for b, c in zip(bodies, (CARD, SLOT))])
        image = picture(truth, rng, bright=bright, dark=25.0, plate=10).astype(float)
        for u, v, suu, _, svv in truth:
            half = int(np.sqrt(svv)) + 10
            edge = u - np.sqrt(suu) - 1.6
            beyond = slice(int(v) - half, int(v) + half + 1), slice(int(edge) - 12, int(edge) + 1)
            image[beyond] = 150.0 + rng.uniform(-20.0, 20.0, image[beyond].shape)
        grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        expected = MarkerExpectation(0.8 * distance, 1.2 * distance)
        away, nees = errors(detect_blobs(grey, HEAD, expected), truth)
        off.append(away)
        consistency.append(nees)
    assert np.isfinite(off).mean() > 0.8
    assert np.nanmean(np.linalg.norm(off, axis=-1)) < 0.1
    assert np.nanmedian(consistency) < 2.0
