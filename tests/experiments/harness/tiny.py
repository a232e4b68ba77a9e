"""A tiny experiment, given to the command line by the tests; `python -m` runs it."""

import dataclasses
import importlib
import os
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.__main__ import main
from experiments.harness.catalogue import Experiment
from experiments.harness.contract import ExperimentError, OptionError
from experiments.harness.intervals import distribution
from experiments.harness.sweep import sweep


@dataclasses.dataclass(frozen=True)
class Draw:
    """What a tiny job returns."""

    numbers: np.ndarray
    sum: float
    never: float
    pair: tuple[int, int]
    nothing: str | None
    parts: tuple["Part", ...]


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of what a tiny job returns."""

    label: str
    rows: dict[str, np.ndarray]


def draw(config) -> Draw:
    """Count the call, then draw; the job of the fatal seed fails while its switch is there."""
    folder = Path(config["folder"])
    with (folder / "calls").open("a") as stream:
        stream.write("x")
    if config["index"] == config["fatal"] and (folder / "fatal").exists():
        raise ValueError("the job is broken")
    numbers = np.random.default_rng(config["seed"]).normal(size=(2, 3))
    parts = tuple(Part(f"row {index}", {"row": row}) for index, row in enumerate(numbers))
    return Draw(numbers, numbers.sum(), float("inf"), (1, 2), None, parts)


def wait_and_draw(config) -> float:
    """Take a while, then draw."""
    time.sleep(config["seconds"])
    return float(np.random.default_rng(config["seed"]).normal())


def run(options, output):
    if options.fault == "error":
        raise ExperimentError("the wheel fell off")
    if options.fault == "bug":
        raise KeyError("wheel")
    if options.fault == "file":
        raise OptionError("--truth x.json: no such file")
    if options.fault == "interrupt":
        raise KeyboardInterrupt
    samples = np.random.default_rng(options.seed).normal(size=options.seeds or 8)
    output.measure("error_percent", distribution(samples), thesis=18.9)
    output.measure("plan_ms", np.float64(3.5))
    output.measure("method", "ours & <theirs>")
    output.check("error is small", 12.5, "<= 1", False)
    output.check("plan is quick", 3.5, "<= 75", True)
    if options.sweep:
        output.measure("swept", _swept(options, output))
    figure = Figure()
    figure.add_subplot().plot([1, 2])
    output.figure("figure_2-4", figure)
    output.table("table_2-1", ["mass [kg]", "error [%]"], [[1.0, 2], [options.mass, 3]])
    output.file(f"only_of_seed_{options.seed}.txt").write_text("x")
    if options.record:
        _record(output.file("run.rrd"))


def _record(path):
    """Record two words; imported here because it takes a second."""
    recorder = importlib.import_module("twin.recording.record").Recorder(path)
    with recorder:
        for word in ("first", "last"):
            recorder.log_text("words", word)
            recorder.flush()


def _swept(options, output):
    """Return the draws of a sweep."""
    configs = [
        {"seed": seed, "seconds": 0.1} for seed in options.job_seeds(options.sweep, options.sweep)
    ]
    return sweep(wait_and_draw, configs, options, output)


CATALOGUE = {
    "tiny": Experiment(
        name="tiny",
        summary="a tiny experiment",
        thesis="Table 0",
        module="tests.experiments.harness.tiny",
        example="--mass 2 --seeds 5",
        full="ten minutes",
    ),
    "silent": Experiment(
        name="silent",
        summary="one without sweep and recording",
        thesis="Table 0",
        module="tests.experiments.harness.tiny",
        example="--seed 1",
        options="tests.experiments.harness.silent_options",
    ),
}

if __name__ == "__main__":
    os.environ["COLUMNS"] = "100"
    sys.exit(main(experiments=CATALOGUE))
