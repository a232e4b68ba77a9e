"""One run in several formats of logs, and whether the same parameters are found in each."""

import csv
import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from experiments.own.hidden.hidden_robots import KINDS, drawn_coordinates, logged
from experiments.own.hidden.motions import fitted, series_of
from experiments.own.identification import identify
from perception.geometry.arrays import FloatArray
from twin.logs.lerobot import at_one_rate, labels, write_lerobot
from twin.logs.log import Log
from twin.logs.mapping import read_log, read_mapping
from twin.logs.writing import write_mcap

RATE = 500
"""Frames a second of the run that is compared, one for each command."""


@dataclasses.dataclass(frozen=True)
class FormatTrial:
    """A run to compare.

    Attributes:
        kind: Kind of robot.
        duration: Duration of its motion [s].
        seed: Random seed of robot, sensors and motion.
    """

    kind: str
    duration: float
    seed: int


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How far parameters are from those by MCAP, the largest share.

    Attributes:
        csv: Those by CSV.
        lerobot: Those by a LeRobot dataset.
    """

    csv: float
    lerobot: float


def compared(trial: FormatTrial) -> Agreement:
    """Identify a robot from one run in each format."""
    kind = KINDS[trial.kind]
    generator = np.random.default_rng(trial.seed)
    series = series_of(kind, trial.duration)
    motion = fitted(kind, series, series.random(generator))
    log = at_one_rate(logged(kind, drawn_coordinates(kind, generator), motion, generator), RATE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_mcap(log, folder / "run.mcap")
        write_lerobot(log, folder / "run", RATE)
        (folder / "csv.toml").write_text(write_csv(log, folder / "run.csv"))
        (folder / "lerobot.toml").write_text(_lerobot_mapping(log))
        logs = [
            read_log(folder / "run.mcap"),
            read_log(folder / "run.csv", read_mapping(folder / "csv.toml")),
            read_log(folder / "run", read_mapping(folder / "lerobot.toml")),
        ]
    mcap, *others = [_values(kind.parameters, trial.kind, each) for each in logs]
    return Agreement(*(float(np.abs(each / mcap - 1.0).max()) for each in others))


def _values(parameters: tuple[str, ...], kind: str, log: Log) -> FloatArray:
    found = identify(KINDS[kind].spec(), [log], parameters)
    found.seen.predictor.close()
    return np.array([each.value for each in found.estimates])


def write_csv(log: Log, path: Path) -> str:
    """Write a log of one rate as a table, and return the mapping that reads it."""
    columns: dict[str, FloatArray] = {}
    lines: list[str] = []
    for name, each in log.signals.items():
        fields = labels(name, each)
        columns |= dict(zip(fields, each.values.T))
        lines += [f'[{each.role}s."{name}"]', f"fields = {fields}"]
    stamps = next(iter(log.signals.values())).stamps
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["t", *columns])
        writer.writerows(np.column_stack([stamps, *columns.values()]).tolist())
    return "\n".join(lines) + "\n"


def _lerobot_mapping(log: Log) -> str:
    lines: list[str] = []
    for role, feature in (("actuator", "action"), ("sensor", "observation.state")):
        chosen = {name: each for name, each in log.signals.items() if each.role == role}
        alone = sum(each.values.shape[1] for each in chosen.values()) == 1
        for name, each in chosen.items():
            fields = [feature if alone else f"{feature}[{label}]" for label in labels(name, each)]
            lines += [f'[{role}s."{name}"]', f"fields = {fields}"]
    return "\n".join(lines) + "\n"
