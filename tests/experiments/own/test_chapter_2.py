"""Chapter 2's plant and planner as a case: a base on springs, told by the swing of its arm."""

import csv
import json

import mujoco
import numpy as np
import pytest

from experiments.__main__ import main
from models.datasheets import TABLE_2_1_TRUTH
from tests.experiments.own import hidden

PLANT = "compliant_base"
SEEN = ["joint.y.*", "joint.z.*", "joint.pitch.*", "body.base.mass"]
"""What a swing about the x axis tells (mode x of Thesis section 2.6.1)."""
TICK = 0.002


@pytest.fixture
def finer(monkeypatch):
    """Steps of the plant are a tenth of those of other robots already."""
    monkeypatch.setattr(hidden, "FINE", 2)


def change(spec):
    """Another base than the drawn one, by up to a third."""
    generator = np.random.default_rng(3)
    for name in ("y", "z", "pitch"):
        joint = spec.joint(name)
        joint.stiffness[0] *= generator.uniform(0.75, 1.33)
        joint.damping[0] *= generator.uniform(0.75, 1.33)
    spec.body("base").mass *= 1.2


def log(folder, name, stamps, angles):
    generator = np.random.default_rng(len(name))
    found = hidden.measured(PLANT, change, stamps, angles[:, None], generator)
    hidden.write_csv(folder / f"{name}.csv", PLANT, stamps, angles[:, None], *found)


def identified(folder, name):
    words = ["--model", hidden.robot(PLANT), "--mapping", f"{folder}/robot.toml"]
    words += ["--log", f"{folder}/{name}.csv", "--hold-out", f"{folder}/unseen.csv"]
    status = main(["identify", *words, "--parameters", *SEEN, "--out", f"{folder}/{name}"])
    content = json.loads((folder / name / "identified.json").read_text())
    return status, content["parameters"], np.array(content["covariance"])


def test_the_drawing_is_table_2_1():
    model = mujoco.MjModel.from_xml_path(hidden.robot(PLANT))
    assert model.body("base").mass[0] == TABLE_2_1_TRUTH["mass"]
    for joint, suffix in (("x", "x"), ("z", "z"), ("pitch", "_pitch"), ("yaw", "_yaw")):
        place = model.joint(joint).dofadr[0]
        assert model.joint(joint).stiffness[0] == TABLE_2_1_TRUTH[f"k{suffix}"]
        assert model.dof_damping[place] == TABLE_2_1_TRUTH[f"b{suffix}"]


@pytest.mark.slow
def test_the_designed_swing_tells_the_base_and_a_constant_one_less(tmp_path, finer):
    hidden.write_mapping(tmp_path / "robot.toml", PLANT)
    limits = tmp_path / "limits.toml"
    limits.write_text("[joints.shoulder]\nrate = 4\n")
    words = ["--model", hidden.robot(PLANT), "--limits", str(limits), "--parameters", *SEEN]
    words += ["--duration", "3.2", "--highest", "3", "--generations", "1"]
    assert main(["excite", *words, "--out", f"{tmp_path}/motion.csv"]) == 0
    with (tmp_path / "motion.csv").open() as stream:
        rows = np.array([row for row in csv.reader(stream)][1:], dtype=float)
    log(tmp_path, "motion", *rows.T)
    stamps = np.arange(0.0, 3.2, TICK)
    blend = np.minimum(stamps, 1.0)
    # As fast as the limit allows: one amplitude and frequency (Thesis section 2.6.1, "constant").
    log(tmp_path, "constant", stamps, 0.6 * blend * np.sin(2.0 * np.pi * stamps))
    log(tmp_path, "unseen", stamps, 0.5 * blend * np.sin(9.0 * stamps + np.sin(4.0 * stamps)))
    status, found, covariance = identified(tmp_path, "motion")
    assert status == 0 and all(each["told"] for each in found)
    drawn = mujoco.MjSpec.from_file(hidden.robot(PLANT))
    change(drawn)
    truth = {"body.base.mass": drawn.body("base").mass}
    for joint in ("y", "z", "pitch"):
        truth[f"joint.{joint}.stiffness"] = drawn.joint(joint).stiffness[0]
        truth[f"joint.{joint}.damping"] = drawn.joint(joint).damping[0]
    for each, variance in zip(found, np.diag(covariance), strict=True):
        off = np.log(each["value"] / truth[each["name"]]) / each["spread"]
        assert abs(off) < 4.0 * np.sqrt(variance), each["name"]
    _, less, of_constant = identified(tmp_path, "constant")
    assert [each["name"] for each in less if not each["told"]] == ["body.base.mass"]
    assert np.trace(of_constant) > 1.3 * np.trace(covariance)
