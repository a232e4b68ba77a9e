"""Roll of the complete rover: the laboratory by closed forms, and what the robot tells of it."""

import numpy as np
import pytest

from controllers.identification.swing_plane import ROLL
from experiments.ch2.rover.laboratory import laboratory_roll
from experiments.ch2.rover.roll import LEVER, roll_errors
from experiments.ch2.rover.trial import RoverTrial, run_rover_trial
from models.compose import RobotPlacement
from tests.models.scenes import make_scene


def test_laboratory_finds_the_roll_of_four_springs_about_the_ground_line():
    found = laboratory_roll(RobotPlacement())
    scene = make_scene(RobotPlacement(arm=False))
    model, rest = scene.model, scene.rest
    joint = model.joint("rover1/front_left_suspension_joint")
    half_track = abs(rest.body("rover1/front_left_wheel").xpos[0])
    stiffness, damping = 4 * half_track**2 * np.array([joint.stiffness[0], joint.damping[0]])
    assert found["k_roll"] == pytest.approx(stiffness, rel=0.01)
    assert found["b_roll"] == pytest.approx(damping, rel=0.03)
    assert found["rz"] == pytest.approx(rest.site("rover1/attachment_site").xpos[2], rel=0.01)
    assert abs(found["rx"]) < 1e-4
    assert found["iyy_pendulum"] == pytest.approx(found["iyy"], rel=0.01)


def test_the_lever_to_the_side_counts_in_no_percentage():
    true = np.array([[0.027, 0.0, 0.1, 1.3, 270.0]])
    found = true * [1.1, 1.0, 0.9, 1.2, 1.0] + [0.0, 0.05, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(roll_errors(found, true), [[10.0, 10.0, 20.0, 0.0]], atol=1e-9)
    assert ROLL.parameters[LEVER] == "rx"


@pytest.mark.slow
def test_roll_needs_the_centre_joints_angle_and_is_then_told_within_its_deviation():
    laboratory = laboratory_roll(RobotPlacement())
    truth = np.array([laboratory[name] for name in ROLL.parameters])
    result = run_rover_trial(RoverTrial("sim", "information", seed=1, axis="roll"))
    sigma = np.sqrt(np.diag(result.estimate.covariance))
    assert np.all(np.abs(result.estimate.parameters - truth) < 4.0 * sigma)
    assert result.estimate.names == ROLL.parameters
    assert result.front_alone is not None
    # Any course of the halves against each other makes the front half alone look softer.
    assert result.front_alone.parameters[4] < 0.85 * truth[4]
