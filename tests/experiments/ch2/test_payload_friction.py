"""The two experiments end to end, and what they say when a sensor is gone."""

import json

import numpy as np
import pytest

from controllers.identification.arm_sensing import IdentificationError
from controllers.identification.payload import PayloadIdentifier
from controllers.kinematics.serial_chain import SerialChain
from experiments.__main__ import main
from experiments.ch2 import friction as ch2_friction
from experiments.ch2 import payload as ch2_payload
from experiments.ch2.deviations import arm_deviations
from experiments.harness.contract import OptionError
from models.compose import PayloadConfig, RobotPlacement, make_model
from twin.connect import connect
from twin.describe import describe_rover
from twin.loop import run
from twin.realism import make_robots

BOX = PayloadConfig(0.15, (0.01, 0.0, -0.01))


@pytest.mark.slow
def test_payload_on_the_rover_is_within_the_bars():
    estimate = ch2_payload.identify(BOX, seed=1)
    truth = ch2_payload.true_body(BOX)
    assert estimate.mass == pytest.approx(truth.mass, rel=0.01)
    np.testing.assert_allclose(estimate.centre, truth.centre, atol=0.003)


@pytest.mark.slow
def test_payload_on_a_rover_as_made_is_within_what_the_estimate_states():
    found = ch2_payload.identify(BOX, seed=1, duration=12.0, realism="default")
    truth = ch2_payload.true_body(BOX)
    assert abs(found.mass - truth.mass) < 4.0 * np.sqrt(found.covariance[0, 0])
    error = found.centre - truth.centre
    assert error @ np.linalg.solve(found.centre_covariance, error) < 21.1  # 99.99 %
    # Its arm alone may weigh 38 g more than drawn; the sensor's zero may be as much again.
    assert np.sqrt(found.covariance[0, 0]) < 0.003


def test_only_robots_that_are_their_drawings_have_nothing_unknown():
    assert arm_deviations("ideal") is None
    default, harsh = arm_deviations("default"), arm_deviations("harsh")
    assert default is not None and harsh is not None
    # Uniform to either side: a share of 5 %, a zero of 0.5 % of 200 N.
    assert default.mass == pytest.approx(0.05 / np.sqrt(3.0))
    assert default.zero[2] == pytest.approx(1.0 / np.sqrt(3.0))
    # A moment of 5 N m may show as 1 % of 200 N, one of 1 N m as 0.4 N.
    assert default.matrix[2, 3] == pytest.approx(0.4 / np.sqrt(3.0))
    assert harsh.usual_play > default.usual_play


def test_disconnected_wrench_sensor_is_one_clear_error():
    arm = SerialChain.of_robot(describe_rover())
    identifier = PayloadIdentifier("rover1", ch2_payload.payload_config(arm))
    with connect("sim", field=ch2_payload.FIELD) as connection:
        assert connection.simulation is not None
        connection.simulation.robots["rover1"].sensors.disconnect("arm_base_wrench")
        connection.clock.tick()
        with pytest.raises(IdentificationError, match="arm_base_wrench, which is missing"):
            run(connection.robots, [identifier], connection.clock, duration=0.1)


def test_friction_is_estimated_where_the_rover_slips():
    estimate = ch2_friction.probe(0.35, seed=1, effort="hard")
    assert estimate.slipped
    assert estimate.friction == pytest.approx(0.35, rel=0.15)


def test_friction_is_bounded_where_it_holds():
    estimate = ch2_friction.probe(0.8, seed=1, effort="gentle")
    assert not estimate.slipped
    assert np.isnan(estimate.friction)
    assert 0.1 < estimate.lower_bound <= 0.8


def test_friction_of_a_robots_own_tyres_is_the_one_that_its_scene_has():
    (robot,) = make_robots([RobotPlacement()], "default", 3)
    model = make_model(ch2_friction.FIELD, [robot])
    assert ch2_friction.tyre_friction(robot) == model.geom("rover1/front_left_tyre").friction[0]
    (other,) = make_robots([RobotPlacement()], "default", 4)
    assert ch2_friction.tyre_friction(robot) != ch2_friction.tyre_friction(other)


@pytest.mark.slow
def test_robot_as_made_that_holds_is_not_said_to_slip_and_its_bound_holds():
    """Gentle jerks: before the arm was calibrated, its own errors looked like slides."""
    seed = next(s for s in range(20) if _tyres(s) > 0.6)
    estimate = ch2_friction.probe(None, seed, "gentle", realism="default")
    assert np.isnan(estimate.friction)
    assert 0.05 < estimate.lower_bound <= _tyres(seed)


def _tyres(seed):
    (robot,) = make_robots([RobotPlacement()], "default", seed)
    return ch2_friction.tyre_friction(robot)


def test_bad_options_are_refused():
    with pytest.raises(OptionError, match="--duration"):
        ch2_payload.Options(duration=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ch2-payload", "ch2-friction"])
def test_quick_run_writes_everything(name, tmp_path):
    words = [name, "--quick", "--seeds", "1", "--jobs", "1", "--record"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    folder = tmp_path / name
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["checks"]
    assert (folder / "run.rrd").stat().st_size > 10_000
    assert len(list((folder / "figures").glob("*.png"))) == 2
