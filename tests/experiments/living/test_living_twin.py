"""The experiment's scores, and a quick run from the command line."""

import csv
import json

import pytest
from scipy import stats

from experiments.__main__ import main
from experiments.harness.output import Output
from experiments.living import living_twin
from experiments.living.living_twin_options import Options
from experiments.living.trial import Watched


def watched(name="load base", found="load base", delay=2.0, off=0.0, alarms=(), suspected=""):
    told = found, 1.0 + off, 0.1, suspected, 1.3, 0.1
    return Watched(name, 1.0, delay, *told, alarms, 1800.0, 0.5, 1.2)


def measured(tmp_path, results, monkeypatch):
    """Metrics of given results."""
    seeds = len(results) // 2
    monkeypatch.setattr(living_twin, "CELLS", (("load base", 1.0),))
    monkeypatch.setattr(living_twin, "sweep", lambda *_, **__: results)
    output = Output("living-twin", Options(seeds=seeds, out=tmp_path), [])
    living_twin.run(Options(seeds=seeds, out=tmp_path, parts=("changes",)), output)
    output.finish()
    output.close()
    return json.loads((tmp_path / "living-twin" / "metrics.json").read_text())


def test_scores_count_what_was_missed_as_wrong_and_late(tmp_path, monkeypatch):
    nothing = float("nan")
    changed = [
        watched(), watched(delay=1.0, off=0.19), watched(off=0.2),
        watched(found="spring rear_left"), watched(found="", delay=nothing),
    ]  # fmt: skip
    unchanged = [watched(name="", found="", delay=nothing, alarms=("battery",))]
    unchanged += [watched(name="", found="", delay=nothing)] * 4
    found = measured(tmp_path, changed + unchanged, monkeypatch)["measured"]
    assert found["isolation_fraction"]["mean"] == pytest.approx(0.6)
    assert found["size_coverage95"]["mean"] == pytest.approx(2 / 3)
    assert found["detection_delay_s"]["median"] == 2.0  # noqa: PLR2004
    assert found["detection_delay_s/load base 1"]["n"] == 4  # noqa: PLR2004
    # One alarm in five hours, by the table of the Poisson distribution 0.0253 to 5.5716.
    alarms = found["false_alarms_per_10h"]
    assert alarms["mean"] == pytest.approx(2.0)
    assert (alarms["low"], alarms["high"]) == pytest.approx((2 * 0.0253, 2 * 5.5716), rel=1e-3)
    assert found["prediction_nees"]["mean"] == pytest.approx(1.2)
    assert stats.poisson.sf(0, alarms["low"] / 2) == pytest.approx(0.025, rel=1e-6)
    with (tmp_path / "living-twin" / "tables" / "watched.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == 10  # noqa: PLR2004


def test_what_sticks_has_no_size_that_a_band_could_hold(tmp_path, monkeypatch):
    pairs = [watched("stuck wrist", "stuck wrist", off=9.0), watched()] * 2 + [watched()]
    found = measured(tmp_path, pairs + [watched("", "")] * 5, monkeypatch)["measured"]
    assert found["size_coverage95"]["n"] == 3  # noqa: PLR2004
    assert found["isolation_fraction"]["mean"] == 1.0


def test_what_is_suspected_by_what_is_linear_is_held_beside_what_was_named(tmp_path, monkeypatch):
    spring = "spring rear_left"
    changed = [
        watched(suspected="load base"), watched(suspected=spring), watched(suspected="load base"),
        watched(found=spring, suspected="load base"), watched(),
    ]  # fmt: skip
    found = measured(tmp_path, changed + [watched("", "")] * 5, monkeypatch)["measured"]
    assert found["right_linear"]["mean"] == found["right_tried"]["mean"] == 0.75  # noqa: PLR2004
    assert (found["right_linear"]["n"], found["covered_linear"]["n"]) == (4, 3)
    assert (found["covered_linear"]["mean"], found["covered_tried"]["mean"]) == (0.0, 1.0)


@pytest.mark.slow
def test_a_quick_run_measures(tmp_path):
    words = ["living-twin", "--quick", "--jobs", "1", "--seed", "1", "--parts", "changes"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "living-twin" / "metrics.json").read_text())["measured"]
    assert found["watched_hours"] > 8.0 / 3600.0
    assert 0.0 < found["surprise"]["median"] < 2.0  # noqa: PLR2004
    assert "isolation_fraction/load gripper 0.2" in found
    assert (tmp_path / "living-twin" / "figures" / "changes.png").stat().st_size > 5_000  # noqa: PLR2004
