"""Changes are found where a robot lies beyond unchanged ones, by the likelihood itself."""

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from controllers.identification.pitch import physical, search_coordinates
from controllers.motion.base_tilt import drawn_springs
from controllers.sensing.diagnosis import (
    GRIP_SIGMA,
    NOTICED,
    ROVER_UNCHANGED,
    Unchanged,
    base_changes,
    noticed,
    tyre_changes,
)
from controllers.sensing.wheel_grip import WheelGrips
from twin.describe import describe_rover

ROBOT = describe_rover()
PITCH, _ = drawn_springs(ROBOT)
DRAWN = np.array([PITCH.inertia, *PITCH.lever, PITCH.damping, PITCH.stiffness])


def moved(shift):
    """Return the parameters of a robot that lies off the usual one by search coordinates (5,)."""
    return physical(search_coordinates(DRAWN) + ROVER_UNCHANGED.mean + shift)


def grips(*friction):
    return WheelGrips(np.array(friction), np.full(4, 11.0))


@pytest.mark.parametrize(("index", "way"), [(0, 1.0), (4, -1.0)])
def test_shift_and_deviations_are_those_of_the_likelihood(index, way):
    """A scalar search of the Gaussian's density, and of its drop, needs no formula of ours."""
    rng = np.random.default_rng(5)
    root = 0.1 * rng.normal(size=(5, 5))
    unchanged = Unchanged(0.05 * rng.normal(size=5), root @ root.T + 0.01 * np.eye(5))
    off = np.array([0.1, 0.02, -0.01, 0.05, -0.2])
    density = scipy.stats.multivariate_normal(unchanged.mean, unchanged.covariance).logpdf
    along = way * np.eye(5)[index]
    best = scipy.optimize.minimize_scalar(lambda size: -density(off - size * along))
    gained = 2.0 * (density(off - best.x * along) - density(off))
    parameters = physical(search_coordinates(DRAWN) + off)
    found = base_changes(parameters, ROBOT, unchanged)[0 if index == 0 else 1]
    assert found.deviations == pytest.approx(np.sign(best.x) * np.sqrt(gained), rel=1e-4)
    size = DRAWN[0] * (np.exp(best.x) - 1.0) if index == 0 else np.exp(-best.x)
    assert found.size == pytest.approx(size, rel=1e-4)


def test_usual_robot_has_no_change():
    assert noticed(base_changes(moved(np.zeros(5)), ROBOT)) is None
    assert noticed(tyre_changes(grips(0.5, 0.52, 0.49, 0.47), ROBOT)) is None


def test_heavier_base_is_a_load_and_softer_springs_are_springs():
    heavier, softer = moved(np.eye(5)[0] * np.log(1.35)), moved(np.eye(5)[4] * np.log(0.5))
    found = noticed(base_changes(heavier, ROBOT))
    assert found is not None and found.name == "load on the base"
    # The robot differs in inertia alone, by 35 % of what a usual one has.
    assert found.size == pytest.approx(0.35 * DRAWN[0], rel=1e-6)
    found = noticed(base_changes(softer, ROBOT))
    assert found is not None and found.name == "soft springs"
    assert found.size == pytest.approx(0.5, rel=1e-6)


def test_lighter_base_and_stiffer_springs_are_neither():
    off = moved(np.array([-0.5, 0.0, 0.0, 0.0, 0.5]))
    assert noticed(base_changes(off, ROBOT)) is None


@pytest.mark.parametrize("wheel", range(4))
def test_worn_tyre_is_named_with_what_is_left(wheel):
    friction = np.array([0.6, 0.6, 0.6, 0.6])
    friction[wheel] = 0.3
    found = noticed(tyre_changes(grips(*friction), ROBOT))
    assert found is not None and found.name == f"worn tyre {ROBOT.wheel_names[wheel]}"
    assert found.size == pytest.approx(0.5)
    assert found.sigma == pytest.approx(0.5 * GRIP_SIGMA * np.sqrt(4.0 / 3.0))


def test_wheel_that_was_not_measured_is_not_judged():
    assert noticed(tyre_changes(grips(0.6, np.nan, 0.3, 0.6), ROBOT)).name.endswith("rear_left")
    assert tyre_changes(grips(0.6, np.nan, np.nan, 0.6), ROBOT) == ()


def test_alike_tyres_are_named_by_chance_as_rarely_as_said():
    rng = np.random.default_rng(6)
    logs = np.log(0.5) + GRIP_SIGMA * rng.normal(size=(4000, 4))
    found = [tyre_changes(grips(*row), ROBOT)[0].deviations > NOTICED for row in np.exp(logs)]
    assert np.mean(found) < 0.005
