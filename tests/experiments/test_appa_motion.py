"""Appendix A's control and tip-over runs, end to end."""

import numpy as np
import pytest

from experiments.appa_control_trial import ControlTrial, run_control
from experiments.appa_tipover_trial import TipTrial, run_tip

REACH = (0.0, 0.4, -0.4, 0.0)


@pytest.mark.slow
def test_feed_forward_more_than_halves_the_error_of_a_pushed_soft_base():
    error = {
        law: run_control(ControlTrial(60.0, law, 0.015, 2.0, 1))["all_deg"]
        for law in ("pd_gravity", "feed_forward")
    }
    assert error["feed_forward"] < 0.5 * error["pd_gravity"]


@pytest.mark.slow
def test_guard_keeps_up_a_rover_that_its_load_would_tip_and_a_5_is_the_pressure():
    asked, kept = (run_tip(TipTrial(1.0, 0.0, REACH, 0.6, guarded, 0)) for guarded in (False, True))
    assert asked["tipped"] and not kept["tipped"]
    assert "slowed" in kept["report"]
    np.testing.assert_allclose(kept["point"], kept["pressure"], atol=1e-4)
