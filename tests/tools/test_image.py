"""The image has what renders, what runs, and nothing else."""

import re
import subprocess
from fnmatch import fnmatch

from experiments.doctor.doctor import GL_LIBRARIES, MESA_DRIVERS
from tools.try_wheel import ROOT, pins

DOCKERFILE = (ROOT / "Dockerfile").read_text()
INSTRUCTIONS = re.sub(r"\\\n\s*", " ", DOCKERFILE)


def test_it_installs_what_the_doctor_and_the_set_up_say_that_rendering_needs():
    (wanted,) = re.findall(
        r'^packages="(.*)"$', (ROOT / "tools/ensure_rendering.sh").read_text(), re.M
    )
    assert set(wanted.split()) == {*GL_LIBRARIES.values(), MESA_DRIVERS}
    (installed,) = re.findall(
        r"apt-get install -y --no-install-recommends (.*?)\s*&&", INSTRUCTIONS
    )
    assert set(installed.split()) == {*wanted.split(), "python3", "python3-venv"}


def test_its_versions_are_those_of_the_lock():
    (script,) = re.findall(r"sed -n '(.+?)' /src/requirements.lock", INSTRUCTIONS)
    kept = subprocess.check_output(["sed", "-n", script, ROOT / "requirements.lock"], text=True)
    assert kept.splitlines() == pins("locked")


def test_it_runs_fieldtwin_as_a_user_without_rights():
    lines = INSTRUCTIONS.splitlines()
    assert 'ENTRYPOINT ["fieldtwin"]' in lines
    assert lines.index("USER fieldtwin") < lines.index('ENTRYPOINT ["fieldtwin"]')
    assert not any(line.startswith("USER root") for line in lines)


def test_it_is_built_from_what_the_wheel_is_built_from():
    rules = (ROOT / ".dockerignore").read_text().splitlines()
    admitted = {rule[1:] for rule in rules if rule.startswith("!")}
    assert "*" in rules
    packages = {path.parent.name for path in ROOT.glob("*/py.typed")}
    assert admitted == packages | {"pyproject.toml", "requirements.lock", "README.md", "LICENSE"}
    assert fnmatch("models/__pycache__", rules[-1])
