"""Fiducials are chosen where eq. 3-21 says, and where a match can be trusted."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from perception.registration.fiducials import (
    FiducialConfig,
    depth_term,
    inverse_radius,
    match_sigma,
    select_fiducials,
    visual_term,
    window_contrast,
)
from perception.registration.motion import RegistrationError
from tests.perception.registration.fiducial_views import HEAD

SHAPE = (HEAD.height, HEAD.width)
DISPARITY = 30.0


def grid(step=6):
    """Image points on a plane that faces the camera, (N, 3)."""
    columns, rows = np.meshgrid(np.arange(0, HEAD.width, step), np.arange(0, HEAD.height, step))
    flat = np.full(columns.size, DISPARITY)
    return np.column_stack([columns.ravel(), rows.ravel(), flat]).astype(float)


def texture(seed=0):
    noise = np.random.default_rng(seed).standard_normal(SHAPE).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.clip(np.rint(120 + 40 * smooth / smooth.std()), 0, 255).astype(np.uint8)


def flat_but_right():
    """Texture on the right only; the left is flat but for noise."""
    image = texture()
    noise = 1.3 * np.random.default_rng(1).standard_normal((SHAPE[0], 255))
    image[:, :255] = np.rint(120 + noise)
    return image


def test_fiducials_are_well_distributed_and_determine_a_motion():
    chosen = select_fiducials(texture(), grid(), HEAD, config=FiducialConfig(count=12))
    pixels = chosen.image_points[:, :2]
    apart = np.linalg.norm(pixels[:, None] - pixels, axis=-1) + 1e9 * np.eye(12)
    assert apart.min() >= 60
    np.testing.assert_array_equal(grid()[chosen.indices], chosen.image_points)


def test_none_is_chosen_on_flat_image_regions():
    chosen = select_fiducials(flat_but_right(), grid(), HEAD, config=FiducialConfig(count=30))
    assert len(chosen.indices) > 10
    assert chosen.image_points[:, 0].min() > 245


@pytest.mark.parametrize("image", [np.zeros(SHAPE, np.uint8), np.full(SHAPE, 200, np.uint8)])
def test_an_empty_image_gives_none(image):
    chosen = select_fiducials(image, grid(), HEAD)
    assert len(chosen.indices) == 0


def test_none_is_chosen_on_a_straight_edge():
    image = np.full(SHAPE, 60, np.uint8)
    image[:, 250:] = 180
    assert len(select_fiducials(image, grid(), HEAD).indices) == 0
    image[246:, :] = 100  # A corner, and a corner only, is distinct along both axes.
    chosen = select_fiducials(image, grid(), HEAD)
    assert len(chosen.indices) > 0
    assert np.abs(chosen.image_points[:, :2] - [250, 246]).max() < 10


def test_matches_are_as_uncertain_as_predicted():
    """Patches with noise drawn anew are matched by least squares."""
    image, config = texture(), FiducialConfig()
    generator = np.random.default_rng(2)
    place, half = np.array([200, 220]), config.patch // 2
    rows = slice(place[1] - half, place[1] + half + 1)
    columns = slice(place[0] - half, place[0] + half + 1)
    grey = image.astype(float)
    gradient = np.stack([np.gradient(grey, axis=1), np.gradient(grey, axis=0)])
    by_place = gradient[:, rows, columns].reshape(2, -1).T
    noise = np.sqrt(2.0) * config.noise * generator.standard_normal((4000, len(by_place)))
    shifts = noise @ np.linalg.pinv(by_place).T
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(shifts.T)).max())
    point = np.array([[*place, DISPARITY]], dtype=float)
    assert match_sigma(image, point, config)[0] == pytest.approx(worst, rel=0.2)


def test_contrast_window_grows_until_contrast_falls():
    windows = np.array([3.0, 5.0, 7.0, 9.0])
    means = np.array([[100.0, 90.0], [80.0, 80.0], [90.0, 70.0], [50.0, 60.0]])
    contrast, window = window_contrast(np.array([100.0, 100.0]), means, windows)
    np.testing.assert_array_equal(window, [5.0, 9.0])
    np.testing.assert_allclose(contrast, [0.25, 2.0 / 3.0])


def test_visual_term_is_that_of_a_brute_force():
    image, config = texture(), FiducialConfig(full_visual=10.0)
    points = grid(50)[24:30]
    found = visual_term(image, points, config)
    for value, (column, row, _) in zip(found, points.astype(int)):
        best = None
        for half in range(1, 16):
            patch = image[row - half : row + half + 1, column - half : column + half + 1]
            contrast = abs(float(image[row, column]) - patch.mean()) / patch.mean()
            if best is not None and contrast < best[0] - 1e-4:
                break
            best = (contrast, 2 * half + 1)
        assert value == pytest.approx(best[0] * best[1] / 31 / 10.0, rel=1e-4)


def test_depth_contrast_is_zero_on_a_plane_and_rises_at_a_step():
    points = grid(3)
    depths = np.ones(len(points))
    chosen = np.flatnonzero(np.abs(points[:, :2] - 250).max(axis=1) < 40)
    config = FiducialConfig()
    assert depth_term(points, depths, SHAPE, chosen, config).max() < 1e-5
    depths[points[:, 0] > 250] = 1.3
    term = depth_term(points, depths, SHAPE, chosen, config)
    near = np.abs(points[chosen, 0] - 250) < 10
    assert term[near].min() > 0.1
    assert term[near].mean() > 0.5
    assert term[np.abs(points[chosen, 0] - 250) > 20].max() < 1e-5


def test_none_is_chosen_where_one_surface_hides_another():
    points = grid(3)
    points[points[:, 0] > 250, 2] = 25.0
    chosen = select_fiducials(texture(), points, HEAD, config=FiducialConfig(count=40))
    assert len(chosen.indices) == 40
    assert np.abs(chosen.image_points[:, 0] - 250).min() > 8
    slanted = grid(3)
    slanted[:, 2] = 20.0 + 0.05 * slanted[:, 0]  # A slant is no edge.
    count = len(select_fiducials(texture(), slanted, HEAD, config=FiducialConfig(count=40)).indices)
    assert count == 40


def test_certain_points_among_less_certain_ones_are_preferred():
    certain = np.full(len(grid()), 0.2)
    liked = np.abs(grid()[:, 0] - 300) < 40
    certain[liked] = 0.9
    config = FiducialConfig(count=4, certainty_weight=10.0)
    chosen = select_fiducials(texture(), grid(), HEAD, certainties=certain, config=config)
    assert liked[chosen.indices].all()


def test_radius_reaches_to_where_certainty_stops_falling():
    """On a line: certainty falls for three shells and rises in the fourth."""
    places = np.column_stack([np.arange(6) + 0.5, np.zeros(6), np.zeros(6)])
    certain = np.array([0.8, 0.6, 0.5, 0.7, 0.1, 0.1])
    centre = np.zeros((1, 3))
    assert inverse_radius(places, certain, centre, np.array([0.9]), 1.0, 6)[0] == 1.0 / 3.0
    # Better known all about: the smallest radius.
    assert inverse_radius(places, certain, centre, np.array([0.3]), 1.0, 6)[0] == 1.0


def test_fiducials_keep_away_from_those_taken():
    first = select_fiducials(texture(), grid(), HEAD)
    second = select_fiducials(texture(), grid(), HEAD, taken=first.image_points)
    apart = np.linalg.norm(
        first.image_points[:, None, :2] - second.image_points[None, :, :2], axis=-1
    )
    assert apart.min() > 20
    assert np.median(apart.min(axis=0)) > 60


def test_what_will_leave_the_view_is_passed_over():
    turn = RigidTransform.from_exp_coords([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    chosen = select_fiducials(texture(), grid(), HEAD, next_view=turn)
    after = HEAD.project(turn.apply(HEAD.points(chosen.image_points), inverse=True))
    assert ((after[:, 0] > 0) & (after[:, 0] < HEAD.width)).all()
    assert chosen.image_points[:, 0].min() > 190


def test_nan_is_passed_over_and_bad_shapes_are_refused():
    points = grid()
    points[::2, 2] = np.nan
    points[1::4, 0] = np.inf
    chosen = select_fiducials(texture(), points, HEAD)
    assert np.isfinite(chosen.image_points).all() and len(chosen.indices) == 6
    assert len(select_fiducials(texture(), np.zeros((0, 3)), HEAD).indices) == 0
    with pytest.raises(RegistrationError, match="expected"):
        select_fiducials(texture()[:100], points, HEAD)
    with pytest.raises(RegistrationError, match="certainties"):
        select_fiducials(texture(), points, HEAD, certainties=[1.0])
    with pytest.raises(ValueError, match="patch must be odd"):
        FiducialConfig(patch=8)
