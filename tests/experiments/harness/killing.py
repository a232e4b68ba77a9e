"""Experiments that are killed, run twice at once or damaged, and what is left of them."""

import contextlib
import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from experiments.__main__ import main
from experiments.harness.contract import RepeatedOptions
from experiments.harness.output import Output, plain
from experiments.harness.storage import read_checked
from experiments.harness.sweep import sweep
from tests.experiments.harness import tiny

WORDS = ["tests.experiments.harness.tiny", "tiny", "--sweep", "12"]
SPAN = 4.0
"""From before the first job until after the last, on most machines [s]."""
PATIENCE = 300.0  # [s] for one run
DIFFERENT = ("out", "resume", "jobs")  # options that change no result


@dataclasses.dataclass(frozen=True)
class Trial:
    """State that one killed run left, and that of its resumption.

    Attributes:
        status: Exit status of the killed run, as `subprocess` reports it.
        finished: Jobs whose results were stored when it died.
        lost: Finished jobs that are gone, damaged or were repeated by the resumed run.
        published: What the resumed run published, see `published`.
    """

    status: int
    finished: int
    lost: int
    published: dict


def run(words, out, after=None):
    """Run ``python -m WORDS --out OUT`` and return its status.

    Args:
        words: Module and arguments.
        out: Folder of results.
        after: Signal, whether all of its processes get it, and a function that decides from the
            seconds since the start when to send it; None lets the run end.
    """
    with started(words, out) as process:
        if after is not None:
            number, everyone, when = after
            start = time.monotonic()
            while process.poll() is None and not when(time.monotonic() - start):
                time.sleep(0.01)
            if process.poll() is None:
                (os.killpg if everyone else os.kill)(process.pid, number)
        return process.wait(PATIENCE)


@contextlib.contextmanager
def started(words, out, errors=subprocess.DEVNULL):
    """Start ``python -m WORDS --out OUT`` in a session of its own, which ends with the block.

    Args:
        words: Module and arguments.
        out: Folder of results.
        errors: Receives what it prints as errors.
    """
    with subprocess.Popen(
        [sys.executable, "-m", *words, "--out", str(out)],
        start_new_session=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=errors,
        text=True,
        # A shell lets what it starts in the background ignore Ctrl-C, and that is inherited.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    ) as process:
        try:
            yield process
        finally:  # nothing of it outlives its trial
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def living(session):
    """Return the processes of a session that live, by number; Linux only."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, own = path.read_text().rpartition(")")[2].split()[:4]
            if int(own) == session and state != "Z":
                found.append(int(path.parent.name))
    return found


def wait_until(condition):
    """Wait for a condition and return how long it took [s]."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < PATIENCE
        time.sleep(0.01)
    return time.monotonic() - start


def kill_and_resume(words, name, out, after):
    """Kill a run, resume it, and compare the jobs that it had finished.

    Args:
        words: Module and arguments, without ``--out``.
        name: Name of the experiment.
        out: Empty folder of results.
        after: Signal, its recipients and its moment, see `run`.
    """
    status = run(words, out, after)
    before = _jobs(out / name)
    # A folder that holds metrics.json is complete.
    if (out / name / "metrics.json").exists():
        published(out / name)
    resumed = run([*words, "--resume"], out)
    assert resumed == 0, f"the resumed run ended with status {resumed}"
    after_it = _jobs(out / name)
    lost = sum(after_it.get(job) != kept for job, kept in before.items())
    lost += sum(read_checked(out / name / "jobs" / job) is None for job in before)
    return Trial(status, len(before), lost, published(out / name))


def undisturbed(out, seed=0):
    """Return what an undisturbed run of `WORDS` publishes, see `published`."""
    words = [*WORDS[1:], "--jobs", "1", "--seed", str(seed), "--out", str(out)]
    assert main(words, tiny.CATALOGUE) == 0
    return published(out / "tiny")


def run_two(words, seeds, out, delay):
    """Start a second run with another seed into the folder of a first one.

    Args:
        words: Module and arguments.
        seeds: Seed of either run.
        out: Folder of results.
        delay: Function that waits until the second run is to start.

    Returns:
        Exit status of either run, what either printed as errors, and the first one's process.
    """
    with tempfile.TemporaryFile("w+") as one, tempfile.TemporaryFile("w+") as two:
        with started([*words, "--seed", str(seeds[0])], out, one) as first:
            delay()
            with started([*words, "--seed", str(seeds[1])], out, two) as second:
                statuses = first.wait(PATIENCE), second.wait(PATIENCE)
        one.seek(0)
        two.seek(0)
        return statuses, (one.read(), two.read()), first.pid


def published(folder):
    """Return each file of a complete result folder, without what differs between equal runs."""
    paths = {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}
    shown = {
        name: path.read_bytes()
        for name, path in paths.items()
        if not name.startswith((".", "jobs/"))
    }
    config, run = json.loads(shown["config.json"]), json.loads(shown["run.json"])
    assert run["metrics_sha256"] == hashlib.sha256(shown["metrics.json"]).hexdigest()
    shown["config.json"] = {key: config[key] for key in config if key not in DIFFERENT}
    shown["run.json"] = run["files"]
    return shown


def damage_and_resume(folder, count, rng):
    """Flip a random bit of a job file and resume the sweep, again and again.

    Args:
        folder: Empty folder of results.
        count: Number of flipped bits.
        rng: Random generator for files and bits.

    Returns:
        How often the damage was noticed, how often the results were the undisturbed ones, and
        how often the job file was afterwards as before.
    """
    configs = [{"folder": str(folder), "index": i, "fatal": -1, "seed": i} for i in range(3)]
    first = _swept(configs, folder, False)
    paths = sorted((folder / "tiny" / "jobs").glob("*.npz"))
    calls = folder / "calls"
    noticed = right = mended = 0
    for _ in range(count):
        path = paths[rng.integers(len(paths))]
        whole, before = path.read_bytes(), calls.stat().st_size
        bit = int(rng.integers(8 * len(whole)))
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        right += _swept(configs, folder, True) == first
        noticed += calls.stat().st_size == before + 1
        mended += path.read_bytes() == whole
    return noticed, right, mended


def _swept(configs, folder, resume):
    """Return the results of a sweep as plain values."""
    options = RepeatedOptions(out=folder, jobs=1, resume=resume)
    with contextlib.closing(Output("tiny", options)) as output:
        return plain(sweep(tiny.draw, configs, options, output))


def duration(words, out):
    """Return how long an undisturbed run takes [s]."""
    start = time.monotonic()
    assert run(words, out) == 0
    return time.monotonic() - start


def draw(rng, longest):
    """Return a signal, whether all processes get it, and when, for `run`.

    A person's Ctrl-C reaches all processes; a kill reaches one, or all if the machine goes down.
    """
    number = signal.SIGINT if rng.random() < 0.5 else signal.SIGKILL  # noqa: PLR2004
    everyone = number == signal.SIGINT or rng.random() < 0.5  # noqa: PLR2004
    delay = float(rng.uniform(0.0, longest))
    return number, bool(everyone), lambda seconds: seconds >= delay


def finished(folder):
    """Return how many jobs of an experiment's folder are kept."""
    return len(_jobs(folder))


def _jobs(folder):
    """Return time and contents of each job that is kept."""
    paths = (folder / "jobs").glob("*.npz") if (folder / "jobs").exists() else ()
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in paths}
