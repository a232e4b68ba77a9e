"""Motions in files: the command of each actuator over time, as a table or as a log."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from experiments.harness.contract import ExperimentError
from perception.geometry.arrays import FloatArray
from twin.logs.fields import read_fields
from twin.logs.log import Field, Log, LogError, Signal
from twin.logs.mapping import read_log
from twin.logs.writing import write_mcap


def write_motion(
    path: Path, names: Sequence[str], stamps: FloatArray, commands: FloatArray
) -> None:
    """Write a motion, as a table or as a log of its actuators.

    Args:
        path: File to write, ``.csv`` or ``.mcap``.
        names: Names of the actuators.
        stamps: (n,) times [s].
        commands: (n, k) commands.

    Raises:
        ExperimentError: If it cannot be written.
    """
    try:
        if path.suffix == ".csv":
            with path.open("w", newline="") as stream:
                writer = csv.writer(stream)
                writer.writerow(["t", *names])
                writer.writerows(np.column_stack([stamps, commands]).tolist())
            return
        signals = {
            name: Signal("actuator", stamps, commands[:, [index]])
            for index, name in enumerate(names)
        }
        write_mcap(Log(signals), path)
    except OSError as error:
        raise ExperimentError(f"{path}: {error.strerror}") from None


def read_motion(path: Path) -> Mapping[str, Field]:
    """Read a motion that `write_motion` or a person wrote.

    Args:
        path: The file: a table with a column of stamps (t) and one for each actuator, or a log.

    Returns:
        Commands of each actuator, by its name.

    Raises:
        ExperimentError: If it cannot be read.
    """
    try:
        if path.suffix == ".csv":
            return read_fields(path)
        return {
            name: Field(each.stamps, each.values[:, 0])
            for name, each in read_log(path).signals.items()
        }
    except LogError as error:
        raise ExperimentError(str(error)) from None
