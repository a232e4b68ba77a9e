"""The experiments on BRAID's workspace and inverse kinematics write what they must."""

import json

import pytest

from experiments.appe.arm import inverse as appe_inverse
from experiments.appe.arm import workspace as appe_workspace
from experiments.harness.output import Output


def quick(module, name, folder, **changes):
    options = module.Options(quick=True, out=folder, **changes)
    output = Output(name, options)
    module.run(options, output)
    output.finish()
    return json.loads((folder / name / "metrics.json").read_text())


def test_workspace_has_the_known_number_of_poses(tmp_path):
    metrics = quick(appe_workspace, "appe-workspace", tmp_path)
    assert 30_744 in metrics["measured"].values()
    assert all(check["ok"] for check in metrics["checks"])


@pytest.mark.slow
def test_short_arms_are_solved_as_brute_force_does(tmp_path):
    metrics = quick(appe_inverse, "appe-inverse", tmp_path, targets=6, jobs=1)
    # How good a search is at twenty stages in a given time is measured, not tested.
    exact = [check for check in metrics["checks"] if "20" not in check["name"].split()[0:3]]
    assert exact
    failed = [check["name"] for check in metrics["checks"] if not check["ok"]]
    assert all("20" in name or "ms" in name for name in failed), failed
