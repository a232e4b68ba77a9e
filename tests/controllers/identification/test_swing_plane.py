"""A rover's roll in the plane of an arm turned aside, held to an integration of both its halves."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate

from controllers.identification.pitch import NAMES, PitchFit
from controllers.identification.pitch_model import PitchSensors, predict_tilt
from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from controllers.identification.swing_plane import PITCH, ROLL
from tests.controllers.identification.test_pitch import SENSORS, rich_wrench
from twin.robot import MISSING, Channel, Command, Observation, RobotError, Validity

INERTIA, RX, RZ, DAMPING, STIFFNESS = TRUTH = np.array([0.027, 0.01, 0.1, 1.33, 275.0])
ARM = SwingingArm(0.56, 0.0107, (0.31, 0.015), (0.0, 0.06))
ROBOT = "rover1"


def observed(time, *, wrench, tilt, twist):
    """Return an observation of the arm at rest at angle zero."""
    values = {
        "arm_angles": np.zeros(4),
        "arm_base_wrench": wrench,
        "inclinometer": tilt,
        "centre_angle": np.array([twist]),
    }
    seen = {name: Channel(value, time, Validity.MEASURED) for name, value in values.items()}
    return Observation(time, **seen)


def halves(wrench, friction):
    """Return the roll to the left (n, 2) of two halves at the end of each period of a wrench.

    Half of everything each, on a centre joint with dry friction; the front one carries the arm.
    """
    moment = -(wrench[:, 3] + RX * wrench[:, 2] - RZ * wrench[:, 1])

    def rates(t, x, now):
        tilt, rate = x[:2], x[2:]
        joint = friction * np.tanh((rate[0] - rate[1]) / 0.01)
        driven = np.array([now - joint, joint]) - 0.5 * (DAMPING * rate + STIFFNESS * tilt)
        return [*rate, *driven / (0.5 * INERTIA)]

    state, found = np.zeros(4), []
    for now in moment:
        ends = (0, SENSORS.period)
        result = scipy.integrate.solve_ivp(rates, ends, state, args=(now,), rtol=1e-8, atol=1e-11)
        state = result.y[:, -1]
        found.append(state[:2])
    return np.array(found)


@pytest.mark.parametrize("friction", [0.0, 0.05, 5.0])
def test_mean_roll_of_the_halves_is_that_of_one_body_whatever_the_centre_joint_does(friction):
    # Tilt and wrench of the same time: the tilt when a period begins.
    sensors = dataclasses.replace(SENSORS, wrench_age=-SENSORS.period / 2)
    _, wrench = rich_wrench(1.0)
    wrench[:, 3] *= 0.2
    found = halves(wrench, friction)
    mean = predict_tilt(TRUTH, wrench, sensors)[1:, 0]
    largest = np.abs(mean).max()
    np.testing.assert_allclose(found[:-1].mean(axis=1), mean, atol=1e-4 * largest)
    apart = np.abs(found[:, 0] - found[:, 1]).max()
    assert apart > largest if friction < 1.0 else apart < 0.1 * largest


def test_arm_to_the_right_rolls_its_rover_as_an_arm_ahead_pitches_it():
    """A weight at the end of the arm: downward force, and the moment of its lever."""
    weight, reach = 5.0, 0.3
    sideways = np.array([0.0, 0.0, weight, *np.cross([reach, 0.0, 0.0], [0.0, 0.0, weight])])
    ahead = np.array([0.0, 0.0, weight, *np.cross([0.0, reach, 0.0], [0.0, 0.0, weight])])
    np.testing.assert_allclose(ROLL.wrench(sideways), ahead, atol=1e-12)
    np.testing.assert_array_equal(PITCH.wrench(ahead), ahead)
    np.testing.assert_allclose(ROLL.along, [1.0, 0.0, 0.0], atol=1e-12)
    # A positive roll about y, forward, lowers the right side, as a negative pitch lowers the front.
    assert ROLL.tilt(np.array([0.01, 0.02])) == pytest.approx(-0.02)
    assert PITCH.tilt(np.array([0.01, 0.02])) == 0.01


def test_half_of_the_centre_angle_leads_from_the_front_half_to_the_mean():
    front, rear = 0.02, -0.01
    tilt = np.array([0.0, front])
    seen = observed(0.0, wrench=np.zeros(6), tilt=tilt, twist=rear - front)
    mean = ROLL.tilt(tilt) + ROLL.half_twist(seen)
    assert mean == pytest.approx(-(front + rear) / 2)
    assert PITCH.half_twist(seen) == 0.0


def rolling(monkeypatch, twist):
    """Return an identifier of roll that has seen both halves step to some angle, 0.4 s long."""
    config = RoverIdentifierConfig(ROBOT, ARM, "constant", plane=ROLL)
    identifier = RoverIdentifier(config, np.random.default_rng(0))
    monkeypatch.setattr(identifier, "_replan", lambda: None)
    identifier._motion, _ = identifier._swing(identifier._excitation)
    period, command = config.sensors.period, Command()
    for tick in range(round((config.approach + config.rest + 0.4) / period)):
        moved = tick * period > config.approach + config.rest - period / 2
        tilt, own = np.array([0.5, 0.03 + 0.01 * moved]), 0.002 + twist * moved
        seen = observed(tick * period, wrench=np.arange(6.0) * moved, tilt=tilt, twist=own)
        command = identifier.step({ROBOT: seen})[ROBOT]
    return identifier, command


def test_identifier_of_roll_turns_the_arm_aside_and_reads_the_halves_mean(monkeypatch):
    identifier, command = rolling(monkeypatch, twist=-0.02)
    assert command.arm is not None and command.arm[0] == pytest.approx(-np.pi / 2)
    log, sensors = identifier.log, SENSORS
    np.testing.assert_allclose(log.wrench[-1], [-1.0, 0.0, 2.0, -4.0, 3.0, 5.0], atol=1e-12)
    # Half of the step of the centre joint, through the low pass of the inclinometer.
    passed = -np.expm1(-2 * np.pi * sensors.tilt_bandwidth * sensors.period * np.arange(1, 41))
    np.testing.assert_allclose(log.half_twist, 0.01 * passed)
    np.testing.assert_allclose(log.tilt, np.array(log.half_twist)[log.tilt_indices] - 0.01)


def test_identification_of_roll_needs_the_centre_joints_potentiometer():
    config = RoverIdentifierConfig(ROBOT, ARM, "constant", plane=ROLL)
    seen = observed(0.0, wrench=np.zeros(6), tilt=np.zeros(2), twist=0.0)
    blind = seen._replace(centre_angle=MISSING)
    with pytest.raises(RobotError, match="centre_angle is missing"):
        RoverIdentifier(config, np.random.default_rng(0)).step({ROBOT: blind})


def test_what_no_motion_shows_is_named_by_the_planes_own_names():
    nothing = PitchFit(PitchSensors(), names=ROLL.parameters)
    assert nothing.estimate.unidentifiable(nothing.prior) == (
        "iyy",
        "rx",
        "rz",
        "b_roll",
        "k_roll",
    )
    assert NAMES == PITCH.parameters
