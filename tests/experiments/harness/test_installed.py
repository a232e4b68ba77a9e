"""The wheel holds all that runs: installed beside the checkout, used from an empty folder."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[3]
_OBSERVED = """
from twin.connect import connect
with connect("emulated") as connection:
    (robot,) = connection.robots.values()
    robot.activate()
    assert robot.observe().wheel_speeds.usable
"""
_SERVED = """
from experiments.live import drive, view
from experiments.live.page_server import PageServer
for page in (drive.PAGE, view.PAGE):
    PageServer(page, dict).close()
"""
PARTS = ("models", "twin", "perception", "controllers", "experiments")


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return the folder that the wheel was installed into, without its dependencies."""
    source, wheels, target = (tmp_path_factory.mktemp(name) for name in ("src", "wheels", "site"))
    for part in PARTS:
        left_out = shutil.ignore_patterns("__pycache__")
        shutil.copytree(CHECKOUT / part, source / part, ignore=left_out)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(CHECKOUT / name, source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    offline = ["--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "wheel", *offline, "-w", wheels, source], check=True)
    (wheel,) = wheels.glob("*.whl")
    subprocess.run([*pip, "install", *offline, "--target", target, wheel], check=True)
    return target


def run(installed, folder, *words):
    """Return what ``fieldtwin`` prints that runs from a folder."""
    return python(installed, folder, installed / "bin" / "fieldtwin", *words)


def python(installed, folder, *words):
    """Return what Python prints that runs in a folder and finds the wheel alone."""
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = subprocess.run(
        [sys.executable, "-P", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_it_lists_its_commands_and_tells_its_version(installed, tmp_path):
    listed = run(installed, tmp_path, "list")
    assert listed.startswith("usage: fieldtwin NAME") and "ch2-simulation" in listed
    assert run(installed, tmp_path).splitlines() == listed.splitlines()
    assert run(installed, tmp_path, "--version").startswith("fieldtwin 0.")
    assert "fieldtwin mission-envelope [-h]" in run(
        installed, tmp_path, "mission-envelope", "--help"
    )


@pytest.mark.slow
def test_it_runs_from_an_empty_folder(installed, tmp_path):
    """A scene, boards in another process, an experiment and the report."""
    assert "all required is here" in run(installed, tmp_path, "doctor")
    python(installed, tmp_path, "-c", _OBSERVED)
    python(installed, tmp_path, "-c", _SERVED)
    run(installed, tmp_path, "appd-radio", "--quick")
    run(installed, tmp_path, "report")
    page = (tmp_path / "results/report.html").read_text(encoding="utf-8")
    assert "appd-radio" in page
