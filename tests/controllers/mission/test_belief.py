"""What a rover of the mission believes: where the slot, the other rover and its card are."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.card_arm import CardArm
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.mission.belief import MissionBelief, stood, tilt_of
from controllers.mission.radio import SlotPose
from tests.controllers.mission.hand_made import (
    HOME,
    MASTER,
    POSES,
    ROVERS,
    SITE,
    SLAVE,
    belief_of,
    localized,
    transform_robot_to_ground,
)
from tests.controllers.motion.seen import seen_at
from twin.robot import Observation, RobotError

SLOT = SITE.insertion.transform_slot_to_ground
TILT = np.array([0.06, -0.03])


def test_localization_and_the_site_drawing_give_the_slot_pose() -> None:
    slot, covariance = localized(MASTER).slot_in_level()
    expected = transform_robot_to_ground(MASTER).inv() * SLOT
    np.testing.assert_allclose(slot.as_matrix(), expected.as_matrix(), atol=1e-9)
    # The drawing's error and that of the localization, each a thousandth of a radian.
    assert np.sqrt(np.trace(covariance[:3, :3])) == pytest.approx(math.sqrt(6.0) * 1e-3)


def test_slot_in_a_tilted_rover_is_moved_by_its_tilt() -> None:
    belief = localized(MASTER)
    slot, _ = belief.slot_in_robot(TILT)
    back = tilt_to_level(TILT) * slot
    np.testing.assert_allclose(back.as_matrix(), belief.slot_in_level()[0].as_matrix(), atol=1e-12)


def test_a_rover_that_is_not_localized_says_nothing_of_the_slot() -> None:
    belief = belief_of(MASTER)
    assert belief.slot_now() is None
    assert belief.partner_place() is None
    assert len(belief.discs()) == len(SITE.structures)


def test_slot_now_is_that_of_the_rover_where_odometry_has_it() -> None:
    belief = localized(SLAVE)
    for tick in range(1, 101):  # A second at a radian a second: a wheel's radius.
        belief.navigator.observe(seen_at(0.01 * tick, np.ones(4)))
    now = belief.slot_now()
    assert now is not None
    forward = RigidTransform.from_translation([0.0, ROVERS[SLAVE].wheel_radius, 0.0])
    expected = (transform_robot_to_ground(SLAVE) * forward).inv() * SLOT
    np.testing.assert_allclose(
        now.transform_slot_to_robot.as_matrix(), expected.as_matrix(), atol=2e-3
    )
    assert np.linalg.eigvalsh(now.covariance).min() > 0.0
    assert now.covariance[4, 4] > 1e-5  # The drive's own error beside that of the panel.


def test_card_is_where_both_localizations_and_the_slaves_joints_have_it() -> None:
    master, slave = localized(MASTER), localized(SLAVE)
    card = CardArm(ROVERS[SLAVE], SITE.insertion.tip).transform_card_to_robot(HOME)
    told = slave.slot_now()
    assert told is not None
    found = tilt_to_level(TILT) * master.card_in_robot(TILT, told, card)
    expected = transform_robot_to_ground(MASTER).inv() * transform_robot_to_ground(SLAVE) * card
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=1e-9)


def test_the_other_rovers_place_is_kept_off_and_more_of_it_where_it_is_not_sure() -> None:
    belief = localized(MASTER)
    tilted = transform_robot_to_ground(SLAVE) * RigidTransform.from_rotation(
        Rotation.from_euler("xy", [0.1, -0.1])
    )
    sure = SlotPose(tilted.inv() * SLOT, np.zeros((6, 6)))
    belief.partner = sure
    assert len(belief.discs()) == len(SITE.structures) + 1
    np.testing.assert_allclose(belief.discs()[-1], [*POSES[SLAVE][:2], 0.27], atol=1e-9)
    np.testing.assert_allclose(belief.partner_place(), POSES[SLAVE][:2], atol=1e-9)
    known = np.diag([0.0, 0.0, 0.0, 0.015, 0.02, 0.0]) ** 2
    belief.partner = dataclasses.replace(sure, covariance=known)
    # Seven degrees of tilt leave the level part of 2.5 cm nearly as it is.
    assert belief.discs()[-1, 2] == pytest.approx(0.32, abs=1e-3)
    belief.partner = dataclasses.replace(sure, covariance=np.eye(6))
    assert belief.discs()[-1, 2] == pytest.approx(0.37)


def test_a_missing_inclinometer_stops_the_mission_with_its_name() -> None:
    with pytest.raises(RobotError, match="inclinometer of rover1 is missing"):
        tilt_of(Observation(0.0), MASTER)


def test_what_stands_on_the_mapped_ground_hides_the_slot_too() -> None:
    """A pillar of 0.3 m in ground that slopes by a tenth; slot and partner are in other hands."""
    belief = localized(MASTER)
    ground, to_map = belief.navigator.ground.newest, belief.transform_ground_to_map
    centres = ground.grid.centres.reshape(-1, 2)
    in_map = np.column_stack([centres, np.zeros(len(centres))])
    places = np.asarray(to_map.apply(in_map, inverse=True))[:, :2].reshape(*ground.grid.shape, 2)
    slope = to_map.translation[2] + 0.1 * places[..., 0]
    about = np.linalg.norm(places, axis=-1) < 2.0
    ground.heights[about], ground.variances[about] = slope[about], 1e-6
    for x, y in ((0.6, 0.1), (0.0, 0.1)):  # The pillar, and what is mapped of the slot.
        ground.heights[np.abs(places - (x, y)).max(axis=-1) < 0.05] += 0.3
    assert not len(belief.map.voxels.surface().means)
    points = belief.mapped_ground().points
    assert np.abs(points[:, :2] - (0.6, 0.1)).max() < 0.07
    above = points[:, 2] - 0.1 * points[:, 0]
    assert above.max() == pytest.approx(0.3, abs=0.01) and -1e-3 < above.min() < 0.03
    # As many as voxels of a cell's side in the pillar, whose rim may lie beside it.
    assert len(points) == pytest.approx(0.1 * 0.1 * 0.3 / ground.grid.cell**3, rel=0.3)
    occluders = belief.mapped_ground().occluders(np.array([0.0, 0.0, 0.3]), np.array([1.0, 0, 0]))
    assert len(occluders) > 0


def drifted(belief: MissionBelief, rise: float, sigma: float) -> RobotLocalization:
    """Return where a localized rover believes to be, so much too high, by its odometry."""
    found = belief.navigator.localization()
    up = RigidTransform.from_translation([0.0, 0.0, rise])
    covariance = np.diag(np.square([0.004, 0.004, 0.01, 0.03, 0.03, sigma]))
    return dataclasses.replace(
        found,
        transform_level_to_world=up * found.transform_level_to_world,
        covariance=covariance,
        by_arm=np.zeros_like(found.by_arm),
    )


@pytest.mark.parametrize("sigma", [0.05, 0.2])
def test_the_ground_tells_a_height_that_has_drifted(sigma: float) -> None:
    """As a filter of one number does it, where errors of the tilt are small."""
    belief = localized(MASTER)
    true = belief.navigator.odometry.level_pose()
    found = drifted(belief, 0.15, sigma)
    to_map, height = belief.transform_ground_to_map, ROVERS[MASTER].centre_height
    standing = stood(found, to_map, height)
    assert standing is not None
    error = standing.transform_level_to_world.translation - true.translation
    share = sigma**2 / (sigma**2 + 0.03**2)
    assert error[2] == pytest.approx(0.15 * (1.0 - share), abs=0.005)
    assert np.abs(error[:2]).max() < 0.005
    left = float(standing.robot_covariance()[5, 5])
    assert left == pytest.approx(sigma**2 * (1.0 - share), rel=0.15)
    assert stood(standing, to_map, height) is None  # It tells nothing twice.


def test_on_a_field_that_slopes_the_height_is_that_above_its_plane() -> None:
    belief = localized(MASTER)
    found = drifted(belief, 0.0, 0.1)
    to_map, height = belief.transform_ground_to_map, ROVERS[MASTER].centre_height
    slope = RigidTransform.from_rotation(Rotation.from_euler("x", 0.15))
    below = to_map * slope
    standing = stood(found, below, height)
    assert standing is not None
    up = below.rotation.apply([0.0, 0.0, 1.0])
    off, left = (
        float((pose.translation - below.translation) @ up) - height
        for pose in (found.transform_level_to_world, standing.transform_level_to_world)
    )
    assert abs(off) > 0.03 and abs(left) < 0.2 * abs(off)


def test_a_rover_that_stays_takes_its_height_from_the_ground_after_a_long_way_alone() -> None:
    belief = localized(SLAVE)
    navigator = belief.navigator
    belief.stay()
    before = navigator.odometry.level_pose().translation[2]
    navigator.odometry.localize(drifted(belief, 0.1, 0.02), 0.0)
    belief.stay()  # On this short way such a drift is none.
    assert navigator.odometry.level_pose().translation[2] == pytest.approx(before + 0.1)
    navigator.odometry.distance += 20.0
    belief.stay()
    assert navigator.odometry.level_pose().translation[2] == pytest.approx(before, abs=0.02)
    assert belief.localization is not None
    assert belief.localization.robot_covariance()[5, 5] < 0.032**2
