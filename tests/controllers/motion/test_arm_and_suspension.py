"""The gripper's kinematics against MuJoCo, and the reduced suspension against pushes."""

import mujoco
import numpy as np
import pytest

from controllers.kinematics.arm_model import ArmModel
from controllers.motion.suspension import Corner, reduce_suspension
from experiments.appa.control.plant import PLAIN
from experiments.ch3.stereo.known_camera_arm import body_pose, known_camera_arm
from models.compose import ARM_JOINTS, RobotPlacement, make_model, settle
from models.datasheets import ARM, ROVER

TYRE = 3.1e6  # of one contact [N/m], README of the rover


@pytest.fixture(scope="module")
def rover():
    return make_model(PLAIN, [RobotPlacement("rover1")])


@pytest.fixture(scope="module")
def arm(rover):
    return ArmModel(known_camera_arm(rover), rover.site("rover1/gripper").pos)


def drawn(arm, rng):
    return rng.uniform(*arm.limits.T)


def test_gripper_and_jacobian_are_mujocos(rover, arm):
    data, rng = mujoco.MjData(rover), np.random.default_rng(0)
    site, dofs = (
        rover.site("rover1/gripper").id,
        [rover.joint(f"rover1/{n}_joint").dofadr[0] for n in ARM_JOINTS],
    )
    for _ in range(5):
        angles = drawn(arm, rng)
        for name, angle in zip(ARM_JOINTS, angles):
            data.joint(f"rover1/{name}_joint").qpos = angle
        mujoco.mj_forward(rover, data)
        chassis = body_pose(data, rover.body("rover1/chassis").id)
        place = chassis.inv().apply(data.site_xpos[site])
        np.testing.assert_allclose(arm.task(angles)[:3], place, atol=1e-12)
        linear, angular = np.zeros((2, 3, rover.nv))
        mujoco.mj_jacSite(rover, data, linear, angular, site)
        true = np.vstack([linear[:, dofs], angular[:, dofs]])
        np.testing.assert_allclose(arm.jacobian(angles), true, atol=1e-12)


def test_inverse_holds_the_angles_that_the_task_came_from_and_only_solutions(arm):
    rng = np.random.default_rng(1)
    for _ in range(50):
        angles = drawn(arm, rng)
        task = arm.task(angles)
        found = arm.inverse(task, near=angles)
        np.testing.assert_allclose(found[0], angles, atol=1e-6)
        for solution in found:
            reached = arm.task(solution)
            np.testing.assert_allclose(reached[:3], task[:3], atol=1e-9)
            turns = (reached[3] - task[3]) / (2.0 * np.pi)
            assert turns == pytest.approx(round(turns), abs=1e-9)


def test_out_of_reach_gives_none_and_nonsense_is_refused(arm):
    assert len(arm.inverse([0.0, 2.0, 0.0, 0.0])) == 0
    with pytest.raises(ValueError, match="yaw's axis"):
        arm.inverse([0.0, ROVER.arm_mount[1], 0.2, 0.0])
    with pytest.raises(ValueError, match="gripper task"):
        arm.inverse([0.0, np.nan, 0.0, 0.0])
    assert np.linalg.matrix_rank(arm.task_jacobian(ARM.home)) == 4


def corners():
    """The rover's: the springs hold up, the braked wheels roll and so hold nothing forward."""
    return [
        Corner((x * ROVER.half_track, y * ROVER.half_wheelbase, -ROVER.centre_height),
               (0.0, 0.0, ROVER.spring), (0.0, 0.0, TYRE))
        for x in (-1, 1) for y in (-1, 1)
    ]  # fmt: skip


def test_reduced_suspension_is_what_pushing_the_compiled_rover_shows():
    model = make_model(PLAIN, [RobotPlacement("rover1", arm=False)])
    rest, body = settle(model), model.body("rover1/chassis").id
    reduced = reduce_suspension(corners())
    weight = ROVER.sprung_mass * 9.81 * (ROVER.sprung_height - ROVER.wheel_radius)

    def moved(force, couple):
        data = mujoco.MjData(model)
        mujoco.mj_copyData(data, model, rest)
        data.xfrc_applied[body] = [0.0, 0.0, force, couple, 0.0, 0.0]
        mujoco.mj_step(model, data, 1500)
        pitch = np.arcsin(data.xmat[body, 7]) - np.arcsin(rest.xmat[body, 7])
        return data.xpos[body, 2] - rest.xpos[body, 2], pitch

    assert -10.0 / moved(-10.0, 0.0)[0] == pytest.approx(reduced[2, 2], rel=0.01)
    assert 3.0 / moved(0.0, 3.0)[1] == pytest.approx(reduced[3, 3] - weight, rel=0.01)


def test_off_centre_push_tilts_and_rigid_corners_are_refused():
    moved = reduce_suspension(corners(), about=(0.0, 0.05, 0.0))
    assert moved[2, 3] == pytest.approx(-0.05 * moved[2, 2])
    rigid = Corner((0.0, 0.0, 0.0), (np.inf,) * 3, (np.inf,) * 3)
    with pytest.raises(ValueError, match="both rigid"):
        reduce_suspension([rigid])
    with pytest.raises(ValueError, match="three numbers >= 0"):
        Corner((0.0, 0.0, 0.0), (1.0, 1.0, -1.0), (1.0, 1.0, 1.0))
