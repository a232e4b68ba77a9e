"""The complete rover identifies itself through the contract."""

from types import SimpleNamespace

import numpy as np
import pytest

from controllers.identification.pitch import NAMES
from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from experiments.__main__ import main
from experiments.ch2.rover.laboratory import laboratory_values
from experiments.ch2.rover.rover import _errors
from experiments.ch2.rover.trial import (
    ROBOT,
    RoverTrial,
    run_rover_trial,
)
from models.as_made import AsMade
from models.compose import WHEELS, RobotPlacement
from models.datasheets import ROVER, TABLE_2_2_TRUTH
from perception.geometry.gravity import GRAVITY
from tests.models.scenes import make_scene
from twin.connect import connect
from twin.describe import describe_rover
from twin.loop import run
from twin.robot import RobotError


def test_laboratory_finds_what_the_rover_was_built_for():
    found = laboratory_values()
    assert found["k_pitch"] == pytest.approx(TABLE_2_2_TRUTH["k_pitch"], rel=0.01)
    assert found["b_pitch"] == pytest.approx(TABLE_2_2_TRUTH["b_pitch"], rel=0.02)
    assert found["ixx"] == pytest.approx(TABLE_2_2_TRUTH["ixx"], rel=0.01)
    assert found["ixx_pendulum"] == pytest.approx(found["ixx"], rel=0.01)
    assert found["ry"] == pytest.approx(TABLE_2_2_TRUTH["ry"], rel=0.01)
    assert found["rz_to_centre"] == pytest.approx(TABLE_2_2_TRUTH["rz"], rel=0.01)
    # Pitch turns about the ground, so the lever is the mount's whole height.
    assert found["rz"] == pytest.approx(ROVER.arm_mount[2] + ROVER.centre_height, rel=0.01)


def pitch_stiffness(model, data, locked):
    """Return the stiffness against pitch of four unequal springs [N m/rad].

    Heave, pitch and roll: of the whole body with a locked centre joint, of either half with a free
    one. The sprung weight takes away what it does above the wheels, which roll under it.
    """
    moves, springs = [], []
    for wheel in WHEELS:
        joint, body = model.joint(f"rover1/{wheel}_suspension_joint"), f"rover1/{wheel}_wheel"
        x, y, _ = data.body(body).xpos - data.body("rover1/chassis").xpos
        front = wheel.startswith("front")
        moves.append([1.0, y, -x] if locked else [1.0, y, -x * front, -x * (not front)])
        springs.append(model.jnt_stiffness[joint.id])
    stiffness = np.array(moves).T @ np.diag(springs) @ np.array(moves)
    halves = [model.body(f"rover1/{half}").id for half in ("chassis", "rear_chassis")]
    axle = np.mean([data.body(f"rover1/{wheel}_wheel").xpos[2] for wheel in WHEELS])
    above = model.body_mass[halves] @ (data.xipos[halves, 2] - axle)
    return 1.0 / np.linalg.inv(stiffness)[1, 1] - GRAVITY * above


@pytest.mark.parametrize("seed", [0, 1, 6])
def test_laboratory_measures_the_robot_as_it_was_made(seed):
    found, drawn = laboratory_values(RobotPlacement(made=AsMade(seed))), laboratory_values()
    scene = make_scene(RobotPlacement(arm=False, made=AsMade(seed)))
    # The centre joint's friction holds it in part.
    free, locked = (pitch_stiffness(scene.model, scene.rest, held) for held in (False, True))
    assert 0.997 * free < found["k_pitch"] < 1.003 * locked
    assert abs(free / drawn["k_pitch"] - 1.0) > 0.015
    height = scene.rest.site("rover1/attachment_site").xpos[2]
    assert found["rz"] == pytest.approx(height, rel=0.01)
    # Two ways to one inertia, but for what the coupling with heave and roll does to one of them.
    assert found["ixx_pendulum"] == pytest.approx(found["ixx"], rel=0.06)


def test_each_seed_has_a_robot_of_its_own_under_every_excitation():
    def robot(seed, excitation="information", realism="default"):
        return RoverTrial("sim", excitation, seed, realism=realism).placement

    assert robot(1) == robot(1, "constant") and robot(1).made != robot(2).made
    assert robot(1, realism="ideal") == RobotPlacement(ROBOT)
    real = RoverTrial("serial:/dev/no-port", "information", 1, realism="default")
    assert real.placement == RobotPlacement(ROBOT)
    found = [SimpleNamespace(estimate=SimpleNamespace(parameters=np.full(5, 2.0)))] * 2
    truths = [dict.fromkeys(NAMES, 1.0), dict.fromkeys(NAMES, 4.0)]
    np.testing.assert_allclose(_errors(found, truths), [[100.0] * 5, [50.0] * 5])


@pytest.mark.parametrize("sensor", ["arm_base_wrench", "inclinometer", "arm_angles"])
def test_a_disconnected_sensor_is_named(sensor):
    controller = RoverIdentifier(
        RoverIdentifierConfig(ROBOT, SwingingArm.of(describe_rover(ROBOT))),
        np.random.default_rng(0),
    )
    with connect("sim", robots=[RobotPlacement(ROBOT)]) as connection:
        connection.robots[ROBOT].sensors.disconnect(sensor)
        with pytest.raises(RobotError, match=sensor):
            run(connection.robots, [controller], connection.clock, duration=0.1)


def test_same_seed_gives_the_same_run():
    trial = RoverTrial("sim", "information", seed=3, duration=1.6, unseen=0.4)
    first, second = run_rover_trial(trial), run_rover_trial(trial)
    np.testing.assert_array_equal(first.tilt, second.tilt)
    np.testing.assert_array_equal(first.estimate.parameters, second.estimate.parameters)


@pytest.mark.slow
def test_information_excitation_beats_the_constant_one_and_both_tell_their_uncertainty():
    laboratory = laboratory_values()
    truth = np.array([laboratory[name] for name in NAMES])
    sigmas = {}
    for excitation in ("constant", "information"):
        result = run_rover_trial(RoverTrial("sim", excitation, seed=0))
        sigma = sigmas[excitation] = np.sqrt(np.diag(result.estimate.covariance))
        assert np.all(np.abs(result.estimate.parameters - truth) < 4.0 * sigma)
        # Readings are foreseen to their own noise; where the arm hardly moves, better than feared.
        assert 0.3 < result.estimate.chi_square < 1.5
    # But for the stiffness, which any motion shows, and for what the model misses under both.
    assert np.all(sigmas["information"][:4] < 0.7 * sigmas["constant"][:4])
    assert np.all(sigmas["information"] < 0.5 * np.abs(truth))
    assert result.tilt_nrmse < 10.0


def test_an_unknown_excitation_ends_in_one_line(capsys, tmp_path):
    status = main(["ch2-rover", "--excitations", "wiggle", "--out", str(tmp_path)])
    assert status == 2
    assert "wiggle" in capsys.readouterr().err
