"""Expansion, hidden intervals and field visibility on the plane."""

import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from controllers.placement.planar.field import (
    EVERYTHING,
    NOTHING,
    SOMETHING,
    HullCorners,
    Intervals,
    add_blocked,
    blocked_interval,
    free_cap,
    hull_around,
)
from controllers.placement.planar.occluders import convex_sum, expand
from controllers.placement.task import Occluder, Target

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
POINT = Target("hole", [0.0, 0.0], [1.0, 0.0], [[0.0, 0.0]])


def polygon(generator, middle, radius=1.0):
    points = middle + radius * generator.uniform(-1.0, 1.0, (8, 2))
    return points[ConvexHull(points).vertices]


def hits(corners, angle, radius, steps=2001):
    """Whether the segment from the origin meets a polygon, by dense points on it."""
    along = np.linspace(0.0, radius, steps)[1:, None] * [math.cos(angle), math.sin(angle)]
    edges = np.roll(corners, -1, axis=0) - corners
    offset = along[:, None] - corners
    left = edges[:, 0] * offset[..., 1] >= edges[:, 1] * offset[..., 0]
    return bool(left.all(axis=1).any())


def test_square_ahead_hides_what_its_near_corners_span():
    corners = SQUARE + [4.0, 0.0]
    what, low, high = blocked_interval(corners, 0, 4, 10.0)
    assert what == SOMETHING
    assert (low, high) == pytest.approx((-math.atan2(1, 3), math.atan2(1, 3)))


def test_camera_between_target_and_square_is_not_hidden_by_it():
    assert blocked_interval(SQUARE + [4.0, 0.0], 0, 4, 2.99)[0] == NOTHING


def test_circle_through_the_square_cuts_its_interval():
    """At 3.1 m the near side x = 3 is crossed where cos = 3 / 3.1."""
    _, low, high = blocked_interval(SQUARE + [4.0, 0.0], 0, 4, 3.1)
    assert high == pytest.approx(math.acos(3.0 / 3.1))
    assert low == pytest.approx(-high)


def test_hull_about_the_target_hides_it_from_everywhere():
    assert blocked_interval(SQUARE, 0, 4, 5.0)[0] == EVERYTHING
    assert hull_around(HullCorners(SQUARE, np.array([0, 4]))) == 0
    assert free_cap(HullCorners(SQUARE, np.array([0, 4])), 0.0, 0.0, 5.0) == 0.0


def test_wall_that_the_target_is_fixed_to_hides_half_a_turn():
    what, low, high = blocked_interval(SQUARE - [1.0, 0.0], 0, 4, 0.5)
    assert what == SOMETHING
    assert high - low == pytest.approx(math.pi)
    assert free_cap(
        HullCorners(SQUARE - [1.0, 0.0], np.array([0, 4])), 0.0, 0.0, 5.0
    ) == pytest.approx(math.pi / 2)


def test_intervals_are_those_of_dense_rays():
    generator = np.random.default_rng(1)
    checked = 0
    for _ in range(60):
        corners = polygon(generator, generator.uniform(-4.0, 4.0, 2), generator.uniform(0.5, 2.0))
        radius = generator.uniform(0.5, 6.0)
        what, low, high = blocked_interval(corners, 0, len(corners), radius)
        if what == EVERYTHING:
            assert hits(corners, 0.0, 1e-6, 3)
            continue
        for angle in generator.uniform(-np.pi, np.pi, 20):
            after = (angle - low) % (2.0 * np.pi)
            if what == SOMETHING and min(after, abs(after - (high - low))) < 2e-2:
                continue
            expected = what == SOMETHING and after < high - low
            assert hits(corners, angle, radius) == expected
            checked += 1
    assert checked > 800


def test_free_cap_changes_no_faster_than_the_camera_turns_and_falls_with_distance():
    generator = np.random.default_rng(2)
    for _ in range(30):
        hulls = [polygon(generator, 4.0 * np.array([math.cos(a), math.sin(a)]))
                 for a in generator.uniform(-np.pi, np.pi, 4)]  # fmt: skip
        packed = HullCorners(np.concatenate(hulls), np.cumsum([0, *map(len, hulls)]))
        angles = np.linspace(-1.5, 1.5, 200)
        near, far = (np.array([free_cap(packed, 0.3, a, r) for a in angles]) for r in (3.5, 4.5))
        assert np.abs(np.diff(near)).max() <= angles[1] - angles[0] + 1e-12
        assert np.all(far <= near + 1e-12)


def test_added_intervals_are_the_union():
    generator = np.random.default_rng(3)
    for _ in range(50):
        intervals, count = Intervals(np.empty(21), np.empty(21)), 0
        lows, highs = intervals
        grid, covered = np.linspace(0.0, 10.0, 4001), np.zeros(4001, dtype=bool)
        for _ in range(12):
            low = generator.uniform(0.0, 9.5)
            high = low + generator.uniform(0.0, 1.0)
            count = add_blocked(intervals, count, low, high)
            covered |= (grid >= low) & (grid <= high)
        assert np.all(lows[1:count] > highs[: count - 1])
        united = np.any((grid >= lows[:count, None]) & (grid <= highs[:count, None]), axis=0)
        np.testing.assert_array_equal(united, covered)


def test_expanded_occluder_is_its_sum_with_the_mirrored_target():
    """A target that reaches 1 m to one side widens occluders to the other."""
    target = Target("edge", [0.0, 0.0], [1.0, 0.0], [[0.0, 0.0], [0.0, 1.0]])
    hull = expand([Occluder("box", SQUARE + [5.0, 0.0])], target).hull(0)
    np.testing.assert_allclose([hull.min(axis=0), hull.max(axis=0)], [[4.0, -2.0], [6.0, 1.0]])


def test_compiled_sum_of_convex_polygons_is_scipys():
    generator = np.random.default_rng(4)
    for _ in range(40):
        first, second = polygon(generator, [3.0, 1.0]), polygon(generator, [0.0, 0.0], 0.4)
        if generator.random() < 0.3:
            second = generator.uniform(-1.0, 1.0, (2, 2))
        out = np.empty((len(first) + len(second), 2))
        count = convex_sum(first, second, out)
        expected = ConvexHull((first[:, None] + second).reshape(-1, 2))
        assert ConvexHull(out[:count]).volume == pytest.approx(expected.volume)
        turned = np.roll(out[:count], -1, axis=0)
        area = 0.5 * np.sum(out[:count, 0] * turned[:, 1] - out[:count, 1] * turned[:, 0])
        assert area == pytest.approx(expected.volume)


def test_a_line_is_an_occluder_for_a_target_with_width_across_it():
    wide = Target("slot", [0.0, 0.0], [1.0, 0.0], [[0.0, -0.5], [0.0, 0.5]])
    hull = expand([Occluder("wire", [[3.0, 0.0], [4.0, 0.0]])], wide).hull(0)
    assert ConvexHull(hull).volume == pytest.approx(1.0)


@pytest.mark.parametrize("points", [[[3.0, 0.0], [4.0, 0.0], [5.0, 0.0]], [[1.0, 1.0]]])
def test_occluder_without_area_is_refused_by_name(points):
    with pytest.raises(ValueError, match="occluder 'wire'.*in one line"):
        expand([Occluder("wire", points)], POINT)


def test_target_in_space_is_refused_on_the_plane():
    with pytest.raises(ValueError, match="'hole': has three coordinates"):
        expand([], Target("hole", np.zeros(3), [0.0, 0.0, 1.0], np.zeros((1, 3))))


def test_occluder_in_space_is_refused_on_the_plane_by_name():
    with pytest.raises(ValueError, match="occluder 'box': has three coordinates, expected two"):
        expand([Occluder("box", np.ones((4, 3)))], POINT)
