"""Exact sight on the plane, occluders from maps, and the safety of hulls."""

import math

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from controllers.placement.moving import cell_centres, covers
from controllers.placement.planar.field import free_cap
from controllers.placement.planar.occluders import expand, occluders_of_map
from controllers.placement.planar.sight import KnownSpace, sees_on_map, separated
from controllers.placement.task import Occluder, Target
from experiments.ch4.planar.scenes import convex_obstacle

SLOT = Target("slot", [5.0, 5.0], [1.0, 0.0], [[0.0, -0.5], [0.0, 0.5]])


def hulls_meet(first, second):
    """Whether convex hulls of points meet, by a linear program over their weights."""
    n, m = len(first), len(second)
    rows = np.zeros((4, n + m))
    rows[:2] = np.hstack([first.T, -second.T])
    rows[2, :n] = rows[3, n:] = 1.0
    return linprog(np.zeros(n + m), A_eq=rows, b_eq=[0, 0, 1, 1]).status == 0


def test_separating_axes_agree_with_a_linear_program():
    generator = np.random.default_rng(1)
    met = 0
    for _ in range(80):
        obstacle = convex_obstacle(generator.uniform(0.0, 6.0, 2), 1.5, generator)
        camera, outline = generator.uniform(0.0, 6.0, 2), generator.uniform(2.0, 4.0, (2, 2))
        meet = hulls_meet(np.vstack([camera, outline]), obstacle)
        assert separated(*camera, outline, obstacle) == (not meet)
        met += meet
    assert 10 < met < 70


def hull_says_visible(occluders, target, camera):
    """Whether the line to the reduced target misses all expanded hulls."""
    hulls = expand(occluders, target)
    offset = camera - target.position
    angle = math.atan2(offset[1], offset[0])
    return free_cap(hulls.hulls, angle, 0.0, float(np.hypot(*offset))) > 0.0


def test_a_target_visible_past_hulls_of_a_map_is_visible_on_the_map():
    generator = np.random.default_rng(2)
    seen = given_up = 0
    for _ in range(80):
        occupied = generator.random((20, 20)) < 0.08
        occupied[8:13, 8:13] = False
        space = KnownSpace(np.where(occupied, 0.9, 0.02), 0.5)
        camera = generator.uniform(0.0, 10.0, 2)
        visible = hull_says_visible(occluders_of_map(space), SLOT, camera)
        truly = sees_on_map(space, camera, SLOT)
        assert truly or not visible
        seen, given_up = seen + truly, given_up + (truly and not visible)
    assert seen > 15
    assert given_up < 0.6 * seen


def test_line_of_sight_stops_at_an_occupied_cell_and_passes_beside_it():
    values = np.full((20, 20), 0.01)
    values[10, 14] = 0.9
    space = KnownSpace(values, 0.5)
    assert not sees_on_map(space, [9.0, 5.25], SLOT)
    assert sees_on_map(space, [9.0, 8.0], SLOT)
    box = np.array([[7.0, 5.0], [7.5, 5.0], [7.5, 5.5], [7.0, 5.5]])
    outline = SLOT.position + SLOT.outline
    assert not separated(9.0, 5.25, outline, box)
    assert separated(9.0, 8.0, outline, box)


def test_occluders_of_a_map_hold_all_its_occupied_cells():
    generator = np.random.default_rng(3)
    occupied = generator.random((30, 30)) < 0.3
    space = KnownSpace(np.where(occupied, 0.9, 0.02), 0.2, (-1.0, 2.0))
    occluders = occluders_of_map(space)
    centres = cell_centres(space)[occupied]
    held = [
        covers(occluder.points[ConvexHull(occluder.points).vertices], centres)
        for occluder in occluders
    ]
    assert np.all(np.any(held, axis=0))


def test_target_inside_a_walled_room_is_not_covered_by_the_hull_of_the_wall():
    occupied = np.zeros((40, 40), dtype=bool)
    occupied[[5, -5], 5:-4] = occupied[5:-4, [5, -5]] = True
    space = KnownSpace(np.where(occupied, 0.9, 0.02), 0.25)
    camera = np.array([7.0, 5.0])
    whole = [Occluder("wall", cell_centres(space)[occupied])]
    assert not hull_says_visible(whole, SLOT, camera)
    assert hull_says_visible(occluders_of_map(space), SLOT, camera)


def test_a_box_stays_one_occluder_with_its_own_corners():
    occupied = np.zeros((20, 20), dtype=bool)
    occupied[3:9, 4:16] = True
    occluders = occluders_of_map(KnownSpace(np.where(occupied, 0.9, 0.02), 0.5))
    assert [occluder.name for occluder in occluders] == ["cluster 1"]
    assert sorted(map(tuple, occluders[0].points)) == [(2, 1.5), (2, 4.5), (8, 1.5), (8, 4.5)]


def test_cells_of_the_target_itself_do_not_hide_it():
    values = np.full((20, 20), 0.02)
    values[9:11, 9:11] = 0.9
    space = KnownSpace(values, 0.5)
    assert len(occluders_of_map(space)) == 1
    assert occluders_of_map(space, [SLOT]) == ()
