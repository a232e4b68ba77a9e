"""Which tests need the machine for themselves, which workers take first, and what they keep.

``--seed-shift N`` adds N to every seed that a test or the code under test gives to NumPy: what is
random takes another course, as it would on another processor, and every test must hold on it too.
"""

import collections
import json
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

from experiments.harness.catalogue import EXPERIMENTS

HARDWARE = Path(__file__).parent / "twin" / "hardware"


def pytest_configure(config):
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # A shell lets what it starts in the background ignore Ctrl+C, and that is inherited.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.addinivalue_line(
        "markers", "virtual_time: of hardware, but waits for no clock: runs beside other tests"
    )
    config.addinivalue_line(
        "markers", "chosen_seed: its seed picks a case by what it shows; --seed-shift leaves it"
    )
    if config.getoption("--seed-shift"):
        config.pluginmanager.register(SeedShift(config.getoption("--seed-shift")))


class SeedShift:
    """Adds a number to every seed of NumPy's generators, but for tests of a chosen seed."""

    def __init__(self, shift):
        self._shift = self._added = shift
        default_rng, shifted = np.random.default_rng, self._shifted

        class ShiftedSequence(np.random.SeedSequence):
            def __init__(self, entropy=None, *, spawn_key=(), **kwargs):
                # Children come with the entropy of their parent, which is shifted already.
                entropy = entropy if spawn_key else shifted(entropy)
                super().__init__(entropy, spawn_key=spawn_key, **kwargs)

        np.random.SeedSequence = ShiftedSequence
        np.random.default_rng = lambda seed=None: default_rng(shifted(seed))

    def _shifted(self, seed):
        if isinstance(seed, int | np.integer):
            return int(seed) + self._added
        if isinstance(seed, tuple | list):
            return [seed[0] + self._added, *seed[1:]]
        return seed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item):
        self._added = 0 if item.get_closest_marker("chosen_seed") else self._shift


def pytest_addoption(parser):
    parser.addoption(
        "--real-time",
        choices=("only", "skip"),
        help="run only, or leave out, tests that time something or wait for a clock",
    )
    parser.addoption(
        "--seed-shift", type=int, default=0, metavar="N", help="add N to every seed of NumPy"
    )
    parser.addoption(
        "--keep-results", metavar="DIR", help="keep there what experiments write in quick runs"
    )


def pytest_runtest_teardown(item):
    wanted, written = item.config.getoption("--keep-results"), item.funcargs.get("tmp_path")
    if wanted is None or written is None:
        return
    for path in written.glob("**/metrics.json"):
        _keep(path.parent, Path(wanted))


def _keep(folder, wanted):
    """Copy the folder of a quick run of an experiment of the catalogue."""
    if folder.name not in EXPERIMENTS:
        return
    config = json.loads((folder / "config.json").read_text())
    # Tests of the report put other results under these names.
    if config["quick"] and config["experiment"] == folder.name:
        shutil.rmtree(wanted / folder.name, ignore_errors=True)
        shutil.copytree(
            folder, wanted / folder.name, ignore=shutil.ignore_patterns("jobs", "*.rrd")
        )


def pytest_collection_modifyitems(config, items):
    for item in items:
        # Boards answer from another process, within deadlines of milliseconds.
        if HARDWARE in item.path.parents and item.get_closest_marker("virtual_time") is None:
            item.add_marker(pytest.mark.real_time)
    if hasattr(config, "workerinput"):
        _put_slow_files_first(items)
    wanted = config.getoption("--real-time")
    if wanted is None:
        return
    chosen, left_out = [], []
    for item in items:
        real_time = item.get_closest_marker("real_time") is not None
        (chosen if real_time == (wanted == "only") else left_out).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = chosen


def _put_slow_files_first(items):
    """Let no worker begin a long file when the others are about to end, nor two the same folder.

    Files of one folder need the same kernels, which workers that run side by side compile twice:
    of each folder comes the first slow file, then of each the second, and so on.
    """
    slow = dict.fromkeys(item.path for item in items if item.get_closest_marker("slow") is not None)
    before, number = collections.Counter(), {}
    for path in slow:
        number[path] = before[path.parent]
        before[path.parent] += 1
    items.sort(key=lambda item: number.get(item.path, len(slow)))
