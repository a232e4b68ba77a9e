"""The closed-form inverse against the chain's own forward kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.kinematics.arm_inverse import GripperInverse, parallel_views
from controllers.kinematics.serial_chain import SerialChain
from models.datasheets import ARM, ROVER
from twin.describe import describe_rover

GRIP = np.array([0.0, ARM.wrist_length, 0.0])
DRAWN = describe_rover()
assert DRAWN.arm is not None
CHAIN = SerialChain.from_description(DRAWN.arm, RigidTransform.from_translation(GRIP))
INVERSE = GripperInverse(CHAIN, GRIP)


def task_of(angles):
    """Place of the grip point and pitch of the wrist, the sum of the pitching joints."""
    return np.append(CHAIN.tool_in_robot(angles).translation, np.sum(angles[1:]))


def test_inverse_holds_the_angles_that_the_task_came_from_and_only_solutions():
    for angles in np.random.default_rng(1).uniform(*CHAIN.limits.T, (50, 4)):
        task = task_of(angles)
        found = INVERSE.solutions(task, near=angles)
        np.testing.assert_allclose(found[0], angles, atol=1e-6)
        for solution in found:
            reached = task_of(solution)
            np.testing.assert_allclose(reached[:3], task[:3], atol=1e-9)
            turns = (reached[3] - task[3]) / (2.0 * np.pi)
            assert turns == pytest.approx(round(turns), abs=1e-9)


def test_out_of_reach_gives_none_and_nonsense_is_refused():
    assert len(INVERSE.solutions([0.0, 2.0, 0.0, 0.0])) == 0
    with pytest.raises(ValueError, match="yaw's axis"):
        INVERSE.solutions([0.0, ROVER.arm_mount[1], 0.2, 0.0])
    with pytest.raises(ValueError, match="gripper task"):
        INVERSE.solutions([0.0, np.nan, 0.0, 0.0])
    with pytest.raises(ValueError, match="beside the arm's plane"):
        GripperInverse(CHAIN, [0.01, 0.1, 0.0])
    with pytest.raises(ValueError, match="grip point"):
        GripperInverse(CHAIN, [0.0, 0.1])


def test_parallel_views_hold_the_angles_that_a_view_came_from_and_only_such():
    arm = SerialChain.of_robot(DRAWN)
    beside = arm.tool_in_robot(np.zeros(4)).translation
    for angles in np.random.default_rng(3).uniform(*arm.limits.T, (100, 4)):
        angles[0] = 0.0  # Straight ahead, so that other cameras in the plane are ahead and up.
        camera = arm.tool_in_robot(angles)
        ahead = camera.rotation.apply([0.0, 0.0, 0.5])
        if abs(ahead[2]) > 0.499:
            continue
        cameras = camera.translation + [[0.0, 0.0, 0.0], [0.0, 0.03, 0.02], [0.01, 0.0, 0.0]]
        assert camera.translation[0] == pytest.approx(beside[0])
        itself, near, aside = parallel_views(arm, cameras, ahead)
        assert np.nanmin(np.abs(itself - angles).max(axis=1)) < 1e-6
        assert np.isnan(aside).all()
        for place, postures in ((cameras[0], itself), (cameras[1], near)):
            for found in postures[np.isfinite(postures).all(axis=1)]:
                assert np.all((found >= arm.limits[:, 0]) & (found <= arm.limits[:, 1]))
                reached = arm.tool_in_robot(found)
                np.testing.assert_allclose(reached.translation, place, atol=1e-8)
                np.testing.assert_allclose(reached.rotation.apply([0, 0, 0.5]), ahead, atol=1e-8)
