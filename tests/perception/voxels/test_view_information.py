"""Expected information of views, against a slow walk along each ray."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.voxels.occupancy import State, binary_entropy
from perception.voxels.views import (
    ExpectedOccupancy,
    PlanningGrid,
    claimed_by_view,
    expected_occupancy,
    planning_grid,
    view_information,
)
from tests.perception.voxels.wall_views import scanned

LOW = np.array([-0.2, 0.1, 0.0])
EDGE = 0.05
RAYS = np.array([[0.0, 0.0, 1.0], [0.2, 0.1, 1.0], [-0.3, 0.2, 1.0], [0.05, -0.3, 1.0]])
RAYS = RAYS / np.linalg.norm(RAYS, axis=1, keepdims=True)
REACH_SIGMAS = (0.05, 0.7)


def scene(seed: int) -> PlanningGrid:
    generator = np.random.default_rng(seed)
    states = generator.choice([0, 1, 2], size=(12, 10, 8), p=[0.6, 0.36, 0.04])
    return PlanningGrid(LOW, EDGE, states.astype(np.int8))


def cameras(seed: int, count: int) -> RigidTransform:
    """Within the grid and around it."""
    generator = np.random.default_rng(seed)
    places = LOW + generator.uniform(-0.3, 1.3, (count, 3)) * EDGE * np.array([12, 10, 8])
    return RigidTransform.from_components(places, Rotation.random(count, rng=generator))


def slow(grid, occupancy, camera, rays):
    """Steps of half a hundredth of a cell; the information and the cells met."""
    step = EDGE / 200
    seen, value = set(), 0.0
    for ray in rays:
        direction, passes = camera.rotation.apply(ray), 1.0
        for at in np.arange(REACH_SIGMAS[0] + step / 2, REACH_SIGMAS[1], step):
            place = (camera.translation + at * direction - LOW) / EDGE
            cell = tuple(np.floor(place).astype(int))
            if min(cell) < 0 or any(c >= n for c, n in zip(cell, grid.states.shape)):
                continue
            if grid.states[cell] == State.OCCUPIED or passes <= 0.05:
                break
            if grid.states[cell] == State.UNKNOWN:
                if cell not in seen:
                    seen.add(cell)
                    weight = -occupancy[cell] * np.log2(occupancy[cell])
                    value += passes * weight * float(binary_entropy(occupancy[cell]))
                passes *= (1 - occupancy[cell]) ** (step / EDGE)
    return value, seen


@pytest.mark.parametrize("seed", range(3))
def test_rating_and_claims_are_those_of_a_slow_walk(seed):
    grid = scene(seed)
    occupancy = expected_occupancy(grid.states)
    views = cameras(seed, 4)
    found = view_information(grid, occupancy, views, RAYS, REACH_SIGMAS)
    for camera, value in zip(views, found, strict=True):
        expected, cells = slow(grid, occupancy, camera, RAYS)
        # Where a ray has passed so much that it ends is a matter of steps, too.
        assert value == pytest.approx(expected, rel=3e-2, abs=1e-9)
        claims = claimed_by_view(grid, occupancy, camera, RAYS, REACH_SIGMAS)
        # A ray may graze a cell for less than the slow walk's step.
        assert len(cells ^ set(map(tuple, np.argwhere(claims)))) <= 2


def test_nothing_is_expected_where_all_is_known():
    states = np.full((6, 6, 6), State.FREE, np.int8)
    grid = PlanningGrid(LOW, EDGE, states)
    found = view_information(grid, expected_occupancy(states), cameras(0, 5), RAYS, REACH_SIGMAS)
    assert not found.any()


def test_wall_hides_what_is_behind_it():
    states = np.zeros((8, 3, 3), np.int8)
    states[3] = State.OCCUPIED
    grid = PlanningGrid(np.zeros(3), EDGE, states)
    along_x = RigidTransform.from_components(
        [-0.1, 0.075, 0.075], Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    )
    ahead = np.array([[0.0, 0.0, 1.0]])
    claims = claimed_by_view(grid, expected_occupancy(states), along_x, ahead, (0.0, 1.0))
    assert claims[:3, 1, 1].all() and claims.sum() == 3


def test_unknown_cells_beside_a_surface_are_likelier_than_those_in_the_air():
    states = np.full((20, 20, 12), State.UNKNOWN, np.int8)
    states[:8, :, 1:] = State.FREE
    states[:8, :, 0] = State.OCCUPIED
    occupancy = expected_occupancy(states)
    assert occupancy[8, 10, 0] > 3 * occupancy[8, 10, 6]
    assert occupancy[19, 10, 0] > 2 * occupancy[19, 10, 6]
    assert np.all(occupancy[states == State.FREE] == 0.0)
    assert np.all((occupancy >= 0.0) & (occupancy <= 1.0))


def test_relaxation_meets_the_equations_that_it_solves():
    grid = scene(7)
    how = ExpectedOccupancy(sweeps=200)
    p = expected_occupancy(grid.states, how)
    padded, ones = np.pad(p, 1), np.pad(np.ones_like(p), 1)
    shifts = [(axis, way) for axis in range(3) for way in (-1, 1)]
    inner = (slice(1, -1),) * 3
    total = sum(np.roll(padded, way, axis)[inner] for axis, way in shifts)
    count = sum(np.roll(ones, way, axis)[inner] for axis, way in shifts)
    measured = (grid.states != State.UNKNOWN).sum(axis=(0, 1))
    occupied = (grid.states == State.OCCUPIED).sum(axis=(0, 1))
    rate = (occupied + how.rate * how.count) / (measured + how.count)
    expected = how.neighbours * total / count + (1 - how.neighbours) * rate
    unknown = grid.states == State.UNKNOWN
    np.testing.assert_allclose(p[unknown], expected[unknown], atol=1e-9)


@pytest.mark.parametrize("shape, edge", [((3, 3), 0.1), ((0, 3, 3), 0.1), ((3, 3, 3), 0.0)])
def test_what_is_no_grid_is_refused(shape, edge):
    with pytest.raises(ValueError, match="planning grid"):
        PlanningGrid(LOW, edge, np.zeros(shape, np.int8))


@pytest.mark.parametrize("rate", [view_information, claimed_by_view])
def test_probabilities_of_another_grid_are_refused(rate):
    grid = scene(0)
    other = expected_occupancy(grid.states[:-1])
    with pytest.raises(ValueError, match=r"expected shape \(12, 10, 8\), got \(11, 10, 8\)"):
        rate(grid, other, cameras(1, 1)[0], RAYS, REACH_SIGMAS)


def test_planning_grid_is_the_map_by_its_bricks():
    voxels = scanned()
    grid = planning_grid(voxels)
    assert grid.resolution == pytest.approx(0.08)
    inner = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for brick in np.ndindex(grid.states.shape):
        states = voxels.states(voxels.grid.centres(np.array(brick) * 8 + inner))
        measured = np.count_nonzero(states != State.UNKNOWN)
        expected = State.FREE if measured >= 256 else State.UNKNOWN
        if np.any(states == State.OCCUPIED):
            expected = State.OCCUPIED
        assert grid.states[brick] == expected
