"""Moving objects leave the map and come back; the camera follows without chatter."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.stats import norm

from controllers.placement.moving import (
    EMPTY,
    MovingObject,
    PlanarPose,
    cell_centres,
    covers,
    fit_outline,
    put_back,
    replace_camera,
    swollen,
    take_out,
)
from controllers.placement.planar.search import PlanarTask, RingCandidates, best_view
from controllers.placement.planar.sight import KnownSpace
from controllers.placement.task import Lens, PlacementError, Target

PANEL = MovingObject("panel", [[-1.5, -0.5], [1.5, -0.5], [1.5, 0.5], [-1.5, 0.5]])
COVARIANCE = np.diag([0.05, 0.05, 0.03]) ** 2
SPACE = KnownSpace(np.full((60, 60), 0.02), 0.2)
FEW = RingCandidates(16, 128)


def drawn(pose, generator):
    x, y, heading = generator.multivariate_normal([pose.x, pose.y, pose.heading], pose.covariance)
    return PlanarPose(x, y, heading)


def seen_points(pose, generator, deviation, sides=(0, 1)):
    """Points on some sides of the panel, with noise across."""
    points = []
    for side in sides:
        a, b = PANEL.outline[side], PANEL.outline[(side + 1) % 4]
        along = generator.uniform(0.05, 0.95, (40, 1))
        points.append(a + along * (b - a) + deviation * generator.standard_normal((40, 2)))
    return pose.to_world(np.concatenate(points))


def test_fitted_pose_is_consistent_with_its_covariance():
    generator = np.random.default_rng(1)
    prior_covariance = np.diag([0.1, 0.1, 0.1]) ** 2
    scores = []
    for _ in range(60):
        true = PlanarPose(*generator.uniform([4, 4, -3], [8, 8, 3]))
        prior = dataclasses.replace(drawn(
            dataclasses.replace(true, covariance=prior_covariance), generator),
            covariance=prior_covariance)  # fmt: skip
        fit = fit_outline(PANEL, seen_points(true, generator, 0.01), 0.01, prior)
        error = np.array([true.x - fit.x, true.y - fit.y, true.heading - fit.heading])
        scores.append(error @ np.linalg.solve(fit.covariance, error))
    assert np.mean(scores) == pytest.approx(3.0, abs=1.2)


def test_one_side_leaves_the_direction_along_it_to_the_prior():
    generator = np.random.default_rng(2)
    true = PlanarPose(6.0, 6.0, 0.0)
    prior = PlanarPose(6.05, 6.05, 0.02, np.diag([0.1, 0.1, 0.1]) ** 2)
    fit = fit_outline(PANEL, seen_points(true, generator, 0.01, sides=(0,)), 0.01, prior)
    along, across = np.sqrt(np.diag(fit.covariance))[:2]
    # The rounded normal of the fitted side lets a little of the heading through.
    assert along > 0.09
    assert across < 0.01
    assert fit.y == pytest.approx(6.0, abs=0.02)


def test_object_taken_out_of_the_map_leaves_measured_empty_cells():
    pose = PlanarPose(6.0, 6.0, 0.4)
    inside = covers(pose.to_world(PANEL.outline), cell_centres(SPACE))
    values = np.where(inside, 0.95, 0.5)
    values[5, 5] = 0.95
    mapped = dataclasses.replace(SPACE, probability=values)
    emptied = take_out(mapped, PANEL, dataclasses.replace(pose, covariance=COVARIANCE))
    assert np.all(emptied.probability[inside] == EMPTY)
    assert np.all(emptied.probability[~inside] == values[~inside])


def test_certain_object_is_put_back_as_its_cad():
    pose = PlanarPose(6.0, 6.0, 0.4)
    back = put_back(SPACE, PANEL, pose, np.random.default_rng(0), draws=3)
    inside = covers(pose.to_world(PANEL.outline), cell_centres(SPACE))
    np.testing.assert_allclose(back.probability, np.where(inside, 1.0, 0.02))


def test_uncertain_object_is_put_back_as_often_as_it_covers_a_cell():
    """Across a long side at a distance d, that is the normal distribution of d."""
    long = MovingObject("bar", [[-40, -1], [40, -1], [40, 1], [-40, 1]])
    pose = PlanarPose(6.0, 6.0, 0.0, np.diag([1e-9, 0.3**2, 1e-12]))
    empty = KnownSpace(np.zeros((60, 60)), 0.2)
    back = put_back(empty, long, pose, np.random.default_rng(1), draws=2000)
    heights = cell_centres(SPACE)[:, 0, 1] - 6.0
    expected = norm.cdf(1.0 - heights, scale=0.3) - norm.cdf(-1.0 - heights, scale=0.3)
    np.testing.assert_allclose(back.probability[:, 30], expected, atol=0.03)


def test_swollen_occluder_holds_the_object_in_all_but_few_drawn_poses():
    generator = np.random.default_rng(3)
    pose = PlanarPose(6.0, 6.0, 0.7, COVARIANCE)
    corners = swollen(PANEL, pose, 3.0).points
    corners = corners[ConvexHull(corners).vertices]
    held = [covers(corners, drawn(pose, generator).to_world(PANEL.outline)).all()
            for _ in range(1000)]  # fmt: skip
    assert np.mean(held) > 0.97
    still = swollen(PANEL, PlanarPose(6.0, 6.0, 0.7), 3.0).points
    assert ConvexHull(still).volume == pytest.approx(3.0)


def jittering_tasks(steps, generator):
    """A panel at rest beside the view, measured anew each step."""
    target = Target("slot", [6.0, 2.0], [0.0, 1.0], [[-0.2, 0.0], [0.2, 0.0]])
    pose = PlanarPose(6.0, 4.2, 0.0, COVARIANCE)
    for _ in range(steps):
        measured = dataclasses.replace(drawn(pose, generator), covariance=COVARIANCE)
        space = put_back(SPACE, PANEL, measured, generator, draws=50)
        yield PlanarTask((target,), Lens(0.72, 510, 2.5, 6.0), (swollen(PANEL, measured),), space)


@pytest.mark.parametrize(("factor", "fewest", "most"), [(1.0, 20, 30), (1.3, 1, 4)])
def test_camera_beside_a_jittering_object_moves_often_only_without_hysteresis(
    factor, fewest, most
):  # fmt: skip
    present, moves = None, 0
    for task in jittering_tasks(30, np.random.default_rng(4)):
        view, moved = replace_camera(task, present, factor, FEW)
        present, moves = view.position, moves + moved
        assert view.rating >= best_view(task, FEW).rating / factor * (1.0 - 1e-9)
    assert fewest <= moves <= most


def test_camera_moves_when_it_is_hidden():
    task = next(jittering_tasks(1, np.random.default_rng(5)))
    hidden = np.array([6.0, 5.2])
    view, moved = replace_camera(task, hidden, 100.0, FEW)
    assert moved
    assert view.rating > 0.0


def test_no_view_at_all_is_an_error_with_its_reason():
    task = next(jittering_tasks(1, np.random.default_rng(5)))
    blind = dataclasses.replace(task, space=KnownSpace(np.full((60, 60), 0.5), 0.2))
    with pytest.raises(PlacementError, match="not known to be free"):
        replace_camera(blind, None, 1.2, FEW)


def test_impossible_poses_objects_and_factors_are_refused():
    with pytest.raises(ValueError, match="negative variance"):
        PlanarPose(0.0, 0.0, 0.0, np.diag([1.0, -1.0, 0.0]))
    with pytest.raises(ValueError, match="object 'stick'.* no area"):
        MovingObject("stick", [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    with pytest.raises(ValueError, match=r"factor 0\.5"):
        replace_camera(next(jittering_tasks(1, np.random.default_rng(5))), None, 0.5)
    with pytest.raises(ValueError, match="full rank"):
        fit_outline(PANEL, np.zeros((3, 2)), 0.1, PlanarPose(0.0, 0.0, 0.0))
