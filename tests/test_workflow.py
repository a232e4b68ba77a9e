"""The workflow's steps are the Makefile's targets, and it needs no secret."""

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parent.parent
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
MAKEFILE = (ROOT / "Makefile").read_text()
TARGETS = set(re.findall(r"^([a-z]+):.*##", MAKEFILE, re.MULTILINE))
VARIABLES = set(re.findall(r"^([A-Z_]+) \?=", MAKEFILE, re.MULTILINE))
JOBS = yaml.safe_load(WORKFLOW.read_text())["jobs"]


@pytest.mark.parametrize("job", JOBS)
def test_every_step_that_runs_is_a_target_of_the_makefile(job):
    runs = [step["run"] for step in JOBS[job]["steps"] if "run" in step]
    assert runs
    for line in runs:
        make, target, *settings = re.sub(r"\$\{\{ [\w.]+ \}\}", "X", line).split()
        assert make == "make" and target in TARGETS
        assert all(word.split("=")[0] in VARIABLES for word in settings)


@pytest.mark.parametrize("job", JOBS)
def test_every_value_that_a_step_uses_is_in_its_matrix(job):
    used = set(re.findall(r"matrix\.(\w+)", str(JOBS[job]["steps"])))
    matrix = JOBS[job].get("strategy", {}).get("matrix", {})
    for row in matrix.get("include", [matrix]):
        assert used == row.keys() - {"include"}


def test_wheel_is_tried_with_every_choice_of_versions_and_once_with_all():
    rows = JOBS["wheel"]["strategy"]["matrix"]["include"]
    assert {row["versions"] for row in rows} == {"newest", "lowest", "locked"}
    assert "all" in {row["runs"] for row in rows}


def test_lint_docs_tests_wheel_and_image_run_without_secrets_and_end():
    assert {"lint", "docs", "test", "wheel", "image"} <= JOBS.keys()
    assert "secrets." not in WORKFLOW.read_text()
    assert yaml.safe_load(WORKFLOW.read_text())["permissions"] == {"contents": "read"}
    assert all(job["timeout-minutes"] <= 120 for job in JOBS.values())
