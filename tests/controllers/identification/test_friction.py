"""The mechanics behind the friction in use: limit loads known by hand."""

import dataclasses

import numpy as np
import pytest

from controllers.identification.arm_deviations import ArmAsMade
from controllers.identification.arm_sensing import ArmRecord
from controllers.identification.friction import (
    FrictionConfig,
    GroundLoad,
    JerkConfig,
    KnownBase,
    brakes,
    friction_in_use,
    held_with,
    normal_forces,
    slides,
    tared,
)
from controllers.kinematics.rigid_motion import FrameMotion
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.gravity import GRAVITY
from tests.controllers.identification.test_arm_deviations import NO_PLAY
from twin.describe import describe_rover

WHEELS = np.array([[-0.14, 0.15], [0.14, 0.15], [-0.14, -0.15], [0.14, -0.15]])
EVEN = np.full((1, 4), 11.0)


def test_pure_force_uses_force_over_weight():
    used = friction_in_use(np.array([[13.2, 0.0]]), np.zeros(1), EVEN, WHEELS)
    assert used[0] == pytest.approx(13.2 / 44.0, rel=1e-4)


def test_pure_moment_uses_moment_over_weight_and_distance():
    radius = np.hypot(0.14, 0.15)
    used = friction_in_use(np.zeros((1, 2)), np.array([4.0]), EVEN, WHEELS)
    assert used[0] == pytest.approx(4.0 / (44.0 * radius), rel=1e-4)


def test_no_load_uses_nothing():
    assert friction_in_use(np.zeros((1, 2)), np.zeros(1), EVEN, WHEELS)[0] < 1e-3


def test_sliding_wheels_use_exactly_the_friction():
    """Forces of wheels that all slide about a random centre give the coefficient back."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        normals = rng.uniform(5.0, 20.0, (1, 4))
        vx, vy, turn = rng.normal(size=3) * [0.1, 0.1, 1.0]
        velocity = np.stack([vx - turn * WHEELS[:, 1], vy + turn * WHEELS[:, 0]], axis=1)
        along = velocity / np.linalg.norm(velocity, axis=1)[:, None]
        forces = 0.37 * normals[0][:, None] * along
        moment = np.sum(WHEELS[:, 0] * forces[:, 1] - WHEELS[:, 1] * forces[:, 0])
        used = friction_in_use(forces.sum(axis=0)[None], np.array([moment]), normals, WHEELS)
        assert used[0] == pytest.approx(0.37, rel=2e-3)


def test_holding_wheels_never_use_more_than_they_have():
    rng = np.random.default_rng(4)
    for _ in range(50):
        normals = rng.uniform(5.0, 20.0, (1, 4))
        sizes = rng.uniform(0.0, 0.5, 4)
        directions = rng.uniform(0.0, 2.0 * np.pi, 4)
        forces = (sizes * normals[0])[:, None] * np.stack(
            [np.cos(directions), np.sin(directions)], axis=1
        )
        moment = np.sum(WHEELS[:, 0] * forces[:, 1] - WHEELS[:, 1] * forces[:, 0])
        used = friction_in_use(forces.sum(axis=0)[None], np.array([moment]), normals, WHEELS)
        assert used[0] <= sizes.max() * 1.001


def test_normal_forces_balance_weight_and_moments():
    base = KnownBase.of_robot(describe_rover())
    force = np.array([[3.0, -2.0, 44.0]])
    moment = np.array([[1.0, -0.5, 0.0]])
    normals = normal_forces(force, moment, base.wheels)[0]
    assert normals.sum() == pytest.approx(44.0)
    height = -base.wheels[0, 2]
    assert normals @ base.wheels[:, 1] + height * -2.0 == pytest.approx(1.0)
    assert -(normals @ base.wheels[:, 0]) - height * 3.0 == pytest.approx(-0.5)
    assert normals[2] == pytest.approx(normals[3])


def test_known_base_is_the_rover_without_arm():
    base = KnownBase.of_robot(describe_rover())
    assert base.body.mass == pytest.approx(3.74)
    np.testing.assert_allclose(base.body.centre, 0.0, atol=1e-6)
    assert np.all(np.linalg.eigvalsh(base.body.inertia) > 0.0)


def config_of(**changes):
    drawn = describe_rover()
    return FrictionConfig(SerialChain.of_robot(drawn), KnownBase.of_robot(drawn), **changes)


def load_of(used, yaw_rate):
    """Samples of a rover that turns at some rates with some friction in use."""
    count = len(used)
    times = 0.01 * np.arange(count)
    return GroundLoad(
        times,
        np.zeros((count, 2)),
        np.zeros(count),
        np.full((count, 4), 10.0),
        -np.sign(yaw_rate) * np.ones(count),
        yaw_rate,
        used,
    )


def test_a_turn_with_less_friction_than_the_wheels_have_held_with_is_no_slide():
    """An offset of the yaw acceleration turns the integral; a real slide uses what there is."""
    config = config_of()
    used, rate = np.full(300, 0.05), np.zeros(300)
    used[50:100] = 0.5
    rate[150:250] = 0.4
    false = load_of(used, rate)
    assert np.any(slides(false, config))
    assert not np.any(brakes(false, slides(false, config), config))
    used[150:250] = 0.5
    true = load_of(used, rate)
    braking = brakes(true, slides(true, config), config)
    np.testing.assert_array_equal(np.flatnonzero(braking), np.arange(150, 250))


def test_wheels_held_with_what_lasted_for_a_window_not_with_the_peak_of_a_strike():
    config = dataclasses.replace(config_of(), window=7, margin=(0.3, 0.02))
    used = np.full(300, 0.05)
    used[50:60], used[150:153] = 0.5, 0.9
    load = load_of(used, np.zeros(300))
    assert held_with(load, config) == pytest.approx(0.7 * 0.5 - 0.02)
    lifted = dataclasses.replace(load, normals=np.where(used[:, None] > 0.1, 1.0, load.normals))
    assert held_with(lifted, config) == pytest.approx(0.7 * 0.05 - 0.02)


def test_tare_takes_off_what_grows_with_the_yaw_and_leaves_a_jerk():
    config = config_of(jerks=JerkConfig(sweep=2.0), deviations=NO_PLAY)
    made = ArmAsMade.drawn(config.arm, NO_PLAY)
    times = 30.0 + 0.01 * np.arange(400)
    angles = np.tile(config.jerks.posture, (400, 1))
    angles[:, 0] = 0.35 * np.sin(np.pi * (times - 30.0))
    still, joints = np.zeros((400, 3)), np.zeros((400, 4))
    base = FrameMotion(np.tile([0.0, 0.0, GRAVITY], (400, 1)), still, still)
    weight = config.arm.inverse_dynamics(angles, joints, joints, base)[1]
    jerk = np.where(times > 32.5, 1.0, 0.0)[:, None] * [0.0, 3.0, 0.0, 0.0, 0.0, 0.4]
    off = np.array([0.3, -0.2, 0.9, 0.02, -0.01, 0.02]) * (1.0 + 0.5 * angles[:, :1])
    record = ArmRecord(times, angles, joints, joints, base, weight + jerk + off)
    clean, _ = tared(record, made, config)
    np.testing.assert_allclose(clean.wrench, weight + jerk, atol=1e-9)
