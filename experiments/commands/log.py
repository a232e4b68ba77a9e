"""``log``: what a log holds, and what is wrong with it, before anything is fitted to it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from experiments.commands.log_options import Options
from experiments.harness.contract import ExperimentError
from perception.geometry.arrays import FloatArray
from twin.logs.checks import problems
from twin.logs.fields import read_fields
from twin.logs.lerobot import write_lerobot
from twin.logs.log import Field, Log, LogError
from twin.logs.mapping import own_sources, read_log, read_mapping
from twin.logs.mending import mend
from twin.logs.writing import write_mcap

BAD = 1
"""Exit status of a log with which something is wrong."""


def run(options: Options) -> int:
    """Print the signals of a log and what is wrong with them; or its fields, without a mapping.

    Args:
        options: The log, and its mapping.

    Returns:
        0, or 1 if something is wrong with a signal.

    Raises:
        ExperimentError: If the log or the mapping cannot be read, or nothing be written.
    """
    try:
        if options.mend:
            print_mended(options.path)
        if options.mapping is None:
            fields = read_fields(options.path)
            if not own_sources(fields):
                print_fields(fields)
                if options.write is not None:
                    raise ExperimentError("--write: a mapping has to say what is to be written")
                return 0
        mapping = None if options.mapping is None else read_mapping(options.mapping)
        log = read_log(options.path, mapping)
    except LogError as error:
        raise ExperimentError(str(error)) from None
    print_signals(log)
    if options.write is not None:
        write(log, options.write, options.rate)
    found = problems(log)
    for line in found:
        Console().print(f"[red]wrong[/] {escape(line)}", soft_wrap=True, highlight=False)
    return BAD if found else 0


def print_mended(path: Path) -> None:
    """Complete a log whose writer was ended, and print as far as which time it goes.

    Raises:
        LogError: If it is no MCAP file.
        ExperimentError: If it cannot be read or written.
    """
    try:
        latest = mend(path)
    except OSError as error:
        raise ExperimentError(f"{path}: {error.strerror}") from None
    print("complete, nothing to mend" if np.isnan(latest) else f"mended, up to {latest:.2f} s")


def write(log: Log, path: Path, rate: int | None) -> None:
    """Write a log as an MCAP file, or as a LeRobot dataset if it is to have a rate [Hz].

    Raises:
        ExperimentError: If it cannot be written.
    """
    try:
        if rate is None:
            write_mcap(log, path)
        else:
            write_lerobot(log, path, rate)
    except (LogError, OSError) as error:
        raise ExperimentError(f"{path}: {error}") from None
    print(f"wrote {path}")


def print_fields(fields: Mapping[str, Field]) -> None:
    """Print the fields of a log whose meaning is not known, so that a mapping can be written."""
    table = Table("field", "samples", "rate", "from", "to")
    for name, field in sorted(fields.items()):
        low, high = _range(field.values)
        table.add_row(escape(name), *_sampling(field.stamps), low, high)
    Console().print(table)
    print("next: say in a mapping which of these is which actuator or sensor (--mapping FILE)")


def print_signals(log: Log) -> None:
    """Print the signals of a log, by actuator and sensor."""
    table = Table("", "signal", "numbers", "unit", "frame", "samples", "rate", "from", "to")
    for name, each in sorted(log.signals.items(), key=lambda item: (item[1].role, item[0])):
        count = str(each.values.shape[1])
        sampling, ends = _sampling(each.stamps), _range(each.values)
        table.add_row(each.role, escape(name), count, each.unit, each.frame, *sampling, *ends)
    Console().print(table)


def _sampling(stamps: FloatArray) -> tuple[str, str]:
    """Return the number of samples, and how many come in a second."""
    periods = np.diff(stamps)
    periods = periods[periods > 0.0]
    rate = f"{1.0 / np.median(periods):.4g} Hz" if len(periods) else "-"
    return str(len(stamps)), rate


def _range(values: FloatArray) -> tuple[str, str]:
    good = values[np.isfinite(values)]
    return (f"{good.min():.4g}", f"{good.max():.4g}") if good.size else ("-", "-")
