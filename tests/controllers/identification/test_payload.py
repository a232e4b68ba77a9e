"""The known arm against MuJoCo, and payloads recovered from synthetic and simulated runs."""

import dataclasses

import mujoco
import numpy as np
import pytest

from controllers.identification.arm_sensing import (
    CHANNELS,
    IdentificationError,
    ObservationLog,
    SensingConfig,
    filter_alike,
    raised_cosine,
)
from controllers.identification.payload import (
    WIDE_SWING,
    PayloadIdentifier,
    PayloadIdentifierConfig,
    SwingConfig,
    _Solution,
    estimate_payload,
    parameter_scales,
    physical_parameters,
    pseudo_inertia,
    swing_targets,
)
from controllers.kinematics.rigid_motion import LEVEL, NAMES, inertial_parameters, wrench_regressor
from controllers.kinematics.serial_chain import SerialChain
from models.compose import FieldConfig, RobotPlacement, make_model
from tests.controllers.identification.test_arm_deviations import DEVIATIONS
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


def observations(arm, config, seconds, noise, moving=True, seed=0, box=BOX, sensor=None, begin=0.0):
    """What an ideal robot with a payload would show: exact motion on a level base.

    The sensor, if given, turns the true wrenches (n, 6) into those that it shows.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, 0.01)
    start = np.array(config.swing.middle)
    step = 1e-4

    def at(shift):
        rows = [swing_targets(config.swing, start, max(0.0, t + shift))[0] for t in times]
        return np.array(rows) if moving else np.tile(start, (len(times), 1))

    angles, ahead, behind = at(0.0), at(step), at(-step)
    motion = angles, (ahead - behind) / (2 * step), (ahead - 2 * angles + behind) / step**2
    carried = wrench_regressor(arm.last_link_motion(*motion, LEVEL)) @ inertial_parameters(box)
    wrench = arm.inverse_dynamics(*motion)[1] + carried
    if sensor is not None:
        wrench = sensor(wrench)
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
        for time, angle, row in zip(begin + times, angles, wrench)
    ]


def identify(arm, config, seen):
    identifier = PayloadIdentifier("rover1", config)
    for observation in seen:
        command = identifier.step({"rover1": observation})["rover1"]
        assert np.all(np.isfinite(command.arm))
    return identifier


def recorded(seen, config):
    """The part of a swing that is evaluated."""
    log = ObservationLog("payload identification", CHANNELS)
    for observation in seen:
        log.take(observation)
    log.forget_before(seen[0].time + config.swing.fade)
    return log


def made_differently(arm, config, rng):
    """An arm and a wrench sensor as far from drawing and calibration as the configuration says."""
    unknown = config.deviations

    def other(body):
        factor = 1.0 + unknown.mass * rng.normal()
        centre = body.centre + unknown.centre * rng.normal(size=3)
        return RigidBody(factor * body.mass, centre, factor * body.inertia)

    joints = tuple(dataclasses.replace(joint, body=other(joint.body)) for joint in arm.joints)
    matrix = np.eye(6) + unknown.matrix * rng.normal(size=(6, 6))
    zero = unknown.zero * rng.normal(size=6)
    made = dataclasses.replace(arm, base=other(arm.base), joints=joints)
    return made, lambda wrench: wrench @ matrix.T + zero


def test_empty_swing_first_makes_a_payload_known_on_an_arm_that_is_not(arm):
    """Its own weight and the sensor's zero are the payload's size; the deviations stay honest."""
    still = dataclasses.replace(DEVIATIONS, usual_play=0.0)
    config = PayloadIdentifierConfig(arm, swing=WIDE_SWING, window=99, deviations=still)
    nothing = RigidBody(1e-9, np.zeros(3), 1e-12 * np.eye(3))
    truth, squares, shares, ratios = inertial_parameters(BOX), [], [], []
    for seed in range(4):
        made, sensor = made_differently(arm, config, np.random.default_rng(seed))
        with_box, empty = (
            recorded(
                observations(made, config, 10.0, 1.0, seed=10 * seed + k, box=box, sensor=sensor,
                             begin=begin),
                config,
            )
            for k, (box, begin) in enumerate(((BOX, 20.0), (nothing, 0.0)))
        )  # fmt: skip
        found = estimate_payload(with_box, config, empty)
        simple = estimate_payload(with_box, dataclasses.replace(config, deviations=None))
        errors = found.linear[:4] - truth[:4]
        squares.append(errors @ np.linalg.solve(found.covariance[:4, :4], errors) / 4.0)
        shares.append(np.sqrt(found.covariance[0, 0]) / BOX.mass)
        ratios.append(abs(simple.mass - BOX.mass) / abs(found.mass - BOX.mass))
    # Of 16 squared deviations the mean is below 2.3 in 99.9 % of all tries.
    assert np.mean(squares) < 2.4
    assert np.max(shares) < 0.01
    assert np.median(ratios) > 5.0


def test_identifier_rests_between_an_empty_swing_and_one_with_the_payload(arm):
    config = PayloadIdentifierConfig(arm, deviations=DEVIATIONS, empty=6.0, rest=4.0)
    assert (config.taken, config.begin) == (9.0, 10.0)
    identifier = PayloadIdentifier("rover1", config)
    angles, still = np.array(config.swing.middle) + 0.3, []
    for tick in range(1200):
        time = 5.0 + 0.01 * tick
        channel = Channel(angles, time, Validity.MEASURED)
        level = Channel(np.zeros(2), time, Validity.MEASURED)
        wrench = Channel(np.zeros(6), time, Validity.MEASURED)
        seen = Observation(time, arm_angles=channel, inclinometer=level, arm_base_wrench=wrench)
        command = identifier.step({"rover1": seen})["rover1"]
        # From one tick to the next no joint is sent farther than it could go.
        assert np.abs(command.arm - angles).max() < 0.05
        angles = command.arm
        if 8.5 < time - 5.0 < 9.5:
            still.append(angles)
    np.testing.assert_allclose(still, np.tile(config.swing.middle, (len(still), 1)), atol=1e-9)


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
    solution = _Solution.of(rows, np.zeros((24, 0)), right, scales)
    assert solution.chi_squared == pytest.approx(across @ across / 14.0, rel=1e-6)


def test_unknowns_beside_the_parameters_count_as_correlated_noise(arm):
    """Solved for beside phi, or put into the covariance of the right side: the same."""
    rng, count = np.random.default_rng(2), 5
    scales = parameter_scales(0.3, 0.15)
    rows, columns = 10.0 * rng.normal(size=(40, 10)) / scales, rng.normal(size=(40, count))
    right = rows @ inertial_parameters(BOX) + rng.normal(size=40)
    excess = 1.7
    solution = _Solution.of(rows, columns, right, scales, excess)
    weight = np.linalg.inv(excess * np.eye(40) + columns @ columns.T)
    information = rows.T @ weight @ rows
    phi = np.linalg.solve(information, rows.T @ weight @ right)
    np.testing.assert_allclose(solution.linear, phi, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        solution.information, information * np.outer(scales, scales), rtol=1e-6, atol=1e-6
    )
    left = right - rows @ phi
    assert solution.chi_squared == pytest.approx(excess * left @ weight @ left / 30.0, rel=1e-6)


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
