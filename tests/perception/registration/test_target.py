"""A target's markers are found, on images traced from its CAD."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.registration.target import (
    TargetCad,
    find_spots,
    find_target,
    possible_markers,
)
from perception.stereo.geometry import StereoGeometry

HEAD = StereoGeometry(510, 492, 677.34, 871.25, 254.5, 245.5, 0.038)
CAD = TargetCad(
    np.array([[-0.15, -0.1, 0], [0.16, -0.07, 0], [-0.1, 0.11, 0], [0.06, 0.08, 0]]), 0.018, 0.4
)
SIGMA = np.full(3, 0.05)


def traced(target: RigidTransform, eye: float, rng: np.random.Generator) -> np.ndarray:
    """What a camera at (eye, 0, 0) sees: a grey plate with markers, nine rays a pixel, noise."""
    image = np.zeros((HEAD.height, HEAD.width))
    rows, columns = np.mgrid[: HEAD.height, : HEAD.width]
    origin = target.inv().apply([eye, 0.0, 0.0])
    for dx in (-1 / 3, 0, 1 / 3):
        for dy in (-1 / 3, 0, 1 / 3):
            u, v = (columns + dx - HEAD.cx) / HEAD.fx, (rows + dy - HEAD.cy) / HEAD.fy
            rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
            rays = target.rotation.inv().apply(rays)
            hit = (origin - origin[2] / rays[:, 2:] * rays)[:, :2].reshape(*u.shape, 2)
            shade = np.where((np.abs(hit) < [0.2, 0.15]).all(axis=-1), 110.0, 60.0)
            for marker in CAD.points:
                away = np.hypot(*np.moveaxis(hit - marker[:2], -1, 0))
                shade[away < CAD.radius] = 230.0
                shade[away < CAD.radius * CAD.dark] = 12.0
            image += shade / 9
    return np.clip(np.rint(image + 1.3 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


def pair(target: RigidTransform, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([traced(target, eye, rng) for eye in (0.0, HEAD.baseline)])


def at(distance: float, tilt: float, turn: float) -> RigidTransform:
    # The face looks back at the camera, upright in the image.
    facing = Rotation.from_euler("x", np.pi)
    return RigidTransform.from_components(
        [0.02, -0.03, distance], Rotation.from_euler("zyx", [turn, tilt, 0.1]) * facing
    )


@pytest.mark.parametrize("place", [(0.6, 0.0, 0.0), (0.9, 0.8, 0.2), (1.3, -0.6, -0.3)])
def test_all_markers_are_found_to_a_fifth_of_a_pixel_and_named(place):
    target = at(*place)
    seen = find_target(pair(target), HEAD, CAD, SIGMA)
    assert seen is not None and seen.indices.tolist() == [0, 1, 2, 3]
    truth = HEAD.project(target.apply(CAD.points))
    assert np.abs(seen.image_points - truth).max() < 0.2


@pytest.mark.parametrize("place", [(3.0, 0.6, 0.0), (3.5, -0.7, 0.2), (4.0, 0.3, 0.0)])
def test_a_target_far_away_is_found_in_the_enlarged_image(place):
    target = at(*place)
    images = pair(target)
    assert find_target(images, HEAD, CAD, SIGMA) is None
    seen = find_target(images, HEAD, CAD, [0.1, 0.1, 0.1], far=True)
    assert seen is not None and seen.indices.tolist() == [0, 1, 2, 3]
    truth = HEAD.project(target.apply(CAD.points))
    assert np.abs(seen.image_points - truth).max() < 0.3


def test_three_markers_are_enough_and_two_are_not():
    images = pair(at(0.9, 0.2, 0.0))
    spots = find_spots(images[0], CAD)
    for count, spot in enumerate(spots[:2], start=1):
        column, row, diameter = spot.astype(int)
        images[0, row - diameter : row + diameter, column - diameter : column + diameter] = 110
        seen = find_target(images, HEAD, CAD, SIGMA)
        assert (seen is not None and len(seen.indices) == 4 - count) == (count == 1)


def test_markers_of_a_target_half_out_of_view_are_hints_where_it_is():
    """Two are in both images; one is in the right alone, its size gives its distance roughly."""
    target = RigidTransform.from_components([0.255, 0.0, 0.8], at(0.8, 0.2, 0.0).rotation)
    images = pair(target)
    assert find_target(images, HEAD, CAD, SIGMA) is None
    hints = possible_markers(images, HEAD, CAD)
    truth = target.apply(CAD.points)
    away = np.linalg.norm(hints.paired[:, None] - truth, axis=2).min(axis=1)
    assert len(hints.paired) == 2 and away.max() < 0.005
    eye = np.array([HEAD.baseline, 0.0, 0.0])
    seen, true = hints.alone[0] - eye, truth[3] - eye
    assert len(hints.alone) == 1 and 0.7 < np.linalg.norm(seen) / np.linalg.norm(true) < 1.4
    assert np.linalg.norm(np.cross(seen, true)) < 1e-3 * np.linalg.norm(seen) * np.linalg.norm(true)


def test_black_image_shows_no_target():
    black = np.zeros((2, 492, 510), np.uint8)
    assert find_target(black, HEAD, CAD, SIGMA) is None
    hints = possible_markers(black, HEAD, CAD)
    assert not len(hints.paired) and not len(hints.alone)


@pytest.mark.parametrize("bad", [np.zeros((2, 0, 5), np.uint8), np.zeros((2, 9, 9))])
def test_what_is_no_image_is_refused(bad):
    with pytest.raises(ValueError, match="expected grey of 8 bits"):
        find_target(bad, HEAD, CAD, SIGMA)
    with pytest.raises(ValueError, match="expected grey of 8 bits"):
        possible_markers(bad, HEAD, CAD)
