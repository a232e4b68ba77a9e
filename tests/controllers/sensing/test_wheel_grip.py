"""Each wheel's friction by its own spin, beside the coefficient that MuJoCo was given."""

import dataclasses

import numpy as np
import pytest

from controllers.identification.arm_sensing import IdentificationError
from controllers.sensing.wheel_grip import WheelGripConfig, WheelGripProbe
from models.as_made import AsMade, Change
from models.compose import WHEELS, FieldConfig, RobotPlacement
from models.datasheets import EXACT
from twin.connect import connect
from twin.describe import describe_rover
from twin.loop import run

ROBOT = describe_rover("rover1")
FLOOR = FieldConfig(relief=0.0, rocks=0, texture_pixels=16, friction=None)
LEVEL_LOAD = 4.5 * 9.81  # of the rover with its arm [N]


def spin(friction, change, config=None):
    """Return what a probe finds on level ground, with tyres of one friction but a changed one."""
    tolerances = dataclasses.replace(EXACT, tyre_friction=(friction, friction))
    robot = RobotPlacement("rover1", made=AsMade(1, tolerances, change))
    probe = WheelGripProbe(ROBOT, config)
    with connect("sim", robots=[robot], field=FLOOR, seed=2) as connection:
        run(connection.robots, [probe], connection.clock, duration=20.0, until=lambda: probe.done)
    return probe.estimate()


@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_alike_tyres_have_the_friction_of_the_scene(friction):
    found = spin(friction, Change())
    np.testing.assert_allclose(found.friction, friction, rtol=0.05)
    assert found.loads.sum() == pytest.approx(LEVEL_LOAD, rel=0.01)


@pytest.mark.parametrize("index", [0, 3])
def test_worn_tyre_is_told_from_the_others(index):
    found = spin(0.6, Change(worn_wheel=WHEELS[index], grip=0.5))
    true = np.full(4, 0.6)
    true[index] = 0.3
    np.testing.assert_allclose(found.friction, true, rtol=0.05)


def test_wheel_that_stands_still_tells_nothing():
    """A tenth of the duty does not overcome gear and ground."""
    found = spin(0.8, Change(), WheelGripConfig(duty=0.04))
    assert np.isnan(found.friction).all()


def test_probe_says_when_it_has_not_finished():
    with pytest.raises(IdentificationError, match="not all wheels have spun"):
        WheelGripProbe(ROBOT).estimate()


def test_wheel_that_bears_nothing_tells_nothing(monkeypatch):
    """On three wheels the fourth spins in the air, and its friction is no number."""
    monkeypatch.setattr(WheelGripProbe, "_loads", lambda *_: np.array([20.0, 0.0, 12.0, 12.0]))
    assert np.isnan(spin(0.6, Change()).friction).tolist() == [False, True, False, False]
