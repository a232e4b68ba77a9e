"""The result of a run on the terminal."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from experiments.harness.catalogue import Experiment
from experiments.harness.command_line import program
from experiments.harness.output import Output


def format_number(value: Any) -> str:
    """Return a metric as short text, with four significant digits."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(format_number(item) for item in value)
    return str(value)


def format_metric(value: Any) -> tuple[str, str]:
    """Return a metric's centre and its interval as text; the interval may be empty."""
    if isinstance(value, dict) and "median" in value:
        interval = f"{format_number(value.get('low'))} .. {format_number(value.get('high'))}"
        return format_number(value["median"]), interval
    return format_number(value), ""


def print_summary(experiment: Experiment, output: Output) -> None:
    """Print measured values beside the thesis', the checks, and where the files are.

    Where the thesis has figures for some quantities, only those are printed.
    """
    metrics = output.metrics()
    console = Console()
    table = Table(title=f"{experiment.name}: {experiment.thesis}", title_justify="left")
    for heading in ("quantity", "thesis", "ours", "95 % interval"):
        table.add_column(heading, justify="left" if heading == "quantity" else "right")
    for key in metrics["thesis"] or metrics["measured"]:
        centre, interval = format_metric(metrics["measured"][key])
        table.add_row(key, format_metric(metrics["thesis"].get(key))[0], centre, interval)
    if table.row_count:
        console.print(table)
    for check in metrics["checks"]:
        mark = "[green]ok[/]  " if check["ok"] else "[red]short[/]"
        # A name may have a unit in brackets, which rich would take for its own marks.
        line = escape(f"{check['name']}: {format_number(check['value'])} (bound {check['bound']})")
        console.print(f"{mark} {line}")
    for path in sorted(output.directory.rglob("*")):
        if path.is_file() and path.name != ".lock" and "jobs" not in path.parts:
            console.print(str(path), highlight=False, soft_wrap=True)
    for line in _next(output.directory):
        console.print(line, highlight=False, soft_wrap=True)


def _next(directory: Path) -> Iterator[str]:
    """Yield what to do with the results of a run."""
    recording = directory / "run.rrd"
    if recording.exists():
        yield f"next: rerun {recording} shows the recording"
    first = min((directory / "figures").glob("*.png"), default=None)
    page = f"{program()} report --out {directory.parent}"
    yield f"next: {f'look at {first}, or ' if first else ''}{page} shows all results on one page"
