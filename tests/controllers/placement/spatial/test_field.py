"""The free cap is what dense rays find, and is as smooth and falling as the search relies on."""

import numpy as np
import pytest

from controllers.placement.spatial.field import free_caps, signed_caps
from controllers.placement.spatial.occluders import expand
from tests.controllers.placement.spatial.scenes import (
    box,
    disc_target,
    fibonacci,
    hidden,
    random_occluders,
)

DIRECTIONS = fibonacci(12_000)
GAP = 5.0 / np.sqrt(len(DIRECTIONS))


def random_field(rng, count):
    target = disc_target(
        position=rng.normal(size=3), normal=rng.normal(size=3), radius=rng.uniform(0.004, 0.02)
    )
    return expand(target, random_occluders(rng, count, target))


def test_free_cap_is_the_angle_to_the_nearest_hidden_ray():
    rng = np.random.default_rng(1)
    compared = 0
    for count in (1, 3, 6, 12, 20):
        for radius in (0.1, 0.2, 0.35, 0.8):
            field = random_field(rng, count)
            blocked = DIRECTIONS[hidden(field, DIRECTIONS, radius)]
            ours = DIRECTIONS[rng.integers(len(DIRECTIONS), size=40)]
            caps = free_caps(field, field.target.position + radius * ours)
            cosines = (ours @ blocked.T).max(axis=1)
            rays = np.where(hidden(field, ours, radius), 0.0, np.arccos(np.clip(cosines, -1, 1)))
            # Rays find a hidden spot only where one runs: never nearer, and not much farther.
            assert np.all(caps <= rays + 1e-6)
            assert np.all(caps >= rays - GAP)
            np.testing.assert_array_equal(caps == 0.0, rays == 0.0)
            compared += np.count_nonzero(caps > 0.0)
    assert compared > 150


def test_depth_in_one_hull_is_the_angle_to_the_nearest_free_ray():
    rng = np.random.default_rng(2)
    compared = 0
    while compared < 100:
        field = random_field(rng, 1)
        for radius in (0.15, 0.3):
            out = hidden(field, DIRECTIONS, radius)
            up = DIRECTIONS @ field.target.normal > 0.0
            inside = DIRECTIONS[out & up][:: max(np.count_nonzero(out & up) // 20, 1)]
            if len(inside) == 0 or not field.names:
                continue
            whole = DIRECTIONS[~hidden_by_hull(field, radius)]
            rays = np.arccos(np.clip((inside @ whole.T).max(axis=1), -1.0, 1.0))
            depth = -signed_caps(field, field.target.position + radius * inside)
            assert np.all(depth >= 0.0)
            np.testing.assert_array_less(np.abs(depth - rays), GAP)
            compared += len(inside)


def hidden_by_hull(field, radius):
    """As `hidden`, without the target's own plane."""
    upwards = hidden(field, DIRECTIONS, radius)
    below = DIRECTIONS @ field.target.normal <= 0.0
    flipped = disc_target(position=field.target.position, normal=-field.target.normal)
    other = type(field)(flipped, field.rotation, field.names, field.hulls, field.shapes)
    return np.where(below, hidden(other, DIRECTIONS, radius), upwards)


def test_free_cap_changes_no_faster_than_the_direction_and_never_grows_with_distance():
    rng = np.random.default_rng(3)
    for _ in range(20):
        field = random_field(rng, 8)
        first = DIRECTIONS[rng.integers(len(DIRECTIONS), size=400)]
        second = first + rng.normal(scale=10.0 ** rng.uniform(-4, -0.5, (400, 1)), size=(400, 3))
        second /= np.linalg.norm(second, axis=1, keepdims=True)
        radius = rng.uniform(0.1, 0.5)
        here, there = (
            signed_caps(field, field.target.position + radius * side) for side in (first, second)
        )
        angle = 2.0 * np.arcsin(np.linalg.norm(first - second, axis=1) / 2.0)
        assert np.all(np.abs(here - there) <= angle + 1e-7)
        farther = signed_caps(field, field.target.position + 1.3 * radius * first)
        assert np.all(farther <= here + 1e-7)


def test_without_occluders_the_own_plane_bounds_the_cap():
    field = expand(disc_target(), [])
    elevation = np.deg2rad([10.0, 60.0, 90.0, -5.0])
    places = np.column_stack([np.cos(elevation), 0.0 * elevation, np.sin(elevation)])
    np.testing.assert_allclose(free_caps(field, places), np.maximum(elevation, 0.0), atol=1e-12)


def test_hull_beyond_the_camera_hides_nothing():
    field = expand(disc_target(), [box("lid", [0.0, 0.0, 0.3], [0.2, 0.2, 0.01])])
    below, above = free_caps(field, [[0.0, 0.0, 0.28], [0.0, 0.0, 0.4]])
    assert below == pytest.approx(np.pi / 2)
    assert above == 0.0


def test_ball_cuts_a_lid_to_the_cap_that_lies_within_the_cameras_distance():
    """A wide lid at height h covers, at distance r, the polar cap with cosine h / r."""
    height, radius = 0.2, 0.25
    field = expand(disc_target(), [box("lid", [0.0, 0.0, height + 0.1], [3.0, 3.0, 0.1])])
    edge = np.arccos(height / radius)
    for off in (0.1, 0.2):
        turn = edge + off
        place = radius * np.array([np.sin(turn) * 0.6, np.sin(turn) * 0.8, np.cos(turn)])
        expected = min(off, np.pi / 2 - turn)
        assert free_caps(field, place)[0] == pytest.approx(expected, abs=1e-9)


def test_wall_wider_than_the_half_sphere_is_no_farther_than_its_edge():
    wall = box("wall", [-0.11, 0.0, -0.4], [0.06, 20.0, 0.5])
    place = [[0.0, 0.0, 0.3]]
    assert free_caps(expand(disc_target(radius=0.01), [wall]), place)[0] == pytest.approx(
        np.arctan2(0.04, 0.1), abs=1e-9
    )
