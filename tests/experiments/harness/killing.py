"""Experiments that are killed, run twice at once or damaged, and what is left of them."""

import contextlib
import dataclasses
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

PATIENCE = 300.0  # [s] for one run


@dataclasses.dataclass(frozen=True)
class Trial:
    """State that one killed run left, and that of its resumption.

    Attributes:
        status: Exit status of the killed run, as `subprocess` reports it.
        finished: Jobs whose results were stored when it died.
        lost: Finished jobs that are gone, damaged or were repeated by the resumed run.
        metrics: metrics.json of the resumed run.
    """

    status: int
    finished: int
    lost: int
    metrics: dict


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
        json.loads((out / name / "metrics.json").read_text())
    resumed = run([*words, "--resume"], out)
    assert resumed == 0, f"the resumed run ended with status {resumed}"
    after_it = _jobs(out / name)
    lost = sum(after_it.get(job) != kept for job, kept in before.items())
    lost += sum(not _readable(data) for _, data in before.values())
    metrics = json.loads((out / name / "metrics.json").read_text())
    return Trial(status, len(before), lost, metrics)


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


def _readable(data):
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        return "result" in json.loads(str(stored["json"]))
