"""``python -m experiments doctor``: is everything here that the experiments need?"""

import ctypes
import importlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterator, Sequence

from packaging.requirements import Requirement

from experiments.doctor.doctor_options import Options
from experiments.doctor.findings import Finding
from experiments.harness import provenance

PROBE_TIMEOUT = 60.0  # [s]
OLDEST_PYTHON = (3, 11)

# Shared library that software rendering opens -> Debian/Ubuntu package that has it.
GL_LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libEGL_mesa.so.0": "libegl-mesa0",
    "libOpenGL.so.0": "libopengl0",
    "libGL.so.1": "libgl1",
}
MESA_DRIVERS = "libgl1-mesa-dri"


def run(options: Options) -> int:
    """Print the findings; return 1 if something required is missing, else 0."""
    failed = 0
    for finding in _findings(options):
        print(finding.line, flush=True)
        failed += finding.fatal
    print(f"{failed} required things are missing or not well" if failed else "all required is here")
    return 1 if failed else 0


def _findings(options: Options) -> Iterator[Finding]:
    """Examine the machine, then the robot if there is one."""
    yield from examine_python()
    yield from examine_packages(requirements())
    yield from examine_rendering()
    if options.robot is not None:
        # Only now: what it imports may be what is missing.
        robot = importlib.import_module("experiments.doctor.robot")
        yield from robot.examine_robot(options.robot, options.patience)


def examine_python() -> list[Finding]:
    """Examine the interpreter and the machine."""
    old = sys.version_info[:2] < OLDEST_PYTHON
    return [
        Finding("python", platform.python_version(), "needs python 3.11 or newer" if old else ""),
        Finding("system", platform.platform()),
        Finding("processor", f"{provenance.cpu_name()}, {provenance.free_cores()} cores free"),
        Finding("commit", str(provenance.commit()["commit"] or "unknown")),
    ]


def requirements() -> list[Requirement]:
    """Return the packages that the project needs to run, as it was installed."""
    needed = map(Requirement, importlib.metadata.requires("fieldtwin") or ())
    return [each for each in needed if each.marker is None or each.marker.evaluate({"extra": ""})]


def examine_packages(needed: Sequence[Requirement]) -> list[Finding]:
    """Compare the installed packages with those that are needed.

    Args:
        needed: Packages with their versions.
    """
    findings = []
    for each in needed:
        try:
            found = importlib.metadata.version(each.name)
        except importlib.metadata.PackageNotFoundError:
            findings.append(Finding(each.name, "not installed", f"pip install '{each}'"))
            continue
        fits = each.specifier.contains(found, prereleases=True)
        remedy = "" if fits else f"pip install '{each}'"
        findings.append(Finding(each.name, found, remedy))
    return findings


def examine_rendering() -> list[Finding]:
    """Render a frame, and if that fails examine the GL libraries."""
    backend = os.environ.get("MUJOCO_GL", "")
    findings = [Finding("MUJOCO_GL", backend or "unset")]
    frame = examine_frame()
    if frame[0].fatal and backend == "egl":
        findings += [
            Finding(library, "not found", f"apt install {package}")
            for library, package in GL_LIBRARIES.items()
            if not can_load(library)
        ]
    return findings + frame


def examine_frame() -> list[Finding]:
    """Render a test frame in a process of its own."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "experiments.doctor.render_probe"],
            check=False,
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT,
        )
    except subprocess.TimeoutExpired:
        return [Finding("test frame", f"not rendered in {PROBE_TIMEOUT:g} s", _frame_remedy())]
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        return [Finding("test frame", last, _frame_remedy())]
    found = json.loads(done.stdout.splitlines()[-1])
    return [
        Finding("GL renderer", f"{found['renderer']}, {found['version']}"),
        Finding("test frame", f"sha256 {found['checksum']}"),
    ]


def can_load(library: str) -> bool:
    """Return whether the system has a shared library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _frame_remedy() -> str:
    if os.environ.get("MUJOCO_GL") == "osmesa":
        return "apt install libosmesa6, or MUJOCO_GL=egl"
    packages = " ".join([*dict.fromkeys(GL_LIBRARIES.values()), MESA_DRIVERS])
    return f"apt install {packages}"
