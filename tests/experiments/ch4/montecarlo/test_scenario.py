"""The worlds of table 4-1, and the true visibility of markers in them."""

import itertools
import math

import numpy as np
import pytest
from matplotlib.path import Path
from scipy import ndimage

from experiments.ch4.montecarlo.scenario import DENSITIES, SCENARIO, draw_worlds
from experiments.ch4.montecarlo.sight import sighting_variance
from experiments.ch4.montecarlo.trial import draw_chance
from perception.stereo.geometry import StereoGeometry

HALF = 0.5 * SCENARIO.side
SIDE = 0.5 * SCENARIO.width + SCENARIO.ear
EMPTY = np.zeros((0, 6, 2))


@pytest.fixture(scope="module")
def drawn():
    return draw_worlds(draw_chance(5).candidates)


def centres():
    axis = np.arange(round(SCENARIO.side / SCENARIO.cell)) * SCENARIO.cell
    x, y = np.meshgrid(axis + 0.5 * SCENARIO.cell - HALF, axis + 0.5 * SCENARIO.cell - HALF)
    return np.column_stack([x.ravel(), y.ravel()])


def path(corners):
    return Path(np.vstack([corners, corners[:1]]), closed=True)


def distances(points, corners):
    """Distances of places to a polygon's edges, by sampling the edges finely."""
    along = np.linspace(0.0, 1.0, 100)[:, None]
    edges = [a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0))]
    samples = np.concatenate(edges)
    return np.min(np.linalg.norm(points[:, None] - samples, axis=2), axis=1)


def test_obstacles_cover_the_density_that_is_asked_for(drawn):
    for world, density in zip(drawn, DENSITIES):
        inside = np.zeros(len(centres()), dtype=bool)
        for corners in world.corners:
            inside |= path(corners).contains_points(centres())
        assert abs(inside.mean() - world.covered) < 1e-3
        largest = math.pi * SCENARIO.largest**2 / SCENARIO.side**2
        assert density / 100.0 <= world.covered < density / 100.0 + largest


def test_a_denser_world_is_a_sparser_one_with_more_obstacles(drawn):
    for sparse, dense in itertools.pairwise(drawn):
        assert len(dense.corners) > len(sparse.corners)
        np.testing.assert_array_equal(dense.corners[: len(sparse.corners)], sparse.corners)
        assert np.all(dense.occupied >= sparse.occupied)


def test_obstacles_leave_the_path_free_by_two_standard_deviations_of_drift(drawn):
    margin = SCENARIO.marker + 2.0 * SCENARIO.drift * SCENARIO.start
    x = SIDE + margin
    top = SCENARIO.start + SCENARIO.length + margin
    passage = path(np.array([[-x, -margin], [x, -margin], [x, top], [-x, top]]))
    for corners in drawn[-1].corners:
        assert not passage.intersects_path(path(corners), filled=True)


def test_free_camera_positions_touch_nothing_and_can_be_reached(drawn):
    world = drawn[1]
    free = world.occupied == 0.0
    labels, _ = ndimage.label(free)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    assert set(np.unique(labels[free])) <= set(border)
    places = centres()[free.ravel()]
    for corners in world.corners:
        near = places[np.linalg.norm(places - corners.mean(axis=0), axis=1) < 0.4]
        assert not path(corners).contains_points(near).any()
        if len(near):
            assert distances(near[::23], corners).min() > SCENARIO.head


def test_a_density_out_of_reach_is_an_error():
    with pytest.raises(ValueError, match=r"density 99.9 %: not reached by 512 obstacles"):
        draw_worlds(draw_chance(5).candidates, densities=(5, 99.9))


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, -20.0])
def test_sighting_error_is_that_of_the_stereo_geometry(turn_deg):
    gap, turn = 0.1, math.radians(turn_deg)
    scenario = SCENARIO._replace(width=0.002, length=0.001)  # too small to hide a marker
    side = 0.5 * scenario.width + scenario.ear
    camera = np.array([side + 0.7 * math.sin(turn), 0.5 * gap + 0.7 * math.cos(turn)])
    fx = scenario.focal
    pair = StereoGeometry(510, 492, fx, fx, 254.5, 245.5, scenario.baseline)
    expected = 0.0
    for marker in ([side, 0.0], [side, gap]):
        line = np.array(marker) - camera
        distance = np.linalg.norm(line)
        forward = line / distance
        sigma = (scenario.pixel, scenario.pixel, scenario.disparity)
        in_camera = pair.covariance([0.0, 0.0, distance], sigma)
        axis = np.array([-forward[1], 0.0, forward[0]])  # the slot's direction, camera frame
        expected += axis @ in_camera @ axis / -forward[1]
    found = sighting_variance(scenario, EMPTY, camera, 0, gap, 0.0)
    assert found == pytest.approx(expected, rel=1e-9)


def test_a_marker_is_seen_only_in_focus_in_view_and_from_the_front():
    def seen(x, y, gap=0.05):
        return sighting_variance(SCENARIO, EMPTY, np.array([x, y]), 0, gap, 0.0) > 0.0

    assert seen(SIDE + 0.2, 0.4)
    assert not seen(SIDE + 0.05, 0.14)  # the object's marker is nearer than the near limit
    assert not seen(SIDE + 0.3, 1.1)  # the slot's is farther than the far limit
    assert not seen(SIDE + 0.4, -0.1)  # from behind
    assert not seen(SIDE + 0.3, 0.3, gap=0.45)  # the gap does not fit in view
    assert not seen(-SIDE - 0.2, 0.4)  # the object hides the right-hand pair from the left


def test_hidden_is_what_meets_the_triangle_of_camera_and_marker(drawn):
    world = drawn[1]
    generator = np.random.default_rng(3)
    free = centres()[(world.occupied == 0.0).ravel()]
    places = free[(free[:, 1] > 0.35) & (np.linalg.norm(free, axis=1) < 1.0)]
    seen = hidden = 0
    for camera in generator.choice(places, min(len(places), 200), replace=False):
        for target, side in enumerate((SIDE, -SIDE)):
            if sighting_variance(SCENARIO, EMPTY, camera, target, 0.1, 0.01) == 0.0:
                continue
            lines = [
                Path([camera, [x - SCENARIO.marker, y], [x + SCENARIO.marker, y], camera])
                for x, y in ((side, 0.0), (side + 0.01, 0.1))
            ]
            meets = any(
                line.intersects_path(path(corners), filled=True)
                for line in lines
                for corners in world.corners
            )
            found = sighting_variance(SCENARIO, world.corners, camera, target, 0.1, 0.01) > 0.0
            assert found != meets
            seen, hidden = seen + found, hidden + meets
    assert seen > 5
    assert hidden > 5
