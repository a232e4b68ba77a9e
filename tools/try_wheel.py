"""Build sdist and wheel, install the wheel in an empty environment, run it from an empty folder.

Run by ``make wheel``. What is built stays in dist/. The environment gets the packages that pip
chooses (newest), the oldest that pyproject.toml admits (lowest), or those of requirements.lock
(locked). With --runs all every experiment runs, else one of each room.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tarfile
import time
import tomllib
import venv
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent
LIGHTEST = {
    "appa": "appa-truss",
    "appc": "appc-compression",
    "appd": "appd-radio",
    "appe": "appe-workspace",
    "bench": "bench --only loop",
    "ch2": "ch2-friction",
    "ch3": "ch3-swarm",
    "ch4": "ch4-montecarlo",
    "ch5": "ch5-contact",
    "envelope": "mission-envelope",
    "living": "living-twin",
    "mission": "mission",
    "own": "own-robot",
}
"""The experiment of each room whose quick run takes the least time."""
PATIENCE = 1800.0
"""Longest that a command may take, on a busy machine [s]."""
_ASK = "import json; from experiments.harness.catalogue import EXPERIMENTS as E; print(json.dumps("
_ASK += "{name: each.module.split('.')[1] for name, each in E.items()}))"


def main() -> int:
    """Do all; return 0 if every command ran."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", choices=("lightest", "all"), default="lightest")
    parser.add_argument("--versions", choices=("newest", "lowest", "locked"), default="newest")
    options = parser.parse_args()
    work = ROOT / "build" / "wheel"
    shutil.rmtree(work, ignore_errors=True)
    wheel = build(work, ROOT / "dist")
    constraints = pins(options.versions)
    venv.create(work / "venv", with_pip=True)
    python = work / "venv" / "bin" / "python"
    install(python, str(wheel), constraints)
    folder = work / "empty"
    folder.mkdir()
    rooms = json.loads(run(python.parent, folder, [str(python), "-P", "-c", _ASK]))
    failed = failures(python.parent, folder, commands(rooms, options.runs))
    if options.runs == "all":
        install(python, f"{wheel}[peers]", constraints)
        failed += failures(python.parent, folder, [["bench", "--quick"]])
    return 1 if failed else 0


def build(work: Path, dist: Path) -> Path:
    """Build sdist and wheel from what git has, and return the wheel.

    Args:
        work: Folder for what is built on the way.
        dist: Folder for both; older ones in it are removed.

    Raises:
        SystemExit: If the sdist builds another wheel.
    """
    source = work / "source"
    for name in subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True).split("\0"):
        if name and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, source / name)
    shutil.rmtree(dist, ignore_errors=True)
    _build(source, dist, "--sdist", "--wheel")
    (sdist,), (wheel,) = dist.glob("*.tar.gz"), dist.glob("*.whl")
    with tarfile.open(sdist) as archive:
        archive.extractall(work / "unpacked", filter="data")
    (unpacked,) = (work / "unpacked").iterdir()
    _build(unpacked, work / "from_sdist", "--wheel")
    if names := differing(wheel, work / "from_sdist" / wheel.name):
        sys.exit(f"the wheel from the sdist differs in {', '.join(names)}")
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, the same from the sdist", flush=True)
    return wheel


def _build(source: Path, target: Path, *kinds: str) -> None:
    command = [sys.executable, "-m", "build", "--no-isolation", *kinds, "-o", target, source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{done.stdout[-3000:]}{done.stderr[-3000:]}")


def differing(one: Path, other: Path) -> list[str]:
    """Return the names of what two wheels do not have alike."""
    left, right = ({i.filename: i.CRC for i in zipfile.ZipFile(w).infolist()} for w in (one, other))
    return sorted(name for name in left.keys() | right if left.get(name) != right.get(name))


def pins(versions: str) -> list[str]:
    """Return constraints of pip for a choice of versions.

    Args:
        versions: ``newest``, ``lowest`` or ``locked``.
    """
    if versions == "locked":
        lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
        return [line.removesuffix(" \\") for line in lines if not line.startswith(" ")]
    if versions == "lowest":
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        return [_lowest(Requirement(each)) for each in project["dependencies"]]
    return []


def _lowest(requirement: Requirement) -> str:
    (bound,) = (each.version for each in requirement.specifier if each.operator == ">=")
    return f"{requirement.name}=={bound}"


def install(python: Path, what: str, constraints: Sequence[str]) -> None:
    """Install a wheel and what it needs.

    Args:
        python: Interpreter of the environment.
        what: The wheel, with extras in brackets.
        constraints: Constraints of pip.

    Raises:
        SystemExit: If pip cannot, or packages do not fit together.
    """
    named = python.parent / "constraints.txt"
    named.write_text("\n".join(constraints), encoding="utf-8")
    pip = [python, "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet"]
    for words in (["install", "-c", named, what], ["check"]):
        if subprocess.run([*pip, *words], check=False).returncode != 0:
            sys.exit(f"pip {words[0]} failed for {what}")


def commands(rooms: Mapping[str, str], runs: str) -> Iterator[list[str]]:
    """Yield the commands to run.

    Args:
        rooms: Room of each experiment.
        runs: ``lightest`` or ``all``.

    Raises:
        SystemExit: If a room has no experiment among the lightest.
    """
    if set(rooms.values()) != LIGHTEST.keys():
        sys.exit(f"LIGHTEST: {', '.join(set(rooms.values()) ^ LIGHTEST.keys())}?")
    yield from (["--version"], ["list"], ["doctor"])
    # All of bench needs an extra.
    every = [LIGHTEST["bench"] if room == "bench" else name for name, room in rooms.items()]
    yield from (
        [*each.split(), "--quick"] for each in (every if runs == "all" else LIGHTEST.values())
    )
    yield ["report"]


def failures(scripts: Path, folder: Path, wanted: Iterable[list[str]]) -> int:
    """Run commands of fieldtwin, print how long each took, and return how many failed.

    Args:
        scripts: Folder of the environment's commands.
        folder: Folder to run them in.
        wanted: Their words.
    """
    failed, start = 0, time.monotonic()
    for words in wanted:
        begin = time.monotonic()
        try:
            run(scripts, folder, [str(scripts / "fieldtwin"), *words])
            said = "ok"
        except subprocess.CalledProcessError as error:
            failed += 1
            said = f"FAILED, status {error.returncode}\n{error.output[-3000:]}"
        except subprocess.TimeoutExpired:
            failed += 1
            said = f"FAILED, not done in {PATIENCE:.0f} s"
        print(f"{time.monotonic() - begin:6.1f} s  {' '.join(words):40} {said}", flush=True)
    print(f"{time.monotonic() - start:6.1f} s  in all, {failed} failed", flush=True)
    return failed


def run(scripts: Path, folder: Path, command: Sequence[str]) -> str:
    """Return what a command prints that sees nothing of this checkout, nor of this home.

    Args:
        scripts: Folder of the environment's commands.
        folder: Folder to run it in, and its home.
        command: Its words.

    Raises:
        subprocess.CalledProcessError: If it fails.
        subprocess.TimeoutExpired: If it takes too long.
    """
    mine = ("PYTHON", "MUJOCO_GL", "VIRTUAL_ENV", "XDG_", "NUMBA_", "MPL")
    environment = {name: text for name, text in os.environ.items() if not name.startswith(mine)}
    environment |= {"PATH": f"{scripts}:{os.environ['PATH']}", "HOME": str(folder)}
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
        timeout=PATIENCE,
    ).stdout


if __name__ == "__main__":
    sys.exit(main())
