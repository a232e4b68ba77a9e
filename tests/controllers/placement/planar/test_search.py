"""The search on the plane, against rating every candidate and against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.placement.planar.arc_search import arc_optimum, search_rings
from controllers.placement.planar.field import free_cap
from controllers.placement.planar.occluders import expand
from controllers.placement.planar.search import (
    PlanarTask,
    RingCandidates,
    axis_of,
    best_view,
    rating_field,
    view_from,
)
from controllers.placement.planar.sight import KnownSpace
from controllers.placement.task import (
    Exponents,
    Lens,
    Occluder,
    PlacementError,
    Target,
    rate_view,
    rating_terms,
)
from experiments.ch4.planar.scenes import random_task

LENS = Lens(0.72, 510, 1.0, 5.0)
HOLE = Target("hole", [0.0, 0.0], [0.0, 1.0], [[-0.1, 0.0], [0.1, 0.0]])
FREE = KnownSpace(np.full((240, 240), 0.0), 0.05, (-6.0, -6.0))
FEW = RingCandidates(12, 128)
EVEN = Exponents()


def task(occluders=(), space=FREE, exponents=EVEN, targets=(HOLE,)):
    return PlanarTask(tuple(targets), LENS, tuple(occluders), space, exponents)


def wall_at(elevation):
    """A thick wall whose expanded edge is at an elevation behind the hole, and extends far."""
    edge = 0.5 * np.array([math.cos(math.pi - elevation), math.sin(math.pi - elevation)])
    edge -= [0.1, 0.0]
    return Occluder("wall", [edge, edge + [-9.0, 0.0], [-9.5, -0.1], [edge[0], -0.1]])


def test_wall_behind_the_hole_puts_the_camera_at_60_degrees_and_nearest():
    """RF ~ sin(phi) min(phi, 2 pi / 3 - phi) has its only peak at phi = pi / 3."""
    view = best_view(task([wall_at(math.pi / 3)]), RingCandidates(64, 1000))
    offset = view.position - HOLE.position
    assert math.degrees(math.atan2(offset[1], offset[0])) == pytest.approx(60.0, abs=0.01)
    assert view.distance == pytest.approx(LENS.near)
    assert view.free_cap == pytest.approx(math.pi / 3, abs=1e-4)


def test_nothing_in_the_way_puts_the_camera_head_on_and_nearest():
    view = best_view(task())
    np.testing.assert_allclose(view.position, [0.0, 1.0], atol=1e-9)
    assert view.rating == pytest.approx(1.0 / (LENS.pixel_per_metre * 1.0) * math.pi / 2)


@pytest.mark.parametrize("density", [0.05, 0.2, 0.35])
def test_fast_search_finds_the_best_of_all_candidates(density):
    for seed in range(8):
        scene = random_task(density, np.random.default_rng([seed, 7]))
        every = best_view(scene, FEW, search_rings, refine=False)
        fast = best_view(scene, FEW, refine=False)
        assert fast.rating == pytest.approx(every.rating, rel=1e-12)
        assert best_view(scene, FEW).rating >= every.rating * (1.0 - 1e-12)


@pytest.mark.parametrize("values", [(1, 1, 0, 1), (1, 0.5, 2, 0), (1, 0, 1, 3), (0, 2, 0.5, 0.5)])
def test_fast_search_is_exact_under_any_exponents(values):
    for seed in range(4):
        scene = random_task(0.2, np.random.default_rng([seed, 8]))
        scene = dataclasses.replace(scene, exponents=Exponents(*values))
        every = best_view(scene, FEW, search_rings, refine=False)
        fast = best_view(scene, FEW, refine=False)
        assert fast.rating == pytest.approx(every.rating, rel=1e-12)


def test_exhaustive_search_is_the_plain_loop_over_equation_4_1():
    scene = random_task(0.2, np.random.default_rng(5))
    target, few = scene.targets[0], RingCandidates(6, 64)
    hulls, axis = expand(scene.occluders, target).hulls, axis_of(target)
    terms = rating_terms(scene.lens, target, EVEN)
    best = 0.0
    for radius in few.distances(scene.lens):
        for k in range(64):
            angle = 2.0 * math.pi * k / 64
            direction = np.array([math.cos(axis + angle), math.sin(axis + angle)])
            column, row = np.floor(target.position + radius * direction).astype(int)
            if not (0 <= row < 100 and 0 <= column < 100):
                continue
            cap = free_cap(hulls, axis, angle, radius)
            occupancy = scene.space.probability[row, column]
            rating = rate_view(terms, radius, cap, float(direction @ target.normal), occupancy)
            best = max(best, rating if cap > 0.0 else 0.0)
    primary = dataclasses.replace(scene, targets=(target,))
    found = best_view(primary, few, search_rings, refine=False)
    assert found.rating == pytest.approx(best, rel=1e-9)


def test_optimum_of_an_arc_is_that_of_a_fine_grid():
    generator = np.random.default_rng(6)
    for _ in range(50):
        low, high = np.sort(generator.uniform(-np.pi / 2, np.pi / 2, 2))
        field, oblique = generator.uniform(0.0, 3.0, 2)
        angle, value = arc_optimum(low, high, field, oblique)
        grid = np.linspace(low, high, 5001)[1:-1]
        values = np.minimum(grid - low, high - grid) ** field * np.cos(grid) ** oblique
        assert low < angle < high
        assert value >= values.max() * (1.0 - 1e-9)


def test_camera_is_placed_only_where_the_map_is_free():
    scene = random_task(0.2, np.random.default_rng(11))
    view = best_view(scene)
    column, row = np.floor(view.position).astype(int)
    assert scene.space.probability[row, column] < 0.05
    assert view.occupancy == scene.space.probability[row, column]


def test_view_from_the_best_place_is_the_best_view():
    scene = random_task(0.35, np.random.default_rng(12))
    best = best_view(scene)
    again = view_from(scene, best.position)
    assert (again.target, again.rating) == (best.target, pytest.approx(best.rating, rel=1e-6))


def test_view_from_a_place_is_of_the_target_that_rates_best_there():
    other = Target("mark", [0.5, 0.0], [0.0, 1.0], HOLE.outline, relation_error=0.01)
    for targets in ((HOLE, other), (other, HOLE)):
        assert view_from(task(targets=targets), np.array([0.0, 2.0])).target == "hole"
    ratings = rating_field(task(targets=(HOLE, other)), np.array([[0.0, 2.0], [0.0, -2.0]]))
    assert ratings.shape == (2, 2)
    assert ratings[0, 0] > ratings[1, 0] > 0.0 and not ratings[:, 1].any()


def test_rating_field_turns_with_the_target():
    turned = dataclasses.replace(HOLE, normal=[1.0, 0.0], outline=[[0.0, 0.1], [0.0, -0.1]])
    along = rating_field(task(), np.array([[1.0, 2.0]]))
    np.testing.assert_allclose(
        rating_field(task(targets=(turned,)), np.array([[2.0, -1.0]])), along, rtol=1e-9
    )


def test_rings_go_from_the_near_to_the_far_limit():
    np.testing.assert_allclose(RingCandidates(5).distances(LENS), [1.0, 2.0, 3.0, 4.0, 5.0])
    np.testing.assert_allclose(RingCandidates(1).distances(LENS), [1.0])


def test_occluder_barely_ahead_of_the_face_or_near_the_far_limit_still_hides():
    low = Occluder("low", [[0.6, -0.1], [0.9, -0.1], [0.9, 0.1], [0.6, 0.1]])
    beyond = Occluder("beyond", [[-1.0, 4.95], [1.0, 4.95], [1.0, 5.2], [-1.0, 5.2]])
    aside = np.array([[3.0, 0.3]])
    assert rating_field(task(), aside)[0, 0] > 0.0
    assert rating_field(task([low]), aside)[0, 0] == 0.0
    far = np.array([[0.0, 4.99]])
    assert rating_field(task(), far)[0, 0] > 0.0
    assert rating_field(task([beyond]), far)[0, 0] == 0.0


def test_hidden_primary_target_gives_way_to_the_secondary():
    lid = Occluder("lid", [[-0.5, 0.2], [0.5, 0.2], [0.5, 0.3], [-0.5, 0.3]])
    other = Target("mark", [3.0, 0.0], [0.0, 1.0], HOLE.outline, relation_error=0.01)
    assert best_view(task(targets=(HOLE, other))).target == "hole"
    assert best_view(task([lid], targets=(HOLE, other))).target == "mark"


def test_reason_says_what_hides_the_target():
    ring = [
        Occluder(f"block {i}", 0.6 * np.array([math.cos(a), math.sin(a)]) + 0.35 * box)
        for i, a in enumerate(np.linspace(0.0, math.pi, 7))
        for box in [np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])]
    ]
    with pytest.raises(PlacementError, match=r"'hole': of 1536 poses 50.* behind it, 49.* hidden "
                                             r"\(most by occluder 'block \d'\), 0 %"):  # fmt: skip
        best_view(task(ring), FEW)


def test_reason_says_what_is_unknown():
    unknown = KnownSpace(np.full((240, 240), 0.5), 0.05, (-6.0, -6.0))
    with pytest.raises(PlacementError, match="0 % hidden, 49.* % not known to be free"):
        best_view(task(space=unknown), FEW)


def test_reason_names_the_obstacle_that_covers_the_target():
    cover = Occluder("rock", [[-1, -1], [1, -1], [1, 1], [-1, 1]])
    with pytest.raises(PlacementError, match="'hole': occluder 'rock'.* covers it"):
        best_view(task([cover]))


def test_unknown_target_is_refused_with_those_that_there_are():
    with pytest.raises(ValueError, match="'slot' is unknown: expected one of 'hole'"):
        task().target("slot")


def test_impossible_maps_and_candidates_are_refused():
    with pytest.raises(ValueError, match="numbers from 0 to 1"):
        KnownSpace(np.array([[np.nan]]), 1.0)
    with pytest.raises(ValueError, match="directions 3"):
        RingCandidates(1, 3)
    with pytest.raises(ValueError, match="2 are called 'hole'"):
        task(targets=(HOLE, HOLE))
