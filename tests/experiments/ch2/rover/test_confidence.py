"""How coverage and confidence of identifications are counted."""

import dataclasses
import json

import numpy as np
import pytest

from controllers.identification.pitch import NAMES
from experiments.ch2.rover.confidence import RobotIdentification, measure_confidence
from experiments.harness.contract import RepeatedOptions
from experiments.harness.output import Output

TRUTH = np.array([0.07, 0.05, 0.1, 1.5, 300.0])
SIGMA = 0.1 * TRUTH


def off_by(deviations, doubts=(), robot="rover1"):
    return RobotIdentification(robot, TRUTH + deviations * SIGMA, SIGMA, 1.0, doubts, TRUTH)


@pytest.fixture
def measured(tmp_path):
    def measure(found):
        output = Output("tiny", RepeatedOptions(out=tmp_path))
        measure_confidence(found, output)
        output.finish()
        return json.loads((output.directory / "metrics.json").read_text())["measured"]

    return measure


def test_only_identifications_that_are_used_count_for_coverage_and_confidence(measured):
    unit = np.eye(5)
    found = [
        off_by(np.zeros(5)),
        off_by(1.9 * unit[0]),
        off_by(2.1 * unit[0]),
        off_by(-4.1 * unit[1]),
        off_by(9.0 * np.ones(5), doubts=("chi squared is 7.0",)),
    ]
    metrics = measured(found)
    assert metrics["identified_fraction"]["mean"] == pytest.approx(0.8)
    assert metrics["false_confidence_fraction"]["mean"] == pytest.approx(0.25)
    coverage = [metrics[f"identification_coverage95/{name}"]["mean"] for name in NAMES]
    assert coverage == pytest.approx([0.75, 0.75, 1.0, 1.0, 1.0])


def test_errors_are_of_each_robot_by_itself(measured):
    found = [off_by(np.ones(5)), off_by(3.0 * np.ones(5), robot="rover2")]
    metrics = measured(found)
    for robot, error in (("rover1", 10.0), ("rover2", 30.0)):
        key = f"identification_error_percent/{robot}"
        assert metrics[key]["median"] == pytest.approx(error)
        assert metrics[f"{key}/k_pitch"]["median"] == pytest.approx(error)


def test_without_a_used_identification_there_is_no_coverage(measured):
    refused = dataclasses.replace(off_by(np.zeros(5)), doubts=("the fit did not converge",))
    metrics = measured([refused])
    assert metrics["identified_fraction"]["mean"] == 0.0
    assert "false_confidence_fraction" not in metrics
