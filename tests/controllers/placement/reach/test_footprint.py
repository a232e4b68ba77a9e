"""A rover of some outline goes where its outline fits, and one flood fill knows all places."""

import numpy as np
import pytest

from controllers.placement.reach.footprint import TURNING, Part, pose_drives
from controllers.placement.reach.ground import Ground, drives

CELL = 0.02
BASE = (-0.165, 0.165, -0.221, 0.221)
ARM = (-0.05, 0.05, -0.10, 0.24)
ORIGIN = np.zeros(3)


def ground(free, known=None):
    """Return 3 x 3 m about the origin: free where a function of x, y says so."""
    axis = (np.arange(150) + 0.5) * CELL - 1.5
    x, y = np.meshgrid(axis, axis)
    chance = np.where(free(x, y), 0.01, 0.9)
    if known is not None:
        chance[~known(x, y)] = np.nan
    return Ground(chance, np.array([-1.5, -1.5]), CELL)


def everywhere(x, y):
    return np.ones_like(x, dtype=bool)


def touched(box, pose, chance):
    """Whether a box at a pose touches a cell that is not free, by points 2 mm apart in the box."""
    x, y = np.meshgrid(np.linspace(*box[:2], 166), np.linspace(*box[2:], 222))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    columns = np.floor((c * x - s * y + pose[0] + 1.5) / CELL).astype(int)
    rows = np.floor((s * x + c * y + pose[1] + 1.5) / CELL).astype(int)
    return bool(np.any(~(chance[rows, columns] < 0.05)))


@pytest.fixture(scope="module")
def cluttered():
    """Thirty things anywhere but where the rover stands, half of them high up."""
    rng = np.random.default_rng(3)
    places = rng.uniform(-1.4, 1.4, (60, 2))
    places = places[np.abs(places).max(axis=1) > 0.4][:30]

    def free_of(things):
        return lambda x, y: (
            np.min(np.hypot(x[..., None] - things[:, 0], y[..., None] - things[:, 1]), axis=-1)
            > 0.03
        )

    low, high = ground(free_of(places[:15])), ground(free_of(places[15:]))
    return low, high, pose_drives([Part(BASE, low), Part(ARM, high)], [0.01, 0.01, 0.3], 3.0)


def test_rover_anywhere_within_an_enterable_cell_and_heading_touches_nothing(cluttered):
    low, high, found = cluttered
    rng = np.random.default_rng(0)
    k, rows, columns = np.nonzero(found.enterable)
    for index in rng.choice(len(k), 300, replace=False):
        middle = low.centres(np.array([[rows[index], columns[index]]]))[0]
        turn = 0.3 + (k[index] + rng.uniform(-0.5, 0.5)) * 2.0 * np.pi / 32
        pose = np.append(middle + rng.uniform(-0.5, 0.5, 2) * CELL, turn)
        assert not touched(BASE, pose, low.probability)
        assert not touched(ARM, pose, high.probability)


def test_most_poses_with_two_centimetres_to_spare_are_enterable(cluttered):
    low, high, found = cluttered
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.uniform(-1.1, 1.1, (400, 2)), rng.uniform(-np.pi, np.pi, 400)])
    wide = np.array([-0.04, 0.04, -0.04, 0.04])
    clear = [
        not touched(tuple(BASE + wide), pose, low.probability)
        and not touched(tuple(ARM + wide), pose, high.probability)
        for pose in poses
    ]
    free, _ = found.lengths(poses[clear])
    assert sum(clear) > 50 and free.mean() > 0.9


def test_way_touches_nothing_and_drives_along_its_heading(cluttered):
    low, high, found = cluttered
    rng = np.random.default_rng(2)
    k, rows, columns = np.nonzero(np.isfinite(found.costs))
    for index in rng.choice(len(k), 20, replace=False):
        middle = low.centres(np.array([[rows[index], columns[index]]]))[0]
        goal = np.append(middle, 0.3 + k[index] * np.pi / 16)
        poses = found.poses(goal)
        np.testing.assert_array_equal(poses[[0, -1]], [found.start, goal])
        for one, other in zip(poses[1:-2], poses[2:-1], strict=True):
            moved = other[:2] - one[:2]
            if not moved.any():
                assert abs(np.angle(np.exp(1j * (other[2] - one[2])))) < np.pi / 16 + 1e-9
                continue
            assert other[2] == one[2] and np.hypot(*moved) < 1.5 * CELL
            along = np.angle(moved[0] + 1j * moved[1]) - one[2] - np.pi / 2
            assert abs(np.angle(np.exp(2j * along))) / 2 < np.pi / 32 + 1e-6
            assert not touched(BASE, other, low.probability)
            assert not touched(ARM, other, high.probability)
        way = found.way(goal)
        length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
        # The start lies off the middle of its cell.
        assert length <= found.lengths(goal[None])[1][0] + 2 * CELL


def test_rover_passes_lengthwise_where_a_circle_about_it_does_not():
    def gate(x, y):
        return (np.abs(y - 0.5) > 0.1) | (np.abs(x) < 0.24)

    start, goal = [0.0, -0.2, 0.0], np.array([[0.0, 1.1, 0.0]])
    free = pose_drives([Part(BASE, ground(gate))], start, 3.0)
    _, cost = free.lengths(goal)
    assert cost[0] == pytest.approx(1.3, abs=0.03)
    assert not free.lengths(np.array([[0.0, 0.5, np.pi / 2]]))[0][0]
    circle = drives(ground(gate), start, 0.276, 3.0)
    assert np.isinf(circle.lengths(goal)[1][0])


def test_sideways_costs_two_turns():
    found = pose_drives([Part(BASE, ground(everywhere))], ORIGIN, 3.0)
    ahead, beside = found.lengths(np.array([[0.01, 0.51, 0.0], [0.51, 0.01, 0.0]]))[1]
    assert ahead == pytest.approx(0.5) and beside == pytest.approx(0.5 + np.pi * TURNING)
    way = found.way(np.array([0.51, 0.01, 0.0]))
    assert way.shape == (27, 2) and np.abs(way[:, 1]).max() <= 0.01 + 1e-12


def test_what_stands_beside_the_arm_is_in_the_way_of_the_base_alone():
    def post(x, y):
        return np.hypot(x - 0.13, y - 0.6) > 0.02

    bare, posted = ground(everywhere), ground(post)
    goal = np.array([[0.0, 0.6, 0.0]])
    for low, high, fits in ((bare, posted, True), (posted, bare, False)):
        found = pose_drives([Part(BASE, low), Part(ARM, high)], ORIGIN, 2.0)
        assert found.lengths(goal)[0][0] == fits


def test_rover_may_leave_ground_that_it_hides_but_not_what_it_touches():
    def hidden(x, y):
        return (np.abs(x) > 0.16) | (np.abs(y) > 0.21)

    goal = np.array([[0.0, 0.8, 0.0]])
    unseen = pose_drives([Part(BASE, ground(everywhere, hidden))], ORIGIN, 2.0)
    assert np.isfinite(unseen.lengths(goal)[1][0])
    held = pose_drives([Part(BASE, ground(hidden))], ORIGIN, 2.0)
    assert np.isinf(held.lengths(goal)[1][0])


def test_gap_is_never_more_than_the_distance_to_where_the_rover_can_be(cluttered):
    low, _, found = cluttered
    rng = np.random.default_rng(4)
    points = rng.uniform(-1.5, 1.5, (200, 2))
    centres = low.centres(np.argwhere(np.isfinite(found.costs).any(axis=0)))
    nearest = np.linalg.norm(points[:, None] - centres, axis=2).min(axis=1)
    gaps = found.gaps(points)
    assert np.all(gaps <= nearest) and np.all(gaps >= nearest - 3.0 * CELL)
    assert found.gaps(np.array([[5.0, 0.0]]))[0] == 0.0


def test_bad_questions_are_refused():
    part = Part(BASE, ground(everywhere))
    with pytest.raises(ValueError, match="at least one part"):
        pose_drives([], ORIGIN, 1.0)
    with pytest.raises(ValueError, match="needs a multiple of 8"):
        pose_drives([part], ORIGIN, 1.0, 12)
    with pytest.raises(ValueError, match="outside of the map"):
        pose_drives([part], [9.0, 0.0, 0.0], 1.0)
    found = pose_drives([part], ORIGIN, 0.5)
    with pytest.raises(ValueError, match="no collision-free way"):
        found.way(np.array([0.0, 0.9, 0.0]))
