"""The known arm against MuJoCo, and payloads recovered from synthetic and simulated runs."""

import dataclasses

import mujoco
import numpy as np
import pytest

from controllers.identification.arm_sensing import (
    IdentificationError,
    SensingConfig,
    filter_alike,
    raised_cosine,
)
from controllers.identification.payload import (
    PayloadIdentifier,
    PayloadIdentifierConfig,
    SwingConfig,
    _solve,
    parameter_scales,
    physical_parameters,
    pseudo_inertia,
    swing_targets,
)
from controllers.kinematics.rigid_motion import LEVEL, NAMES, inertial_parameters, wrench_regressor
from controllers.kinematics.serial_chain import SerialChain
from models.compose import FieldConfig, RobotPlacement, make_model
from twin.describe import describe
from twin.description import RigidBody
from twin.robot import MISSING, Channel, Observation, Validity

FIELD = FieldConfig(texture_pixels=16)
BOX = RigidBody(0.2, np.array([0.01, 0.12, -0.015]), np.diag([2e-4, 1e-4, 3e-4]))


@pytest.fixture(scope="module")
def model():
    model = make_model(FIELD, [RobotPlacement()])
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model


@pytest.fixture(scope="module")
def arm(model):
    return SerialChain.of_robot(describe(model, "rover1"))


def test_filter_keeps_straight_lines():
    line = np.stack([np.arange(50.0), 3.0 - np.arange(50.0)], axis=1)
    np.testing.assert_allclose(filter_alike(line, 11), line[5:-5], atol=1e-12)
    assert raised_cosine(11).sum() == pytest.approx(1.0)


def test_swing_starts_where_the_arm_is_and_rates_are_its_derivative():
    config = SwingConfig()
    start = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(swing_targets(config, start, 0.0)[0], start)
    for time in (0.7, 3.0):
        ahead, behind = (swing_targets(config, start, time + d)[0] for d in (1e-5, -1e-5))
        rates = swing_targets(config, start, time)[1]
        np.testing.assert_allclose(rates, (ahead - behind) / 2e-5, atol=1e-6)


def observations(arm, config, seconds, noise, moving=True, seed=0):
    """What an ideal robot with a payload would show: exact motion on a level base."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, 0.01)
    start = np.array(config.swing.middle)
    step = 1e-4

    def at(shift):
        rows = [swing_targets(config.swing, start, max(0.0, t + shift))[0] for t in times]
        return np.array(rows) if moving else np.tile(start, (len(times), 1))

    angles, ahead, behind = at(0.0), at(step), at(-step)
    motion = angles, (ahead - behind) / (2 * step), (ahead - 2 * angles + behind) / step**2
    carried = wrench_regressor(arm.last_link_motion(*motion, LEVEL)) @ inertial_parameters(BOX)
    wrench = arm.inverse_dynamics(*motion)[1] + carried
    wrench += noise * np.array(config.wrench_noise) * rng.standard_normal(wrench.shape)

    def channel(value, time):
        return Channel(np.asarray(value), time, Validity.MEASURED)

    return [
        Observation(
            time,
            arm_angles=channel(angle, time),
            inclinometer=channel(np.zeros(2), time),
            arm_base_wrench=channel(row, time),
        )
        for time, angle, row in zip(times, angles, wrench)
    ]


def identify(arm, config, seen):
    identifier = PayloadIdentifier("rover1", config)
    for observation in seen:
        command = identifier.step({"rover1": observation})["rover1"]
        assert np.all(np.isfinite(command.arm))
    return identifier


def test_payload_is_recovered_without_noise(arm):
    config = PayloadIdentifierConfig(arm)
    estimate = identify(arm, config, observations(arm, config, 12.0, 0.0)).estimate()
    assert estimate.mass == pytest.approx(BOX.mass, rel=1e-4)
    np.testing.assert_allclose(estimate.centre, BOX.centre, atol=1e-4)
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(estimate.parameters)) > 0.0)


def test_covariance_and_chi_squared_are_calibrated(arm):
    config = PayloadIdentifierConfig(arm)
    errors, chi_squared = [], []
    for seed in range(3):
        seen = observations(arm, config, 10.0, 1.0, seed=seed)
        estimate = identify(arm, config, seen).estimate()
        sigma = np.sqrt(np.diag(estimate.covariance))
        errors.append(((estimate.linear - inertial_parameters(BOX)) / sigma)[:4])
        chi_squared.append(estimate.chi_squared)
    assert np.mean(chi_squared) == pytest.approx(1.0, abs=0.2)
    assert 0.3 < np.mean(np.square(errors)) < 2.5


def test_chi_squared_is_that_of_the_equations_less_the_ten_parameters(arm):
    config, rng = PayloadIdentifierConfig(arm), np.random.default_rng(0)
    scales = parameter_scales(*config.scales)
    rows, errors = 1e3 * rng.normal(size=(24, 10)) / scales, rng.normal(size=24)
    right = rows @ inertial_parameters(BOX) + errors
    # What least squares leaves is the part of the errors across the columns.
    across = errors - rows @ np.linalg.solve(rows.T @ rows, rows.T @ errors)
    estimate = _solve(rows, right, np.zeros(4), config)
    assert estimate.chi_squared == pytest.approx(across @ across / 14.0, rel=1e-6)


def test_resting_arm_hides_inertias_by_name_and_shows_the_mass(arm):
    config = PayloadIdentifierConfig(arm)
    seen = observations(arm, config, 10.0, 1.0, moving=False)
    estimate = identify(arm, config, seen).estimate()
    assert set(NAMES[4:]) <= set(estimate.unidentifiable)
    assert "mass" not in estimate.unidentifiable
    assert estimate.mass == pytest.approx(BOX.mass, rel=0.03)
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(estimate.parameters)) > 0.0)


def test_impossible_estimate_becomes_a_body():
    linear = inertial_parameters(BOX)
    linear[4:] *= -1.0
    scales = np.array([0.3] + [0.045] * 3 + [0.00675] * 6)
    information = np.diag([1e6] * 4 + [1.0] * 6)
    found = physical_parameters(linear, information, scales)
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(found)) > 0.0)
    np.testing.assert_allclose(found[:4], linear[:4], rtol=1e-2, atol=1e-4)
    np.testing.assert_array_equal(
        physical_parameters(inertial_parameters(BOX), information, scales), inertial_parameters(BOX)
    )


def test_missing_stale_and_nan_are_refused_by_name(arm):
    config = PayloadIdentifierConfig(arm)
    seen = observations(arm, config, 1.0, 0.0)
    identifier = identify(arm, config, seen[:3])
    without = seen[3]._replace(arm_base_wrench=MISSING)
    with pytest.raises(IdentificationError, match="needs arm_base_wrench, which is missing"):
        identifier.step({"rover1": without})
    stale = Channel(np.zeros(2), 0.0, Validity.STALE)
    with pytest.raises(IdentificationError, match="inclinometer, which is stale"):
        identifier.step({"rover1": seen[3]._replace(inclinometer=stale)})
    broken = seen[3].arm_base_wrench.value.copy()
    broken[2] = np.nan
    bad = Channel(broken, 0.03, Validity.MEASURED)
    with pytest.raises(IdentificationError, match=r"arm_base_wrench\[2\] is nan at 0\.030 s"):
        identifier.step({"rover1": seen[3]._replace(arm_base_wrench=bad)})


def test_too_short_a_run_is_an_error(arm):
    config = PayloadIdentifierConfig(arm, sensing=SensingConfig())
    with pytest.raises(IdentificationError, match="a run of 0 ticks is too short"):
        identify(arm, config, observations(arm, config, 0.095, 0.0)).estimate()
    # One window is six equations for ten parameters.
    seen = observations(arm, config, config.swing.fade + 0.88, 0.0)
    with pytest.raises(IdentificationError, match="two windows of 59; at least 89 are needed"):
        identify(arm, config, seen).estimate()


def test_parameters_are_unidentifiable_from_their_deviation_over_their_size_on(arm):
    """Sizes are 0.3 kg for the mass, m d for first moments and m d^2 for inertias."""
    config = PayloadIdentifierConfig(arm)
    seen = observations(arm, config, 12.0, 1.0)
    found = identify(arm, config, seen).estimate()
    lever = 0.15
    sizes = found.mass * np.array([0.3 / found.mass] + [lever] * 3 + [lever**2] * 6)
    shares = np.sqrt(np.diag(found.covariance)) / sizes
    for threshold in np.sort(shares)[[1, 4, 8]]:
        for factor in (0.99, 1.01):
            level = factor * threshold
            if level <= shares[0]:
                continue
            tried = dataclasses.replace(config, resolution=level)
            hidden = identify(arm, tried, seen).estimate().unidentifiable
            assert hidden == tuple(n for n, share in zip(NAMES, shares) if share > level)
    blind = dataclasses.replace(config, resolution=0.99 * shares[0])
    with pytest.raises(IdentificationError, match="does not show the payload's mass"):
        identify(arm, blind, seen).estimate()
