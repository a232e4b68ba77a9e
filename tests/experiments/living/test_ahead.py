"""Motions that may tip a rover over, what is foreseen of them, and how that is scored."""

import json
import math

import numpy as np
import pytest

from controllers.motion.tipping.look_ahead import LookAhead, Outlook
from experiments.__main__ import main
from experiments.harness.output import Output
from experiments.living.ahead import LIKELY, WITHIN, AheadTrial, Foreseen, foresee
from experiments.living.living_twin import measure_ahead
from experiments.living.living_twin_options import Options


def motion(tipped, chances, asked=(0.0,), horizon=WITHIN):
    return Foreseen(tipped, np.array(asked), np.array(chances), horizon, 0.1, 0.5, 0.2)


def test_scores_count_tips_and_needless_stops(tmp_path):
    most = LIKELY + 0.01
    drives = [
        motion(math.inf, [0.1, most], (0.0, 0.5), 2.0),
        motion(math.inf, [LIKELY, 0.2], (0.0, 0.5), 2.0),
        # Foreseen too early, and in time.
        motion(3.0, [most, 0.0, 0.0], (0.0, 0.5, 1.0), 2.0),
        motion(3.0, [0.0, 0.0, most], (0.0, 0.5, 1.0), 2.0),
    ]
    swings = [motion(1.0, [most]), motion(1.0, [0.0]), motion(math.inf, [0.0])]
    pairs = [(AheadTrial(0, "drive"), each) for each in drives]
    pairs += [(AheadTrial(0, "swing"), each) for each in swings]
    output = Output("living-twin", Options(out=tmp_path), [])
    measure_ahead(pairs, output)
    output.finish()
    output.close()
    found = json.loads((tmp_path / "living-twin" / "metrics.json").read_text())["measured"]
    means = {name: each["mean"] for name, each in found.items() if "fraction" in name}
    assert means == {
        "tip_foreseen_fraction": 0.5, "tip_foreseen_fraction/drive": 0.5,
        "tip_foreseen_fraction/swing": 0.5, "false_stop_fraction": pytest.approx(1 / 3),
        "false_stop_fraction/drive": 0.5, "false_stop_fraction/swing": 0.0,
    }  # fmt: skip
    assert found["look_ahead_s"]["median"] == pytest.approx(0.2)


def test_what_is_foreseen_does_not_change_what_comes(monkeypatch):
    trial = AheadTrial(28, "swing")
    asked = []

    def nothing(self, plan, rng, still):
        asked.append(plan)
        never = np.full(50, math.inf)
        return Outlook(never, never, never, never, np.zeros((50, 1)))

    seen = foresee(trial)
    monkeypatch.setattr(LookAhead, "outlook", nothing)
    blind = foresee(trial)
    assert seen.chances[0] > 0.0
    assert not blind.foretold
    assert blind.tipped == seen.tipped < WITHIN
    (plan,) = asked
    assert len(plan.rims) == round(WITHIN / 0.01)


def test_a_drive_is_looked_at_every_half_second():
    found = foresee(AheadTrial(1, "drive"))
    np.testing.assert_allclose(found.asked, 0.5 * np.arange(len(found.asked)))
    assert found.asked[-1] < min(found.tipped, WITHIN)


@pytest.mark.slow
def test_a_quick_run_measures(tmp_path):
    words = ["living-twin", "--quick", "--jobs", "1", "--parts", "ahead", "--out", str(tmp_path)]
    assert main(words) == 0
    found = json.loads((tmp_path / "living-twin" / "metrics.json").read_text())["measured"]
    assert found["look_ahead_s"]["n"] == 6  # noqa: PLR2004
    assert (tmp_path / "living-twin" / "figures" / "ahead.png").stat().st_size > 5_000  # noqa: PLR2004
