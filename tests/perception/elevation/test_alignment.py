"""Views with a wrong tilt and height fit the map again, against a surface made by hand."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.elevation.alignment import aligned
from perception.elevation.grid import ElevationGrid
from perception.elevation.map import ElevationMap

GRID = ElevationGrid((-2.0, -2.0), (160, 160), 0.025)
EYE = np.array([0.2, -1.5, 0.45])
SIGMA = np.diag(np.square([0.02, 0.02, 0.05, 0.1, 0.1, 0.02]))
AT_EYE = RigidTransform.from_translation(EYE)


def surface(places):
    """Height of gentle relief with a few boxes on it [m]."""
    x, y = places[:, 0], places[:, 1]
    ground = 0.02 * np.sin(3.0 * x) * np.cos(2.0 * y) + 0.05 * x
    return ground + 0.08 * ((np.abs(x - 0.5) < 0.05) & (np.abs(y) < 0.05))


def view(rng, error, low=(-1.0, -1.0), high=(1.0, 1.0), count=4000):
    """Points of the surface by a camera that is turned and shifted by a twist at its place."""
    places = rng.uniform(low, high, (count, 2))
    points = np.column_stack([places, surface(places) + 0.003 * rng.standard_normal(count)])
    return (AT_EYE * RigidTransform.from_exp_coords(error) * AT_EYE.inv()).apply(points)


def mapped(rng):
    """Map of the surface, by a view without error."""
    elevation = ElevationMap(GRID)
    points = view(rng, np.zeros(6))
    elevation.insert(points, np.tile(1e-5 * np.eye(3), (len(points), 1, 1)))
    return elevation


def test_tilt_and_height_of_a_view_are_corrected_to_what_is_mapped():
    rng = np.random.default_rng(1)
    elevation = mapped(rng)
    for error in (
        [0.02, 0.0, 0, 0, 0, 0],
        [0.0, -0.03, 0, 0, 0, 0.01],
        [-0.01, 0.02, 0, 0, 0, 0.03],
    ):
        points = view(rng, error)
        fitted = aligned(elevation, points, EYE, SIGMA)
        np.testing.assert_allclose(fitted.points[:, :2], points[:, :2])
        off = fitted.points[:, 2] - surface(points[:, :2])
        before = points[:, 2] - surface(points[:, :2])
        assert np.median(np.abs(off)) < 0.004 < 0.25 * np.median(np.abs(before)) + 0.004
        assert abs(np.median(off)) < 0.002


def test_a_view_that_has_drifted_farther_than_rocks_are_high_still_fits_the_map():
    rng = np.random.default_rng(5)
    elevation, sigma = mapped(rng), SIGMA.copy()
    sigma[5, 5] = 0.1**2
    for drift in (-0.12, 0.07, 0.15):
        points = view(rng, [0.01, -0.02, 0, 0, 0, drift])
        off = aligned(elevation, points, EYE, sigma).points[:, 2] - surface(points[:, :2])
        assert abs(np.median(off)) < 0.003
        assert np.median(np.abs(off)) < 0.004


def test_an_obstacle_that_was_not_there_before_does_not_turn_the_view():
    rng = np.random.default_rng(2)
    elevation, points = mapped(rng), view(rng, np.zeros(6))
    there = (points[:, 0] > 0.3) & (points[:, 1] > 0.2)
    points[there, 2] += 0.15
    fitted = aligned(elevation, points, EYE, SIGMA)
    assert np.abs(fitted.points - points).max() < 0.003


def test_without_anything_mapped_nothing_moves_and_the_covariance_stays():
    rng = np.random.default_rng(3)
    fitted = aligned(ElevationMap(GRID), points := view(rng, np.zeros(6)), EYE, SIGMA)
    np.testing.assert_allclose(fitted.points, points)
    # Against the variance of the height of a point by all of the pose's covariance but the heading
    # and the place, drawn by chance.
    spread = rng.multivariate_normal(np.zeros(6), SIGMA, 20000)
    at_eye = rng.multivariate_normal(np.zeros(6), fitted.covariance, 20000)
    lever = np.array([0.7, 0.4, 0.0])

    def height(twists):
        return twists[:, 0] * lever[1] - twists[:, 1] * lever[0] + twists[:, 5]

    assert np.isclose(np.std(height(at_eye)), np.std(height(spread)), rtol=0.05)


def test_what_is_mapped_already_makes_the_tilt_sure():
    rng = np.random.default_rng(4)
    fitted = aligned(mapped(rng), view(rng, np.zeros(6)), EYE, SIGMA)
    assert np.sqrt(np.diag(fitted.covariance)[:2]).max() < 0.005


def test_a_map_that_has_drifted_is_contradicted_and_things_that_appear_are_not():
    rng = np.random.default_rng(6)
    elevation, sigma = mapped(rng), 1e-6 * np.eye(6)
    points = view(rng, np.zeros(6), count=40_000)
    assert aligned(elevation, points, EYE, sigma).contradicted < 0.01
    # A wall, whose points are above each other, and a block of a tenth of what is seen.
    stands = points.copy()
    wall = np.abs(points[:, 1] - 0.2) < 0.2
    stands[wall, 2] += rng.uniform(0.0, 0.6, np.count_nonzero(wall))
    stands[(points[:, 0] > 0.3) & (points[:, 1] < -0.7), 2] += 0.1
    assert 0.02 < aligned(elevation, stands, EYE, sigma).contradicted < 0.12
    # Half of the map was mapped 0.1 m higher.
    elevation.heights[:, :80] += 0.1
    assert 0.4 < aligned(elevation, points, EYE, sigma).contradicted < 0.6
    assert aligned(elevation, points[:200], EYE, sigma).contradicted == 0.0
