"""Changed robots are made as said, and the experiment tells right from wrong."""

import dataclasses
import json

import numpy as np
import pytest

from controllers.identification.pitch import PitchFit
from controllers.identification.pitch_model import PitchSensors
from controllers.sensing.diagnosis import Finding
from controllers.sensing.wheel_grip import WheelGrips
from experiments.__main__ import main
from experiments.ch2.diagnosis import CASES, PLACES, WEAKER, Diagnosis, DiagnosisTrial


def told(case, wheel, *changes):
    estimate = PitchFit(PitchSensors()).estimate
    grips = WheelGrips(np.full(4, 0.5), np.full(4, 11.0))
    return Diagnosis(DiagnosisTrial(case, 1), wheel, estimate, (), grips, changes)


def test_one_seed_is_one_robot_whatever_happened_to_it():
    robots = [DiagnosisTrial(case, 5).placement for case in CASES]
    changes = [robot.made.change for robot in robots]
    assert len({(robot.made.seed, robot.made.tolerances) for robot in robots}) == 1
    assert len(set(changes)) == len(CASES)
    unchanged, load, springs, tyre = changes
    assert load.payload == 1.0 and load.springs == load.grip == 1.0
    for place, (low, high) in zip(load.payload_place, PLACES):
        assert low <= place <= high
    assert springs.springs == WEAKER and springs.payload == 0.0
    assert tyre.grip == WEAKER and tyre.worn_wheel and tyre.springs == 1.0
    assert dataclasses.replace(springs, springs=1.0) == unchanged


def test_only_the_right_name_and_wheel_count():
    worn = Finding("worn tyre rear_left", 0.5, 0.05, 6.0)
    load = Finding("load on the base", 0.03, 0.01, 3.0)
    slight = Finding("soft springs", 0.9, 0.1, 1.0)
    assert told("tyre", "rear_left", worn, slight).right
    assert not told("tyre", "rear_right", worn, slight).right
    assert told("tyre", "rear_left", worn, load).named == "worn tyre rear_left"
    assert told("load", "", load, slight).right and not told("springs", "", load, slight).right
    assert told("unchanged", "", slight).right and not told("unchanged", "", load).right
    assert told("springs", "", slight).deviations("soft springs") == 1.0
    assert np.isnan(told("springs", "", slight).deviations("worn tyre"))


@pytest.mark.slow
def test_quick_run_writes_everything(tmp_path):
    words = ["ch2-diagnosis", "--quick", "--jobs", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    folder = tmp_path / "ch2-diagnosis"
    metrics = json.loads((folder / "metrics.json").read_text())
    assert len(metrics["checks"]) == len(CASES)
    assert (folder / "figures/changes.png").stat().st_size > 10_000
    rows = (folder / "tables/diagnoses.csv").read_text().splitlines()
    assert len(rows) == 1 + 3 + 3
