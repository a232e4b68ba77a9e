"""Geometry and wrenches of the six contact states, against brute force and differences."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.insertion.contact import (
    STATES,
    CardInSlot,
    Touch,
    contact_at,
    contact_point,
    contacts_of,
    overlap,
    pose_in_state,
    turn,
    wrench_cone,
)

SHAPE = CardInSlot(0.10795, 0.1, 0.1143, 0.04, 0.03, 0.3)
STEEPEST = math.acos(SHAPE.card_width / SHAPE.slot_width)
TILTS = {4: STEEPEST + 0.05, 5: 0.7 * STEEPEST}
PLACES = {1: 0.006, 2: 0.02, 3: 0.004, 6: 0.015}


def pose_of(state: int, side: int) -> np.ndarray:
    return pose_in_state(SHAPE, state, side, TILTS.get(state, 0.08), PLACES.get(state, 0.0))


def deepest_point(pose: np.ndarray) -> float:
    """How far a grid of the card's points lies inside the walls, by brute force."""
    x = np.linspace(-0.5, 0.5, 217) * SHAPE.card_width
    y = np.linspace(-1.0, 0.0, 201) * SHAPE.card_length
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) @ turn(pose[2]).T + pose[:2]
    beside = np.abs(points[:, 0]) - SHAPE.slot_width / 2.0
    inside = np.minimum.reduce([beside, SHAPE.wall - beside, points[:, 1], 0.04 - points[:, 1]])
    return float(inside.max())


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("state", STATES)
def test_constructed_pose_closes_the_gaps_and_overlaps_nowhere(state, side):
    pose = pose_of(state, side)
    for contact in contacts_of(SHAPE, pose, state, side):
        assert contact.gap == pytest.approx(0.0, abs=1e-12)
        assert contact.excess < 1e-12
    assert overlap(SHAPE, pose) < 1e-12
    assert deepest_point(pose) < 1e-9


@pytest.mark.parametrize("state", STATES)
def test_moving_against_a_normal_overlaps(state):
    pose = pose_of(state, 1)
    for contact in contacts_of(SHAPE, pose, state, 1):
        moved = pose.copy()
        moved[:2] -= 2e-3 * (turn(pose[2]) @ contact.normal)
        assert overlap(SHAPE, moved) > 1e-4
        assert deepest_point(moved) > 1e-5


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("touch", Touch)
def test_gradient_of_a_gap_agrees_with_differences(touch, side):
    pose, step = np.array([0.003, -0.004, 0.11]), 1e-6
    gradient = contact_at(SHAPE, pose, touch, side).gradient
    for axis in range(3):
        move = step * np.eye(3)[axis]
        after = contact_at(SHAPE, pose + move, touch, side).gap
        before = contact_at(SHAPE, pose - move, touch, side).gap
        assert gradient[axis] == pytest.approx((after - before) / (2 * step), abs=1e-6)


def test_wedged_states_exist_on_either_side_of_the_angle_where_the_card_spans_the_mouth():
    assert pose_in_state(SHAPE, 4, 1, STEEPEST + 0.01).shape == (3,)
    assert pose_in_state(SHAPE, 5, 1, STEEPEST - 0.01).shape == (3,)
    for state, tilt in ((4, STEEPEST - 0.01), (5, STEEPEST + 0.01)):
        with pytest.raises(ValueError, match=f"state {state} does not exist"):
            pose_in_state(SHAPE, state, 1, tilt)


def test_printed_state_5_would_need_a_slot_narrower_than_the_card():
    """A corner on one wall and the other mouth corner on the leading edge, anywhere in the slot."""
    for depth in np.linspace(0.0, SHAPE.slot_depth, 9):
        assert math.hypot(SHAPE.slot_width, depth) > SHAPE.card_width


def test_states_1_and_3_have_the_printed_force_directions_in_the_slots_frame():
    """A-6: -f_x / f_y = tan theta without friction on the leading edge, tan alpha on the face."""
    pose = pose_of(1, -1)
    force = turn(pose[2]) @ contacts_of(SHAPE, pose, 1, -1)[0].normal
    assert -force[0] / force[1] == pytest.approx(math.tan(pose[2]))
    pose = pose_of(2, -1)
    force = turn(pose[2]) @ contacts_of(SHAPE, pose, 2, -1)[0].normal
    assert force[1] / force[0] == pytest.approx(math.tan(pose[2]))
    pose = pose_of(3, -1)
    force = turn(pose[2]) @ contacts_of(SHAPE, pose, 3, -1)[0].normal
    assert -force[0] / force[1] == pytest.approx(0.0)


@pytest.mark.parametrize("state", STATES)
def test_cone_holds_forces_within_the_angle_of_friction_and_their_moments(state):
    contacts = contacts_of(SHAPE, pose_of(state, 1), state, 1)
    cone = wrench_cone(contacts, SHAPE.friction)
    assert cone.shape == (3, 2 * len(contacts))
    for index, contact in enumerate(contacts):
        for column in cone[:, 2 * index : 2 * index + 2].T:
            angle = math.acos(column[:2] @ contact.normal / np.linalg.norm(column[:2]))
            assert angle == pytest.approx(math.atan(0.3))
            moment = np.cross([*contact.point, 0.0], [*column[:2], 0.0])[2]
            assert column[2] == pytest.approx(moment)


@pytest.mark.parametrize("state", [1, 2, 3, 6])
@pytest.mark.parametrize("side", [-1, 1])
def test_line_of_action_finds_the_contact_point(state, side):
    contact = contacts_of(SHAPE, pose_of(state, side), state, side)[0]
    rng = np.random.default_rng(0)
    cone = wrench_cone([contact], SHAPE.friction)
    for shares in rng.uniform(0.1, 3.0, (20, 2)):
        point = contact_point(SHAPE, cone @ shares)
        np.testing.assert_allclose(point, contact.point, atol=1e-12)


def test_a_force_that_pulls_the_card_ahead_has_no_contact_point():
    assert np.isnan(contact_point(SHAPE, np.array([0.1, 1.0, 0.0]))).all()


@pytest.mark.parametrize("state, side", [(0, 1), (7, 1), (1, 0)])
def test_states_that_are_none_are_refused(state, side):
    with pytest.raises(ValueError, match="expected states 1 to 6"):
        contacts_of(SHAPE, np.zeros(3), state, side)


@pytest.mark.parametrize(
    "field, value", [("card_width", 0.0), ("wall", math.nan), ("slot_width", 0.1)]
)
def test_shapes_that_are_none_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(SHAPE, **{field: value})
