"""The arm that a mapping controller knows stands where MuJoCo's does."""

import mujoco
import numpy as np
import pytest

from experiments.ch3.stereo.known_camera_arm import (
    body_pose,
    camera_in_world,
    known_body,
    known_camera_arm,
)
from models.compose import ARM_JOINTS, FieldConfig, RobotPlacement, make_model

MODEL = make_model(FieldConfig(texture_pixels=64), [RobotPlacement("rover1", (0.3, -0.2), 0.7)])
ARM = known_camera_arm(MODEL)
ANGLES = np.array([[0.0, 0.0, 0.0, 0.0], [0.5, 1.2, -1.8, 0.4], [-2.0, 0.3, 0.9, -1.0]])


def posed(angles: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(MODEL)
    for name, angle in zip(ARM_JOINTS, angles, strict=True):
        data.joint(f"rover1/{name}_joint").qpos = angle
    mujoco.mj_kinematics(MODEL, data)
    mujoco.mj_camlight(MODEL, data)
    return data


@pytest.mark.parametrize("angles", ANGLES)
def test_camera_stands_where_mujoco_puts_it(angles):
    data = posed(angles)
    chassis = body_pose(data, MODEL.body("rover1/chassis").id)
    found = chassis * ARM.camera_in_robot(angles)
    true = camera_in_world(MODEL, data, "rover1/stereo_left")
    np.testing.assert_allclose(found.as_matrix(), true.as_matrix(), atol=1e-12)


def test_many_angles_at_once_are_the_same_as_one_by_one():
    together = ARM.camera_in_robot(ANGLES).as_matrix()
    alone = [ARM.camera_in_robot(angles).as_matrix() for angles in ANGLES]
    np.testing.assert_allclose(together, alone, atol=1e-14)


def test_points_with_their_radius_cover_the_moving_collision_shapes():
    angles = ANGLES[1]
    data = posed(angles)
    chassis = body_pose(data, MODEL.body("rover1/chassis").id)
    points = chassis.apply(ARM.body_in_robot(angles[None])[0])
    generator = np.random.default_rng(0)
    moving = [
        MODEL.body(f"rover1/{n}").id for n in ("upper_arm", "forearm", "wrist", "stereo_head")
    ]
    for geom in np.flatnonzero(np.isin(MODEL.geom_bodyid, moving) & (MODEL.geom_group == 3)):
        centre, half = MODEL.geom_aabb[geom, :3], MODEL.geom_aabb[geom, 3:]
        inside = centre + generator.uniform(-half, half, (200, 3))
        world = inside @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        nearest = np.linalg.norm(world[:, None] - points, axis=2).min(axis=1)
        assert nearest.max() <= ARM.body_radius


def test_spheres_cover_the_rover_and_not_its_arm():
    spheres = known_body(MODEL)
    low, high = spheres[:, :3].min(axis=0) - 0.03, spheres[:, :3].max(axis=0) + 0.03
    # Table D-1: some 0.45 m long; wheels of 0.0487 m stand 0.14 m to each side of the middle.
    assert 0.38 < high[1] - low[1] < 0.5 and 0.3 < high[0] - low[0] < 0.4
    assert high[2] < 0.12


@pytest.mark.parametrize("bad", [np.zeros(3), np.full(4, np.nan), np.zeros((2, 2, 4))])
def test_bad_angles_are_refused(bad):
    with pytest.raises(ValueError, match="arm angles"):
        ARM.camera_in_robot(bad)
