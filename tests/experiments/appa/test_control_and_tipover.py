"""Appendix A's control and tip-over runs, end to end."""

import numpy as np
import pytest

from controllers.motion.tipping.guarded_swing import GUARDS
from experiments.appa.control.trial import ROBOT, ControlTrial, run_control
from experiments.appa.tipover.scene import TipScene
from experiments.appa.tipover.tipover import motions
from experiments.appa.tipover.trial import FOLDED, TipTrial, run_tip
from twin.sensors import IDEAL
from twin.simulation import Simulation

REACH = (0.0, 0.4, -0.4, 0.0)
SLOPE, FORWARD = np.radians(10.0), np.pi / 2


@pytest.mark.slow
def test_feed_forward_more_than_halves_the_error_of_a_pushed_soft_base():
    error = {
        law: run_control(ControlTrial(60.0, law, 0.015, 2.0, 1)).all_deg
        for law in ("pd_gravity", "feed_forward")
    }
    assert error["feed_forward"] < 0.5 * error["pd_gravity"]


def test_rover_rests_on_a_slope_with_its_pressure_below_the_centre_of_all_masses():
    scene = TipScene(0.5, FOLDED, SLOPE, 0.3)
    point, pressure = scene.balance()
    np.testing.assert_allclose(point, pressure, atol=1e-5)
    # Straight down from the centre of mass to the plane through the origin.
    centre = scene.data.subtree_com[0]
    normal = scene.data.geom("ground").xmat.reshape(3, 3)
    down = centre - [0.0, 0.0, centre @ normal[:, 2] / normal[2, 2]]
    np.testing.assert_allclose((normal.T @ down)[:2], pressure, atol=1e-4)
    assert normal[2, 2] == pytest.approx(np.cos(SLOPE))
    falls = normal[:2, 2]  # to where the ground falls
    assert np.arctan2(falls[1], falls[0]) == pytest.approx(0.3)
    assert scene.tilt < np.radians(1.5)


def test_inclinometer_measures_the_slope():
    scene = TipScene(0.5, FOLDED, SLOPE, FORWARD)
    simulation = Simulation(scene.model, [ROBOT], suite=IDEAL, data=scene.data)
    pitch, roll = simulation.robots[ROBOT].observe().inclinometer.value
    simulation.close()
    assert pitch == pytest.approx(-SLOPE, abs=np.radians(1.5))  # nose down
    assert roll == pytest.approx(0.0, abs=np.radians(0.5))


def test_all_guards_and_slopes_get_the_same_motion():
    flat, steep = motions(1.0, 3, 0.0), motions(1.0, 3, 10.0)
    assert [trial.guard for trial in flat] == list(GUARDS)
    assert len({trial.target for trial in flat + steep}) == 1
    with pytest.raises(ValueError, match="expected one of unguarded, planned, ahead, online"):
        run_tip(TipTrial(1.0, 0.0, REACH, 0.6, "both", 0))


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.0, SLOPE])
def test_guards_keep_up_a_rover_that_its_load_would_tip_and_a_5_is_the_pressure(slope):
    asked, planned, ahead, online = (
        run_tip(TipTrial(1.0, 0.0, REACH, 0.6, name, 0, slope, FORWARD)) for name in GUARDS
    )
    assert asked.tipped and not (planned.tipped or ahead.tipped or online.tipped)
    assert "slowed" in planned.report and "held" in online.report
    # At the end of the path on the slope the rover tips over at any speed.
    if slope:
        assert "refused" in ahead.report and ahead.part == 0.0
    else:
        assert planned.part < ahead.part == 1.0 and ahead.stretch > 1.0
    assert 0.2 < online.part < 0.8
    for result in (planned, online):
        assert result.tilt_deg < 2.0
        np.testing.assert_allclose(result.point, result.pressure, atol=1e-4)
