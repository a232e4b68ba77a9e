"""Kernels are compiled wherever this is installed, and kept where that can be."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[3]
PARTS = ("models", "twin", "perception", "controllers", "experiments")
KERNEL = """
import os
import numpy as np
from perception.geometry.se3 import write_near_log
twist = np.empty(6)
write_near_log(np.array([3.0, 4.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), twist)
print(np.linalg.norm(twist), os.environ.get("NUMBA_CACHE_DIR", "unset"))
"""
WITH_A_WORKER = """
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import perception
with ProcessPoolExecutor(1, get_context("spawn")) as pool:
    place = pool.submit(os.getenv, "NUMBA_CACHE_DIR").result()
    print(place == os.environ["NUMBA_CACHE_DIR"], place)
"""


def unprivileged() -> list[str]:
    """Return what runs a command without root's right to write everywhere."""
    if os.geteuid() != 0:
        return []
    if shutil.which("setpriv") is None:
        pytest.skip("root can write everywhere, and there is no setpriv (util-linux) to drop that")
    return ["setpriv", "--inh-caps=-all", "--bounding-set=-all"]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Return a folder with all of `perception` that cannot be written."""
    site = tmp_path_factory.mktemp("site")
    left_out = shutil.ignore_patterns("__pycache__")
    shutil.copytree(CHECKOUT / "perception", site / "perception", ignore=left_out)
    subprocess.run(["chmod", "-R", "a-w", site], check=True)
    yield site
    subprocess.run(["chmod", "-R", "u+w", site], check=True)


@pytest.fixture
def home(tmp_path):
    """Return a home that cannot be written."""
    tmp_path.chmod(0o555)
    yield tmp_path
    tmp_path.chmod(0o755)


def run(site, home, code, **environment):
    """Run code that finds the installed package in the folder of its home."""
    done = subprocess.run(
        [*unprivileged(), sys.executable, "-P", "-c", code],
        env={"PATH": os.environ["PATH"], "HOME": str(home), "PYTHONPATH": str(site)} | environment,
        cwd=home,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done


def test_a_kernel_is_compiled_where_nothing_of_the_user_s_can_be_written(installed, home):
    done = run(installed, home, KERNEL)
    length, place = done.stdout.split()
    assert float(length) == 5.0
    assert Path(place).name.startswith("fieldtwin-kernels-")
    assert not Path(place).exists()  # Gone with its process.
    (line,) = done.stderr.splitlines()
    assert "set NUMBA_CACHE_DIR to a folder" in line and str(installed) in line


def test_processes_that_are_spawned_share_the_folder(installed, home):
    done = run(installed, home, WITH_A_WORKER)
    same, place = done.stdout.split()
    assert same == "True" and Path(place).name.startswith("fieldtwin-kernels-")
    assert len(done.stderr.splitlines()) == 1


def test_numba_that_is_imported_first_uses_the_folder_too(installed, home):
    assert "fieldtwin-kernels-" in run(installed, home, f"import numba\n{KERNEL}").stdout


def test_kernels_are_kept_below_a_home_that_can_be_written(installed, tmp_path):
    done = run(installed, tmp_path, KERNEL)
    assert done.stdout.split()[1] == "unset" and done.stderr == ""
    assert list(tmp_path.glob(".cache/numba/geometry_*/*write_near_log*.nbc"))


def test_kernels_are_kept_where_the_user_says(installed, home, tmp_path_factory):
    wanted = tmp_path_factory.mktemp("kernels") / "deep"
    done = run(installed, home, KERNEL, NUMBA_CACHE_DIR=str(wanted))
    assert done.stdout.split()[1] == str(wanted) and done.stderr == ""
    assert list(wanted.glob("geometry_*/*write_near_log*.nbc"))


def test_every_module_with_kernels_imports_the_package_that_finds_their_place():
    without = []
    for path in (each for part in PARTS for each in (CHECKOUT / part).rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        named = {
            alias.name for each in nodes if isinstance(each, ast.Import) for alias in each.names
        }
        named |= {each.module or "" for each in nodes if isinstance(each, ast.ImportFrom)}
        rooms = {name.split(".")[0] for name in named} | {path.relative_to(CHECKOUT).parts[0]}
        if "numba" in rooms and "perception" not in rooms:
            without.append(str(path.relative_to(CHECKOUT)))
    assert without == []
