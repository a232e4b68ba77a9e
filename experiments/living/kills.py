"""A rover that `live` owns and a person drives, while the program is killed again and again."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from websockets.sync.client import connect
from websockets.typing import Origin

from experiments.harness.contract import ExperimentError
from experiments.living.trial import ROBOT
from twin.logs.mapping import read_log

LATEST, EARLIEST = 8.0, 0.5
"""A kill comes within these times of the rover's after it was activated, at random [s]."""
WATCHED = 1.0
"""Time of the rover for which nobody asks for anything after a start [s]."""
_LEARNING = 6.0  # Time for which the twin only learns: some kills come before it is over [s].
_PATIENCE = 120.0  # Wall time within which a page tells what is waited for [s].
_STILL = 0.3  # Wheel speed below which a rover stands, with the tachometers' noise [rad/s].


class Killed(NamedTuple):
    """What became of a kill.

    Attributes:
        lost: Time from the last sample of the log to what the page was told last [s]; below 0 where
            the log has more.
        back: Wall time from the next start until its page shows rover and history [s].
        moved: Whether the rover was active or moved after that, though nobody asked for it.
    """

    lost: float
    back: float
    moved: bool


class Person:
    """At the page of a rover that `live` owns, by the page's own stream.

    Args:
        url: Address of the page.
    """

    def __init__(self, url: str) -> None:
        address = url.removeprefix("http://").rstrip("/")
        origin = Origin(f"http://{address}")
        self._open = ExitStack()
        stream = connect(f"ws://{address}/stream", origin=origin, max_size=None)
        self._stream = self._open.enter_context(stream)

    def __enter__(self) -> "Person":
        """Return this person."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the page."""
        self._open.close()

    def about(self) -> dict[str, Any]:
        """Return what the page is told next."""
        while True:
            told = self._stream.recv(timeout=_PATIENCE)
            if isinstance(told, str):
                return json.loads(told)

    def ask(self, **told: object) -> None:
        """Tell the rover what is asked for."""
        self._stream.send(json.dumps(told))

    def until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait for what the page is to tell, and return it.

        Raises:
            ExperimentError: If it does not come.
        """
        end = time.monotonic() + _PATIENCE
        while not condition(about := self.about()):
            if time.monotonic() > end:
                raise ExperimentError(f"after {_PATIENCE:g} s the page still tells {about}")
        return about

    def drive(self, seconds: float) -> dict[str, Any]:
        """Drive ahead and move the arm for some of the rover's time; return what is told then."""
        begin = self.about()["time"]
        while (about := self.about())["time"] < begin + seconds:
            turn = float(np.sign(np.sin(3.0 * about["time"])))
            self.ask(drive=[0.8, 0.0], arm=[turn] * 4)
        return about


def kill_often(seed: int, kills: int) -> Iterator[Killed]:
    """Own a simulated rover, drive it, and kill the program, a number of times.

    Args:
        seed: Random seed of the times and of the rover.
        kills: How often.

    Yields:
        What became of each kill.

    Raises:
        ExperimentError: If a page does not come, or does not tell what it should.
    """
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        last = float("nan")
        for run in range(kills + 1):
            begun = time.monotonic()
            with _live(Path(folder), seed) as (process, person):
                about = person.about()
                back = time.monotonic() - begun
                end = about["time"] + WATCHED
                moved = _moves(about)
                while about["time"] < end:
                    about = person.about()
                    moved = moved or _moves(about)
                if run:
                    log = read_log(Path(folder) / f"run-{run:03d}.mcap")
                    lost = last - float(log.signals[f"{ROBOT}/gyro"].stamps[-1])
                    yield Killed(lost, back, moved)
                if run == kills:
                    process.send_signal(signal.SIGINT)
                    process.wait(_PATIENCE)
                    return
                person.ask(activate=True)
                person.until(lambda about: about["lifecycle"] == "active")
                last = float(person.drive(float(rng.uniform(EARLIEST, LATEST)))["time"])


@contextmanager
def _live(folder: Path, seed: int) -> Iterator[tuple[subprocess.Popen[str], Person]]:
    """Yield the process of a program that owns a rover, and a person at its page; it is killed."""
    words = ["live", "--robot", "sim", "--learning", f"{_LEARNING:g}", "--seed", str(seed)]
    command = [sys.executable, "-m", "experiments", *words, "--out", str(folder)]
    # Python's own tracker of shared memory outlives a kill, and warns that it has to clean up.
    quiet = {**os.environ, "PYTHONWARNINGS": "ignore:resource_tracker"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=quiet) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            page = re.search(r"http://\S+/", line)
            if page is None:
                raise ExperimentError(f"live began with {line.strip()!r}, and no page")
            with Person(page.group()) as person:
                yield process, person
        finally:
            process.kill()


def _moves(about: dict[str, Any]) -> bool:
    """Return whether the rover is active, or its wheels turn."""
    (speeds,) = (each["values"] for each in about["sensors"] if each["name"] == "wheel_speeds")
    return about["active"] or about["lifecycle"] == "active" or max(map(abs, speeds)) > _STILL
