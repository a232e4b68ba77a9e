"""A robot that has seen the target knows its camera's pose, whatever its tilt."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import (
    CameraPose,
    LocalizationConfig,
    camera_in_level,
    level_target,
    localize,
    tilt_to_level,
)
from models.datasheets import ARM
from twin.describe import describe_rover
from twin.realism import as_stated
from twin.sensor_bank import tilt

HOME = np.array(ARM.home)
TARGET = RigidTransform.from_components([0.2, 1.1, 0.05], Rotation.from_euler("zx", [0.3, 1.2]))


@pytest.fixture(scope="module")
def arm():
    return SerialChain.of_robot(as_stated(describe_rover(), "default"))


def test_tilt_is_that_of_the_inclinometer():
    pitch, roll, yaw = 0.04, -0.07, 0.9
    turned = Rotation.from_euler("z", yaw) * tilt_to_level(np.array([pitch, roll])).rotation
    np.testing.assert_allclose(tilt(*turned.as_quat(scalar_first=True)), [pitch, roll, yaw])


def test_world_of_a_target_is_level_and_holds_its_origin():
    to_world = level_target(TARGET)
    up = (to_world * TARGET.inv()).rotation.apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(to_world.apply([0.0, 0.0, 0.0]), 0.0, atol=1e-12)
    assert to_world.rotation.apply([1.0, 0.0, 0.0])[1] == pytest.approx(0.0, abs=1e-12)


def test_camera_is_found_where_it_truly_is_after_arm_and_base_have_moved(arm):
    place = RigidTransform.from_components([-0.4, 0.7, 0.0], Rotation.from_euler("z", 2.0))
    before, after = np.array([0.01, -0.02]), np.array([-0.015, 0.005])
    seen = CameraPose(place * tilt_to_level(before) * arm.tool_in_robot(HOME), np.zeros((6, 6)))
    localization = localize(arm, HOME, before, seen)
    angles = HOME + [0.8, 0.2, -0.3, 0.4]
    found = localization.camera(angles, after)
    true = place * tilt_to_level(after) * arm.tool_in_robot(angles)
    np.testing.assert_allclose(
        found.transform_camera_to_world.as_matrix(), true.as_matrix(), atol=1e-12
    )


def test_covariance_is_that_of_drawn_errors(arm):
    """The base has errors of its own at the target and now; head and joints have one each."""
    rng = np.random.default_rng(0)
    angles = HOME + [0.8, 0.2, -0.3, 0.4]
    level = np.zeros(2)
    seen = CameraPose(camera_in_level(arm, HOME, level), 1e-8 * np.eye(6))
    nominal = localize(arm, HOME, level, seen)
    base, lasting = nominal.config.base_covariance(), arm.error_covariance()
    first, second = (
        RigidTransform.from_exp_coords(rng.multivariate_normal(np.zeros(6), base, 4000))
        for _ in range(2)
    )
    errors = rng.multivariate_normal(np.zeros(10), lasting, 4000)
    head, zeros = RigidTransform.from_exp_coords(errors[:, :6]), errors[:, 6:]
    shift = RigidTransform.from_exp_coords(1e-4 * rng.standard_normal((4000, 6)))
    at_target = shift * seen.transform_camera_to_world
    place = at_target * (camera_in_level(arm, HOME + zeros, level) * head).inv() * first
    true = place * second * camera_in_level(arm, angles + zeros, level) * head
    estimate = nominal.camera(angles, level).transform_camera_to_world
    drawn = np.cov((true * estimate.inv()).as_exp_coords().T)
    claimed = nominal.camera(angles, level).covariance
    np.testing.assert_allclose(np.sqrt(np.diag(claimed)), np.sqrt(np.diag(drawn)), rtol=0.05)
    placed = np.cov((place * nominal.transform_level_to_world.inv()).as_exp_coords().T)
    claimed = nominal.robot_covariance()
    np.testing.assert_allclose(np.sqrt(np.diag(claimed)), np.sqrt(np.diag(placed)), rtol=0.05)


def test_an_inclinometer_whose_zero_is_off_tilts_the_level_frame_by_that(arm):
    rng = np.random.default_rng(2)
    config = LocalizationConfig(tilt=0.0, yaw=0.0, place=0.0, tilt_zero=0.004)
    robot = RigidTransform.from_components([-0.4, 0.7, 0.0], Rotation.from_euler("z", 2.0))
    level = np.zeros(2)
    seen = CameraPose(robot * camera_in_level(arm, HOME, level), np.zeros((6, 6)))
    nominal = localize(arm, HOME, level, seen, config)
    placed = [
        localize(arm, HOME, off, seen, config).transform_level_to_world
        for off in 0.004 * rng.standard_normal((2000, 2))
    ]
    xi = [(pose * nominal.transform_level_to_world.inv()).as_exp_coords() for pose in placed]
    np.testing.assert_allclose(nominal.covariance, np.cov(np.transpose(xi)), atol=1.5e-6)
    assert nominal.covariance[0, 0] == pytest.approx(0.004**2)


def test_prior_moves_with_what_is_shared_as_the_camera_truly_does(arm):
    """The localization has a small error, and so have the head's mounting and the joints."""
    rng = np.random.default_rng(1)
    place, seat = 1e-4 * rng.standard_normal((2, 6))
    zeros = 1e-4 * rng.standard_normal(4)
    angles, level = HOME + [0.8, 0.2, -0.3, 0.4], np.zeros(2)
    robot = RigidTransform.from_components([-0.4, 0.7, 0.0], Rotation.from_euler("z", 2.0))
    head = RigidTransform.from_exp_coords(seat)
    sighting = robot * camera_in_level(arm, HOME + zeros, level) * head
    estimate = RigidTransform.from_exp_coords(-place) * sighting
    localization = localize(arm, HOME, level, CameraPose(estimate, np.zeros((6, 6))))
    prior = localization.prior(angles, level, np.arange(16))
    moved = prior.at(np.concatenate([place, seat, zeros]))
    true = robot * camera_in_level(arm, angles + zeros, level) * head
    np.testing.assert_allclose(moved.as_matrix(), true.as_matrix(), atol=2e-7)


def test_target_on_its_side_defines_no_direction():
    side = RigidTransform.from_rotation(Rotation.from_euler("y", np.pi / 2))
    with pytest.raises(ValueError, match="upright"):
        level_target(side)
