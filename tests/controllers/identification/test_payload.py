"""The known arm against MuJoCo, and payloads recovered from synthetic and simulated runs."""

import dataclasses

import mujoco
import numpy as np
import pytest

from controllers.identification.arm_sensing import SensingConfig, filter_alike, raised_cosine
from controllers.identification.observation_log import IdentificationError
from controllers.identification.payload import (
    PayloadConfig,
    PayloadIdentifier,
    physical_parameters,
    pseudo_inertia,
    swing_targets,
)
from controllers.kinematics.serial_arm import (
    NAMES,
    BaseMotion,
    JointMotion,
    Link,
    RigidBody,
    SerialArm,
    arm_wrench,
    frame_motions,
    locked_inertia,
    wrench_regressor,
)
from experiments.ch2.known_arm import known_arm
from models.compose import ARM_JOINTS, FieldConfig, RobotPlacement, make_model
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
    return known_arm(model)


def random_motion(model, count, rng):
    """Inverse dynamics of random states of the whole rover: wrench, joints and base."""
    data = mujoco.MjData(model)
    joints = [model.joint(f"rover1/{name}_joint") for name in ARM_JOINTS]
    places, dofs = ([int(getattr(j, key)[0]) for j in joints] for key in ("qposadr", "dofadr"))
    mount = model.site("rover1/attachment_site").pos
    rows = []
    for _ in range(count):
        data.qpos[:] = rng.normal(size=model.nq)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        data.qvel[:] = rng.normal(size=model.nv)
        data.qacc[:] = 5.0 * rng.normal(size=model.nv)
        mujoco.mj_inverse(model, data)
        sensors = [data.sensor(f"rover1/arm_base_{name}").data for name in ("force", "torque")]
        omega, alpha = data.qvel[3:6], data.qacc[3:6]
        turned = data.body("rover1/chassis").xmat.reshape(3, 3).T @ (
            data.qacc[:3] - model.opt.gravity
        )
        turned += np.cross(alpha, mount) + np.cross(omega, np.cross(omega, mount))
        base = (turned, omega, alpha)
        state = (data.qpos[places], data.qvel[dofs], data.qacc[dofs])
        rows.append([np.concatenate(part) for part in (sensors, state, base)])
    wrench, state, base = (np.array(part) for part in zip(*rows))
    joints = JointMotion(*np.split(state, 3, axis=1))
    return wrench, joints, BaseMotion(*np.split(base, 3, axis=1))


def test_arm_wrench_is_mujocos(model, arm):
    wrench, joints, base = random_motion(model, 50, np.random.default_rng(1))
    ours = arm_wrench(arm, frame_motions(arm, joints, base))
    assert np.abs(ours - wrench).max() <= 1e-9 * np.abs(wrench).max()


def test_payload_is_linear_in_its_ten_parameters(model, arm):
    """A heavier last link is the same as a payload fixed to it."""
    _, joints, base = random_motion(model, 20, np.random.default_rng(2))
    frames = frame_motions(arm, joints, base)
    added = wrench_regressor(frames[-1]) @ BOX.parameters()
    carried = Link(BOX, np.zeros(3), np.eye(3), np.array([1.0, 0.0, 0.0]))
    still = [np.pad(part, ((0, 0), (0, 1))) for part in dataclasses.astuple(joints)]
    longer = SerialArm(arm.base, (*arm.links, carried))
    total = arm_wrench(longer, frame_motions(longer, JointMotion(*still), base))
    np.testing.assert_allclose(arm_wrench(arm, frames) + added, total, rtol=1e-12, atol=1e-12)


def test_locked_inertia_is_symmetric_and_holds_the_mass(arm):
    inertia = locked_inertia(arm, np.array([[0.3, 0.9, -1.4, 0.1]]))[0]
    np.testing.assert_allclose(inertia, inertia.T, atol=1e-12)
    np.testing.assert_allclose(inertia[:3, :3], 0.76 * np.eye(3), atol=1e-9)
    assert np.all(np.linalg.eigvalsh(inertia) > 0.0)


def test_wrong_number_of_joints_is_told(arm):
    three = JointMotion(*(np.zeros((5, 3)),) * 3)
    with pytest.raises(ValueError, match=r"expected shape \(n, 4\), got \(5, 3\)"):
        frame_motions(arm, three, BaseMotion(*(np.zeros((5, 3)),) * 3))


def test_filter_keeps_straight_lines():
    line = np.stack([np.arange(50.0), 3.0 - np.arange(50.0)], axis=1)
    np.testing.assert_allclose(filter_alike(line, 11), line[5:-5], atol=1e-12)
    assert raised_cosine(11).sum() == pytest.approx(1.0)


def test_swing_starts_where_the_arm_is_and_rates_are_its_derivative():
    config = PayloadConfig(SerialArm(BOX, ())).swing
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
    joints = JointMotion(
        angles, (ahead - behind) / (2 * step), (ahead - 2 * angles + behind) / step**2
    )
    level = np.zeros((len(times), 3))
    base = BaseMotion(level + [0.0, 0.0, config.sensing.gravity], level, level)
    frames = frame_motions(arm, joints, base)
    wrench = arm_wrench(arm, frames) + wrench_regressor(frames[-1]) @ BOX.parameters()
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
    config = PayloadConfig(arm)
    estimate = identify(arm, config, observations(arm, config, 12.0, 0.0)).estimate()
    assert estimate.mass == pytest.approx(BOX.mass, rel=1e-4)
    np.testing.assert_allclose(estimate.centre, BOX.centre, atol=1e-4)
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(estimate.parameters)) > 0.0)


def test_covariance_and_chi_squared_are_calibrated(arm):
    config = PayloadConfig(arm)
    errors, chi_squared = [], []
    for seed in range(3):
        seen = observations(arm, config, 10.0, 1.0, seed=seed)
        estimate = identify(arm, config, seen).estimate()
        sigma = np.sqrt(np.diag(estimate.covariance))
        errors.append(((estimate.linear - BOX.parameters()) / sigma)[:4])
        chi_squared.append(estimate.chi_squared)
    assert np.mean(chi_squared) == pytest.approx(1.0, abs=0.2)
    assert 0.3 < np.mean(np.square(errors)) < 2.5


def test_resting_arm_hides_inertias_by_name_and_shows_the_mass(arm):
    config = PayloadConfig(arm)
    seen = observations(arm, config, 10.0, 1.0, moving=False)
    estimate = identify(arm, config, seen).estimate()
    assert set(NAMES[4:]) <= set(estimate.unidentifiable)
    assert "mass" not in estimate.unidentifiable
    assert estimate.mass == pytest.approx(BOX.mass, rel=0.03)
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(estimate.parameters)) > 0.0)


def test_impossible_estimate_becomes_a_body():
    linear = BOX.parameters()
    linear[4:] *= -1.0
    scales = np.array([0.3] + [0.045] * 3 + [0.00675] * 6)
    information = np.diag([1e6] * 4 + [1.0] * 6)
    found = physical_parameters(linear, information, scales)
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(found)) > 0.0)
    np.testing.assert_allclose(found[:4], linear[:4], rtol=1e-2, atol=1e-4)
    np.testing.assert_array_equal(
        physical_parameters(BOX.parameters(), information, scales), BOX.parameters()
    )


def test_missing_stale_and_nan_are_refused_by_name(arm):
    config = PayloadConfig(arm)
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


def test_too_short_a_run_is_told(arm):
    config = PayloadConfig(arm, sensing=SensingConfig())
    with pytest.raises(IdentificationError, match="a run of 0 ticks is too short"):
        identify(arm, config, observations(arm, config, 0.095, 0.0)).estimate()
    # One window is six equations for ten parameters.
    seen = observations(arm, config, config.swing.fade + 0.88, 0.0)
    with pytest.raises(IdentificationError, match="two windows of 59; at least 89 are needed"):
        identify(arm, config, seen).estimate()
