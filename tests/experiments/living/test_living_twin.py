"""The experiment's scores, and a quick run from the command line."""

import csv
import dataclasses
import json

import pytest
from scipy import stats

from experiments.__main__ import main
from experiments.harness.output import Output
from experiments.living import living_twin
from experiments.living.living_twin_options import Options
from experiments.living.trial import LivingTrial, Told, Watched, watch


def told(name="load base", found="load base", delay=2.0, off=0.0, suspected=""):
    return Told(name, 1.0, delay, found, 1.0 + off, 0.1, suspected, 1.3, 0.1)


def rover(*changes, alarms=()):
    return Watched(changes, alarms, 1800.0, 0.5, 1.2)


def measured(tmp_path, changed, unchanged, monkeypatch):
    """Metrics of rovers to each of which one thing happened, and of others."""
    monkeypatch.setattr(living_twin, "CELLS", (("load base", 1.0),))
    monkeypatch.setattr(living_twin, "LOOSE", ())
    results = [*map(rover, changed), *unchanged]
    monkeypatch.setattr(living_twin, "sweep", lambda *_, **__: results)
    options = Options(seeds=len(changed), out=tmp_path, parts=("changes",))
    output = Output("living-twin", options, [])
    living_twin.run(options, output)
    output.finish()
    output.close()
    return json.loads((tmp_path / "living-twin" / "metrics.json").read_text())["measured"]


def test_scores_count_what_was_missed_as_wrong_and_late(tmp_path, monkeypatch):
    nothing = float("nan")
    changed = [
        told(), told(delay=1.0, off=0.19), told(off=0.2),
        told(found="spring rear_left"), told(found="", delay=nothing),
    ]  # fmt: skip
    unchanged = [rover(alarms=("battery",)), *[rover()] * 4]
    found = measured(tmp_path, changed, unchanged, monkeypatch)
    assert found["isolation_fraction"]["mean"] == pytest.approx(0.6)
    assert found["size_coverage95"]["mean"] == pytest.approx(2 / 3)
    assert found["detection_delay_s"]["median"] == 2.0  # noqa: PLR2004
    assert found["detection_delay_s/load base 1"]["n"] == 4  # noqa: PLR2004
    # One alarm in two and a half hours, by the table of the Poisson distribution 0.0253 to 5.5716.
    alarms = found["false_alarms_per_10h"]
    assert alarms["mean"] == pytest.approx(4.0)
    assert (alarms["low"], alarms["high"]) == pytest.approx((4 * 0.0253, 4 * 5.5716), rel=1e-3)
    assert found["prediction_nees"]["mean"] == pytest.approx(1.2)
    assert stats.poisson.sf(0, alarms["low"] / 4) == pytest.approx(0.025, rel=1e-6)
    for table, rows in (("rovers", 10), ("changes", 5)):
        with (tmp_path / "living-twin" / "tables" / f"{table}.csv").open() as stream:
            assert len(list(csv.DictReader(stream))) == rows


def test_what_sticks_has_no_size_that_a_band_could_hold(tmp_path, monkeypatch):
    changed = [told("stuck wrist", "stuck wrist", off=9.0), told()] * 2 + [told()]
    found = measured(tmp_path, changed, [rover()] * 5, monkeypatch)
    assert found["size_coverage95"]["n"] == 3  # noqa: PLR2004
    assert found["isolation_fraction"]["mean"] == 1.0


def test_what_is_suspected_by_what_is_linear_is_held_beside_what_was_named(tmp_path, monkeypatch):
    spring = "spring rear_left"
    changed = [
        told(suspected="load base"), told(suspected=spring), told(suspected="load base"),
        told(found=spring, suspected="load base"), told(),
        told("stuck elbow", "stuck elbow", suspected=spring),
    ]  # fmt: skip
    found = measured(tmp_path, changed, [rover()] * 6, monkeypatch)
    assert found["right_linear"]["mean"] == found["right_tried"]["mean"] == 0.75  # noqa: PLR2004
    assert (found["right_linear"]["n"], found["covered_linear"]["n"]) == (4, 3)
    assert (found["covered_linear"]["mean"], found["covered_tried"]["mean"]) == (0.0, 1.0)


@pytest.mark.slow
def test_a_quick_run_measures(tmp_path):
    words = ["living-twin", "--quick", "--jobs", "1", "--seed", "1", "--parts", "changes"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "living-twin" / "metrics.json").read_text())["measured"]
    assert found["watched_hours"] >= 8.0 / 3600.0
    assert 0.0 < found["surprise"]["median"] < 2.0  # noqa: PLR2004
    assert "isolation_fraction/load gripper 0.2" in found
    assert (tmp_path / "living-twin" / "figures" / "changes.png").stat().st_size > 5_000  # noqa: PLR2004


@pytest.mark.slow
def test_things_that_happen_to_one_rover_are_told_as_if_each_were_the_only_one():
    happenings = ("load gripper", 0.2), ("battery", 0.3)
    together = watch(LivingTrial(5, happenings, 5.0))
    for each, told_together in zip(happenings, together.told, strict=True):
        alone = watch(LivingTrial(5, (each,), 5.0))
        assert dataclasses.replace(alone, told=()) == dataclasses.replace(together, told=())
        assert alone.told == (told_together,)
        assert told_together.found
