"""Placing again on a changing map gives what placing from nothing on the same map gives."""

import copy

import numpy as np
import pytest

from controllers.placement.reach.replanner import Mover, ReplanConfig, Replanner
from controllers.placement.spatial.occluders import before_plane, expand, occluders_of_voxels
from controllers.placement.spatial.search import SearchConfig, SpatialTask, best_view_of_all
from controllers.placement.task import Lens, Occluder, PlacementError, Target
from experiments.bench.mapping import frustum
from experiments.ch3.stereo.mapping_scene import Scene, look_at, see
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap

SCENE = Scene(
    np.array([[0.22, 0.1, 0.1, 0.05]]),
    np.array([[-0.1, -0.1, 0.0, 0.1, 0.1, 0.1], [-0.1, 0.16, 0.0, 0.1, 0.2, 0.3]]),
)
"""A work-piece whose top holds the target, a wall behind it and a ball beside it."""
TURN = 2.0 * np.pi * np.arange(8) / 8
RING = 0.02 * np.column_stack([np.cos(TURN), np.sin(TURN), np.zeros(8)])
HOLE = Target("hole", np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 1.0]), RING)
LENS = Lens(0.72, 510, 0.127, 0.4)
SEARCH = SearchConfig(level=3, rings=8, refine=False)
CONFIG = ReplanConfig(SEARCH, tile=4, face=0.035)


def insert(voxels, angles, rng):
    view = frustum()
    for angle in angles:
        eye = np.array([0.7 * np.cos(angle), 0.7 * np.sin(angle), 0.6])
        cloud = see(SCENE, look_at(eye, np.array([0.0, 0.0, 0.1])), rng)
        voxels.insert(cloud.transform_camera_to_world, view, cloud.points, cloud.covariances)


@pytest.fixture(scope="module")
def voxels():
    made = VoxelMap(VoxelGrid(0.02, (-0.6, -0.6, -0.1), (0.6, 0.6, 0.7)))
    insert(made, np.arange(0.2, 6.0, 1.5), np.random.default_rng(0))
    return made


def exhaustive(voxels, margin=0.0):
    """Return the best of all candidates, with all that may hide the target."""
    centres = before_plane(HOLE, voxels.grid.centres(voxels.occupied_cells()[0]), 0.035)
    near = np.abs(centres - HOLE.position).max(axis=1) < LENS.far
    field = expand(HOLE, occluders_of_voxels(centres[near], 0.02, 4), margin)
    return best_view_of_all(SpatialTask([field], LENS, voxels.probabilities, SEARCH))


def test_replan_is_the_exhaustive_optimum_with_few_hulls_made(voxels):
    plan = Replanner([HOLE], LENS, CONFIG).replan(voxels)
    assert plan.view.rating == pytest.approx(exhaustive(voxels).rating, rel=1e-12)
    assert plan.moves and plan.present is None
    assert 0 < plan.made < plan.tiles


def test_nothing_is_made_again_on_the_same_map(voxels):
    planner = Replanner([HOLE], LENS, CONFIG)
    first = planner.replan(voxels)
    again = planner.replan(voxels, first.view.position)
    assert again.made == 0 and not again.moves
    np.testing.assert_array_equal(again.view.position, first.view.position)


def test_after_a_change_it_plans_as_from_nothing():
    rng = np.random.default_rng(1)
    voxels = VoxelMap(VoxelGrid(0.02, (-0.6, -0.6, -0.1), (0.6, 0.6, 0.7)))
    insert(voxels, np.arange(0.2, 6.0, 1.5), rng)
    planner = Replanner([HOLE], LENS, CONFIG)
    planner.replan(voxels)
    for angle in (1.0, 2.5):
        insert(voxels, [angle], rng)
        kept = planner.replan(voxels)
        fresh = Replanner([HOLE], LENS, CONFIG).replan(voxels)
        assert kept.view.rating == fresh.view.rating
        assert kept.made <= fresh.made


def block(middle, half=0.02):
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return Mover(Occluder("block", np.asarray(middle) + corners), 0.002)


def test_camera_moves_when_something_hides_the_target_and_stays_for_a_small_gain(voxels):
    planner = Replanner([HOLE], LENS, CONFIG)
    first = planner.replan(voxels)
    between = HOLE.position + 0.6 * (first.view.position - HOLE.position)
    hidden = planner.replan(voxels, first.view.position, movers=[block(between)])
    assert hidden.moves and hidden.present is None
    field = expand(HOLE, [block(between).shape], 0.002)
    angles = field.to_frame(np.array([hidden.view.position, first.view.position]))
    assert hidden.view.rating < first.view.rating and not np.allclose(*angles)
    worse = first.view.position + [0.0, 0.0, 0.004]
    stays = planner.replan(voxels, worse)
    assert not stays.moves and stays.view.rating < first.view.rating
    assert first.view.rating < CONFIG.factor * stays.view.rating
    far = planner.replan(voxels, HOLE.position + 1.5 * (first.view.position - HOLE.position))
    assert far.moves and far.present is not None


def test_voxels_of_something_that_moves_leave_the_map(voxels):
    """The wall as a mover of known shape: its voxels count no more, only its shape."""
    wall = SCENE.boxes[1]
    corners = np.array([[x, y, z] for x in wall[::3] for y in wall[1::3] for z in wall[2::3]])
    away = Mover(Occluder("wall", corners + [0.0, 0.0, 0.0]), 0.02)
    planner = Replanner([HOLE], LENS, CONFIG)
    before = planner.replan(voxels).tiles
    assert planner.replan(voxels, movers=[away]).tiles < before


def test_secondary_target_is_watched_when_it_rates_higher(voxels):
    second = Target("edge", HOLE.position + [0.05, -0.05, 0.0], HOLE.normal, RING, 1e-6)
    both = Replanner([HOLE, second], LENS, CONFIG)
    ratings = {name: both.replan(voxels, watch=[name]).view.rating for name in ("hole", "edge")}
    best = both.replan(voxels).view
    assert best.rating == max(ratings.values()) == ratings[best.target]


def test_why_there_is_no_view_is_said(voxels):
    planner = Replanner([HOLE], LENS, CONFIG)
    with pytest.raises(PlacementError, match="'slot' is unknown; there are: hole"):
        planner.replan(voxels, watch=["slot"])
    inside = Target("sunk", np.array([0.0, 0.18, 0.15]), np.array([0.0, 0.0, 1.0]), RING)
    with pytest.raises(PlacementError, match="'sunk': nothing right before.*in an obstacle"):
        Replanner([inside], LENS, CONFIG).replan(voxels)
    empty = VoxelMap(copy.copy(voxels.grid))
    with pytest.raises(PlacementError, match="never seen"):
        planner.replan(empty)
    with pytest.raises(PlacementError, match="too near to occluder 'block'"):
        planner.replan(voxels, movers=[block(HOLE.position)])
    with pytest.raises(PlacementError, match="refused"):
        Replanner([HOLE], LENS, CONFIG).replan(voxels, accept=lambda view: False)
    with pytest.raises(ValueError, match="each of another name"):
        Replanner([HOLE, HOLE], LENS)
    with pytest.raises(ValueError, match="factor"):
        ReplanConfig(factor=0.9)


def test_views_from_where_the_camera_cannot_be_are_never_offered(voxels):
    def left(points):
        return points[:, 0] < 0.0

    offered = []

    def accept(view):
        offered.append(view.position)
        return True

    every = Replanner([HOLE], LENS, CONFIG)
    plan = every.replan(voxels, accept=accept, possible=left)
    asked = Replanner([HOLE], LENS, CONFIG).replan(
        voxels, accept=lambda view: bool(left(view.position[None])[0])
    )
    assert plan.view.rating == asked.view.rating and len(offered) == 1
    assert plan.view.position[0] < 0.0
    with pytest.raises(PlacementError, match="cannot be brought does not count as free"):
        every.replan(voxels, possible=lambda points: np.zeros(len(points), dtype=bool))
    assert every.replan(voxels).view.rating >= plan.view.rating
