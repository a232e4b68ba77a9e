"""Expansion: the sum of occluder and mirrored target, clusters of voxels, and bad shapes."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from controllers.placement.spatial.field import free_caps
from controllers.placement.spatial.occluders import before_plane, expand, occluders_of_voxels
from controllers.placement.task import Occluder, PlacementError, Target
from tests.controllers.placement.spatial.scenes import box, disc_target


def skewed_target():
    """An outline that is not symmetric, so that mirroring shows."""
    outline = np.array([[0.03, 0.0, 0.0], [-0.01, 0.01, 0.0], [-0.01, -0.01, 0.0]])
    return Target("slot", np.zeros(3), np.array([0.0, 0.0, 1.0]), outline)


def test_a_box_grows_by_the_mirrored_target():
    field = expand(skewed_target(), [box("block", [0.2, 0.0, 0.1], [0.05, 0.05, 0.05])])
    corners = field.shapes[0]
    np.testing.assert_allclose(corners.min(axis=0), [0.15 - 0.03, -0.06, 0.05])
    np.testing.assert_allclose(corners.max(axis=0), [0.25 + 0.01, 0.06, 0.15])


def test_volume_of_box_and_box_is_that_of_a_larger_box():
    outline = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * 0.01
    target = Target("cube", np.zeros(3), np.array([0.0, 0.0, 1.0]), outline)
    shape = expand(target, [box("block", [0.2, 0.0, 0.1], [0.05, 0.04, 0.03])]).shapes[0]
    assert ConvexHull(shape).volume == pytest.approx(8 * 0.06 * 0.05 * 0.04)


def test_margin_holds_a_ball_about_every_corner():
    block = box("block", [0.2, 0.0, 0.1], [0.05, 0.04, 0.03])
    margin = 0.007
    planes = ConvexHull(expand(disc_target(), [block], margin).shapes[0]).equations
    plain = expand(disc_target(), [block]).shapes[0]
    depth = -(plain @ planes[:, :3].T + planes[:, 3]).max()
    assert margin * (1.0 - 1e-9) <= depth <= 1.3 * margin


def test_what_lies_behind_the_targets_plane_hides_nothing():
    plate = box("plate", [0.0, 0.0, -0.02], [0.3, 0.3, 0.02])
    field = expand(disc_target(), [plate])
    assert field.names == ()
    assert free_caps(field, [[0.0, 0.0, 0.2]])[0] == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("height", [0.02, 0.005])
def test_target_in_or_at_an_occluder_is_an_answer_that_names_it(height):
    with pytest.raises(PlacementError, match="target 'hole'.*'block 2'"):
        blocks = [box("block 1", [0.3, 0, 0.1], [0.05] * 3)]
        blocks.append(box("block 2", [0.0, 0.0, height], [0.05, 0.05, height]))
        expand(disc_target(), blocks)


def test_segment_becomes_a_hull_by_a_target_across_it():
    wire = Occluder("wire", np.array([[0.1, 0.0, 0.1], [0.1, 0.0, 0.3]]))
    assert ConvexHull(expand(disc_target(), [wire]).shapes[0]).volume > 0.0


def test_flat_sum_is_refused_by_name_unless_it_has_a_margin():
    sheet = Occluder("sheet", np.array([[0.1, 0, 0.1], [0.2, 0, 0.1], [0.2, 0.1, 0.1]]))
    with pytest.raises(ValueError, match="occluder 'sheet'.*in a plane"):
        expand(disc_target(), [sheet])
    assert expand(disc_target(), [sheet], 0.001).names == ("sheet",)
    point = Target("point", np.zeros(3), np.array([0.0, 0.0, 1.0]), np.zeros((1, 3)))
    wire = Occluder("wire", np.array([[0.1, 0.0, 0.1], [0.1, 0.0, 0.3], [0.1, 0.0, 0.4]]))
    with pytest.raises(ValueError, match="occluder 'wire'.*in a line"):
        expand(point, [wire])


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((3, 4)), [[np.nan, 0, 0]]])
def test_occluder_without_proper_points_is_refused_by_name(points):
    with pytest.raises(ValueError, match="occluder 'odd'"):
        Occluder("odd", np.asarray(points))


def test_planar_occluder_is_refused_in_space_by_name():
    with pytest.raises(ValueError, match="occluder 'flat': has two coordinates, expected three"):
        expand(disc_target(), [Occluder("flat", np.ones((3, 2)))])


def test_voxel_hulls_hold_every_voxel_and_leave_a_bay_free():
    """A horseshoe of voxels: one hull of it all would swallow the target in its middle."""
    cell = 0.01
    keys = np.argwhere(np.ones((20, 20, 6), dtype=bool)) + [-10, -10, 0]
    bay = (np.abs(keys[:, 0]) < 7) & (keys[:, 1] > -7)
    centres = (keys[~bay] + 0.5) * cell
    parts = occluders_of_voxels(centres, cell, tile=8)
    planes = [ConvexHull(part.points).equations for part in parts]
    depths = [(centres @ p[:, :3].T + p[:, 3]).max(axis=1) for p in planes]
    np.testing.assert_allclose(np.min(depths, axis=0).max(), -cell / 2)
    field = expand(disc_target(position=[0.0, 0.0, 0.005]), parts)
    assert free_caps(field, [[0.0, 0.0, 0.3]])[0] > 0.3
    with pytest.raises(PlacementError):
        expand(disc_target(position=[0.0, 0.0, 0.005]), [Occluder("whole", centres)])


def test_margins_that_are_not_one_for_each_occluder_are_refused():
    blocks = [box(f"block {k}", [0.0, 0.0, 0.1 + k], 0.02) for k in range(3)]
    with pytest.raises(ValueError, match=r"margin of shape \(2,\): expected one, or 3"):
        expand(disc_target(), blocks, [0.001, 0.002])


def test_voxels_apart_are_two_occluders_and_none_are_none():
    two = np.array([[0.005, 0.005, 0.005], [0.045, 0.005, 0.005]])
    assert len(occluders_of_voxels(two, 0.01)) == 2
    assert occluders_of_voxels(np.empty((0, 3)), 0.01) == []
    with pytest.raises(ValueError, match="map: centres"):
        occluders_of_voxels(np.zeros((4, 2)), 0.01, name="map")


def test_points_before_the_plane_are_higher_than_its_own_voxels():
    target = disc_target(position=[0.1, 0.2, 0.3], normal=[0.0, 0.0, -1.0])
    heights = np.array([-0.5, 0.0, 0.019, 0.021, 0.4])
    points = target.position + np.outer(heights, target.normal) + [0.3, -0.2, 0.0]
    np.testing.assert_array_equal(before_plane(target, points, 0.02), points[3:])
