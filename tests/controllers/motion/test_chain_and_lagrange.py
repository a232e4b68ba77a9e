"""Dynamics of the chain and of the nine coordinates against independent models."""

import dataclasses

import mujoco
import numpy as np
import pytest

from controllers.kinematics.chain import Chain, FrameState, Joint
from controllers.kinematics.serial_arm import (
    BaseMotion,
    JointMotion,
    RigidBody,
    arm_wrench,
    frame_motions,
)
from controllers.motion.lagrange import controllability_rank, observability_rank
from experiments.appa.control.control import ranks
from experiments.appa.control.plant import PLAIN, model_errors, planar_plant
from experiments.ch2.known_arm import known_arm
from experiments.ch3.stereo.known_camera_arm import body_pose
from models.compose import ARM_JOINTS, RobotPlacement, make_model

NOTHING = RigidBody(0.0, np.zeros(3), np.zeros((3, 3)))


@pytest.fixture(scope="module")
def arm():
    return known_arm(make_model(PLAIN, [RobotPlacement("rover1")]))


@pytest.fixture(scope="module")
def plant():
    return planar_plant()


def test_mass_matrix_bias_and_efforts_are_mujocos_at_random_states(plant):
    errors = model_errors(plant, 100, np.random.default_rng(1))
    assert errors.shape == (100, 3)
    assert errors.max() < 1e-12


def test_wrench_at_the_base_is_that_of_the_vectorised_newton_euler(arm):
    rng = np.random.default_rng(0)
    q, rates, accelerations = rng.normal(size=(3, 4))
    force, omega, alpha = rng.normal(size=(3, 3))
    wrench = Chain.of_arm(arm).inverse_dynamics(
        q, rates, accelerations, FrameState(force, omega, alpha)
    )[1]
    bare = dataclasses.replace(arm, base=NOTHING)
    frames = frame_motions(
        bare,
        JointMotion(q[None], rates[None], accelerations[None]),
        BaseMotion(force[None], omega[None], alpha[None]),
    )
    np.testing.assert_allclose(wrench, arm_wrench(bare, frames)[0], atol=1e-12)


def test_tip_wrench_enters_by_the_jacobian_transposed(plant):
    """A force along the base's slide is felt there in full, whatever the arm's pose."""
    q, still = np.zeros(9), np.zeros(9)
    push = np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    felt = plant.coordinates.efforts(q, still, still, push) - plant.coordinates.bias(q, still)
    np.testing.assert_allclose(felt[[0, 1, 4]], [2.0, 0.0, 2.0], atol=1e-12)


def test_push_of_the_last_body_is_carried_as_inverse_dynamics_has_it(arm):
    rng = np.random.default_rng(4)
    slide = Joint(NOTHING, rng.normal(size=3), np.eye(3), np.array([0.6, 0.0, 0.8]), slides=True)
    chain = Chain([slide, *Chain.of_arm(arm).joints])
    q, still = rng.normal(size=5), np.zeros(5)
    efforts, wrench = chain.carried(q)
    rest = chain.inverse_dynamics(q, still, still)
    for column, push in enumerate(np.eye(6)):
        pushed = chain.inverse_dynamics(q, still, still, tip=push)
        np.testing.assert_allclose(efforts[:, column], pushed[0] - rest[0], atol=1e-12)
        np.testing.assert_allclose(wrench[:, column], pushed[1] - rest[1], atol=1e-12)


def test_twelve_states_are_controllable_and_observable_with_springs_by_the_arm_alone(plant):
    found = ranks(plant)
    assert found["controllability/printed"] == found["observability/printed"] == 12
    assert found["controllability/arm_motors_only"] == 12
    assert found["observability/arm_angles_only"] == 12
    assert found["controllability/arm_motors_only_no_springs"] == 6


def test_ranks_are_those_of_a_known_system():
    a = np.array([[0.0, 1.0, 0.0], [-4.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    assert controllability_rank(a, np.array([[0.0], [1.0], [0.0]])) == 2
    assert observability_rank(a, np.array([[1.0, 0.0, 1.0]])) == 3


def test_bad_chains_and_states_are_refused(arm):
    bent = Joint(NOTHING, np.zeros(3), np.eye(3), np.array([0.0, 0.0, 2.0]))
    with pytest.raises(ValueError, match="axis of joint 0"):
        Chain([bent])
    with pytest.raises(ValueError, match="without joints"):
        Chain([])
    with pytest.raises(ValueError, match="joint positions"):
        Chain.of_arm(arm).mass_matrix([0.0, np.nan, 0.0, 0.0])


def test_last_frame_is_mujocos_wrist():
    model = make_model(PLAIN, [RobotPlacement("rover1")])
    data, chain = mujoco.MjData(model), Chain.of_arm(known_arm(model))
    rng = np.random.default_rng(6)
    base, wrist = (model.body(f"rover1/{name}").id for name in ("arm_base_link", "wrist"))
    for angles in rng.uniform(-2.0, 2.0, (20, 4)):
        for name, angle in zip(ARM_JOINTS, angles, strict=True):
            data.joint(f"rover1/{name}_joint").qpos = angle
        mujoco.mj_kinematics(model, data)
        true = body_pose(data, base).inv() * body_pose(data, wrist)
        np.testing.assert_allclose(chain.last_frame(angles), true.as_matrix(), atol=1e-9)


def test_last_frame_of_a_slide_is_shifted_along_its_axis():
    slide = Joint(NOTHING, np.array([0.1, 0.0, 0.0]), np.eye(3), np.array([0.0, 1.0, 0.0]), True)
    turn = Joint(NOTHING, np.zeros(3), np.eye(3), np.array([0.0, 0.0, 1.0]))
    frame = Chain([turn, slide]).last_frame([np.pi / 2, 0.3])
    np.testing.assert_allclose(frame[:3, 3], [-0.3, 0.1, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="positions"):
        Chain([turn, slide]).last_frame([0.1])
