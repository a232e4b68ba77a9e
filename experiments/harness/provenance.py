"""With what a run was made: versions, commit, processor and its linear algebra."""

import contextlib
import datetime
import importlib.metadata
import os
import platform
import re
import subprocess
from pathlib import Path
from typing import Any

import threadpoolctl

PACKAGES = (
    "fieldtwin",
    "mujoco",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "trimesh",
    "rerun-sdk",
    "numba",
    "matplotlib",
    "joblib",
)


def describe_run(wall_time: float) -> dict[str, Any]:
    """Return what run.json holds.

    Args:
        wall_time: Duration of the run [s].
    """
    return {
        "finished": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "wall_time_s": round(wall_time, 3),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_name(),
        "cores": free_cores(),
        "linear_algebra": linear_algebra(),
        "gl": os.environ.get("MUJOCO_GL", ""),
        "versions": versions(),
        **commit(),
    }


def versions() -> dict[str, str | None]:
    """Return the installed version of each package that results depend on; None if missing."""
    found: dict[str, str | None] = {}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = None
    return found


def commit() -> dict[str, Any]:
    """Return the commit of the checkout and whether files differ from it; None if unknown."""
    checkout = Path(__file__).resolve().parents[2]
    head = _git(checkout, "rev-parse", "HEAD")
    changes = _git(checkout, "status", "--porcelain") if head else None
    return {"commit": head, "modified": None if changes is None else bool(changes)}


def cpu_name() -> str:
    """Return the processor's name as the system reports it."""
    try:
        name = re.search(r"^model name\s*:(.*)", Path("/proc/cpuinfo").read_text("utf-8"), re.M)
    except OSError:
        name = None
    return name[1].strip() if name else platform.processor() or platform.machine()


def free_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def linear_algebra() -> list[str]:
    """Return name, version and kernels of each linear algebra library that is loaded.

    Kernels for two kinds of processors differ in the last bits, and a long course with them.
    """
    loaded = (each for each in threadpoolctl.threadpool_info() if each["user_api"] == "blas")
    return sorted(
        {f"{e['internal_api']} {e['version']} {e.get('architecture', '')}".strip() for e in loaded}
    )


def _git(checkout: Path, *arguments: str) -> str | None:
    """Return what git prints; None if the checkout is none or git fails."""
    words = ["git", "-C", str(checkout), *arguments]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        if (checkout / ".git").exists():
            done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=10)
            return done.stdout.strip()
    return None
