"""Euler angles as printed agree with the rigid transform in the plane, and nowhere else."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tests.controllers.insertion.printed_frames import (
    base_in_camera,
    euler_angles,
    pose_of,
    printed_angles,
    required_motion,
    three_points,
    turn_of,
)


def pose(place, **turns: float) -> RigidTransform:
    """A body in the camera's frame, turned about one or more of its axes in turn."""
    turn = Rotation.from_euler("".join(turns).upper(), list(turns.values()))
    return RigidTransform.from_components(place, turn)


def apart(first: RigidTransform, second: RigidTransform) -> tuple[float, float]:
    """Distance [m] and angle [rad]."""
    between = first.inv() * second
    return float(np.linalg.norm(between.translation)), float(between.rotation.magnitude())


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("turn", [-2.0, -0.4, 0.0, 0.3, 1.4])
def test_rotation_about_one_axis_is_recovered_exactly(axis, turn):
    if axis == "y" and abs(turn) > np.pi / 2:
        turn /= 2.0
    body = pose([0.1, -0.05, 0.6], **{axis: turn})
    assert euler_angles(three_points(body))["xyz".index(axis)] == pytest.approx(turn)
    assert max(apart(pose_of(three_points(body)), body)) < 1e-9


def test_planar_motion_is_that_of_the_rigid_transform():
    rng = np.random.default_rng(0)
    for _ in range(30):
        card = pose([*rng.uniform(-0.2, 0.2, 2), 0.5], z=rng.uniform(-3.0, 3.0))
        goal = pose([*rng.uniform(-0.2, 0.2, 2), 0.5], z=rng.uniform(-3.0, 3.0))
        motion = required_motion(three_points(goal), three_points(card))
        rigid = goal * card.inv()
        assert max(apart(motion.moved(card), goal)) < 1e-9
        assert max(apart(motion.moved(card), rigid * card)) < 1e-9
        np.testing.assert_allclose(motion.angles[:2], 0.0, atol=1e-9)


@pytest.mark.parametrize("slant", [0.2, 0.5, 1.0])
def test_motion_in_a_plane_seen_aslant_is_not(slant):
    """The same planar turn of 0.3 rad, seen by a tilted camera: eq. 5-4 misses the goal."""
    camera = pose([0.0, 0.0, 0.6], x=slant)
    card, goal = camera * pose([0.0, 0.0, 0.0], z=0.2), camera * pose([0.1, 0.0, 0.0], z=0.5)
    motion = required_motion(three_points(goal), three_points(card))
    place, turn = apart(motion.moved(card), goal)
    assert place < 1e-12  # the translation is right in any case
    assert turn > 0.025 * slant  # 1.6 degrees at 1 rad
    assert max(apart((goal * card.inv()) * card, goal)) < 1e-9


def test_angles_of_a_general_attitude_are_not_the_factors_of_the_transform():
    body = pose([0.1, 0.1, 0.5], x=0.4, y=0.3, z=0.5)
    angles = euler_angles(three_points(body))
    assert angles[0] == pytest.approx(0.4)  # R^x is first, so it alone is recovered exactly
    # The factors themselves would give the attitude.
    assert (turn_of([0.4, 0.3, 0.5]).inv() * body.rotation).magnitude() < 1e-12
    assert apart(pose_of(three_points(body)), body)[1] > 0.05


def test_printed_denominator_depends_on_where_the_body_is_and_the_mended_does_not():
    places = [0.0, 0.0, 0.5], [0.2, 0.1, 0.5], [-0.3, 0.2, 0.5]
    bodies = [three_points(pose(place, y=0.3), 0.05) for place in places]
    mended = [euler_angles(body)[1] for body in bodies]
    np.testing.assert_allclose(mended, 0.3)
    printed = [printed_angles(body)[1] for body in bodies]
    assert printed[0] == pytest.approx(-0.3)  # the sign is the other one
    assert np.ptp(printed) > 0.05
    for index in (0, 2):
        np.testing.assert_allclose(
            [printed_angles(body)[index] for body in bodies], euler_angles(bodies[0])[index]
        )


def test_bases_are_related_by_the_effector_that_both_know():
    rng = np.random.default_rng(1)
    base = pose(rng.uniform(-1.0, 1.0, 3), z=0.4, x=0.2)  # in the camera
    effector = pose([0.0, 0.4, 0.1], z=0.3, x=-0.2)  # in the base
    assert max(apart(base_in_camera(base * effector, effector), base)) < 1e-9


def test_what_is_no_three_points_is_refused():
    for wrong in (np.zeros((2, 3)), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="three finite"):
            euler_angles(wrong)
