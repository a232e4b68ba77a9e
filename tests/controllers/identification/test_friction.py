"""The mechanics behind the friction in use: limit loads known by hand."""

import numpy as np
import pytest

from controllers.identification.friction import KnownBase, friction_in_use, normal_forces
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
