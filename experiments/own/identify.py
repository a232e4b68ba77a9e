"""``identify``: the parameters of any MuJoCo model, from logs of its robot."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from controllers.identification.any_model.fit import FitError, Told
from experiments.harness.contract import ExperimentError
from experiments.own.identification import Estimate, Identified, identify, load_model
from experiments.own.identify_options import Options
from experiments.own.pages import write_all
from twin.logs.checks import problems
from twin.logs.log import Log, LogError
from twin.logs.mapping import read_log, read_mapping
from twin.prediction.parameters import ModelError, catalogue, explicit

DOUBTED = 1
"""Exit status of an identification that is not called good."""


def run(options: Options) -> int:
    """Identify parameters of a model, and write and print what was found.

    Args:
        options: The model, its logs and parameters.

    Returns:
        0, or 1 if the result is not called good.

    Raises:
        ExperimentError: If the model, a log or the mapping cannot be used.
    """
    try:
        spec = load_model(options.model)
        if not options.parameters:
            list_parameters(options.model)
            return 0
        logs = read_logs(options.log, options.mapping, options.anyway)
        held_out = read_logs(options.hold_out, options.mapping, options.anyway)
        shown = Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        with shown as progress:
            task = progress.add_task("what can the logs tell?")

            def watch(step: int, chi_square: float) -> None:
                progress.update(task, description=f"step {step}, chi^2 per sample {chi_square:.4g}")

            found = identify(
                spec,
                logs,
                options.parameters,
                held_out,
                options.start,
                options.step,
                watch,
                print_told,
            )
    except (LogError, ModelError, FitError) as error:
        raise ExperimentError(str(error)) from None
    print_estimates(found.estimates)
    page = write_all(found, options.out)
    verdict(found)
    print(f"next: look at {page}, and at {options.out / 'model.xml'} with view")
    if found.after.unknown:
        known = options.out / "identified.json"
        print(f"or: excite --known {known}, for a motion that tells what this one did not")
    return DOUBTED if found.doubts else 0


def read_logs(paths: Sequence[Path], mapping: Path | None, anyway: bool) -> list[Log]:
    """Read logs, and say what is wrong with them.

    Raises:
        ExperimentError: If something is, unless it is to go on anyway.
        LogError: If one cannot be read.
    """
    known = None if mapping is None else read_mapping(mapping)
    logs = [read_log(path, known) for path in paths]
    found = [f"{path}: {line}" for path, log in zip(paths, logs) for line in problems(log)]
    for line in found:
        Console().print(f"[red]wrong[/] {escape(line)}", soft_wrap=True, highlight=False)
    if found and not anyway:
        raise ExperimentError(
            f"{len(found)} things are wrong with the logs; --anyway fits them as they are"
        )
    return logs


def list_parameters(path: Path) -> None:
    """Print the parameters of a model; those of sensors depend on the log."""
    table = Table("parameter", "as drawn", "unit", "may well be off by")
    for each in catalogue(explicit(load_model(path)), {"SENSOR": 1}):
        spread = f"{each.spread:.3g}" if each.spread else "to be said"
        share = f"{100.0 * each.spread:.0f} %" if each.scale == "factor" else spread
        table.add_row(escape(each.name), f"{each.nominal:.5g}", each.unit, share)
    Console().print(table)
    print("next: name some of these (--parameters), and logs (--log)")


def print_told(before: Told) -> None:
    """Print what the logs cannot tell, before anything is fitted."""
    console = Console()
    for name in before.unknown:
        console.print(f"[yellow]not told[/] {escape(name)}", soft_wrap=True, highlight=False)
    for each in before.combinations:
        if len(each) > 1:
            text = " ".join(f"{weight:+.2f} {name}" for name, weight in each.items())
            console.print(f"[yellow]not told[/] {escape(text)}", soft_wrap=True, highlight=False)


def print_estimates(estimates: Sequence[Estimate]) -> None:
    """Print the parameters with their 95 % bands."""
    table = Table(box=None, pad_edge=False)
    table.add_column("parameter", overflow="fold")
    for heading in ("drawn", "fitted", "95 % band"):
        table.add_column(heading, no_wrap=True, justify="right")
    table.add_column("unit")
    table.add_column("bits", no_wrap=True)
    for each in estimates:
        table.add_row(
            escape(each.name),
            f"{each.drawn:.5g}",
            f"{each.value:.5g}",
            f"{each.low:.4g} to {each.high:.4g}",
            each.unit,
            f"{each.bits:.1f}" if each.told else "[yellow]not told[/]",
        )
    Console().print(table)


def verdict(found: Identified) -> None:
    """Print whether the result is good, and what speaks against it."""
    console = Console()
    if found.unseen is not None:
        print(f"unseen runs: error above the noise {found.unseen.ratio:.3g} of that as drawn")
    if not found.doubts:
        console.print("[green]good[/]: converged, explains the logs, confirmed on unseen runs")
    for each in found.doubts:
        console.print(f"[red]not good[/] {escape(each)}", soft_wrap=True, highlight=False)
