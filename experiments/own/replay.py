"""``replay``: the commands of a log once more, in simulation, beside what was measured."""

import csv
import dataclasses
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from controllers.identification.any_model.fit import FitError
from controllers.motion.playback import Playback
from experiments.harness.contract import ExperimentError
from experiments.harness.figure_style import use_style
from experiments.harness.recording import recording
from experiments.own.curves import SHOWN, Panel, plot_panels
from experiments.own.identification import load_model, predicted
from experiments.own.identify import read_logs
from experiments.own.replay_options import Options
from perception.geometry.arrays import FloatArray
from twin.connect import connect
from twin.logs.log import Log, LogError
from twin.logs.mapping import read_log
from twin.logs.settings import read_settings
from twin.logs.writing import LogWriter
from twin.loop import run as run_loop
from twin.prediction.parameters import ModelError
from twin.robot import applied_command


@dataclasses.dataclass(frozen=True)
class Curve:
    """One number of a signal, measured and simulated.

    Attributes:
        name: Its name.
        stamps: (n,) times [s].
        measured: (n,) samples.
        simulated: (n,) samples.
    """

    name: str
    stamps: FloatArray
    measured: FloatArray
    simulated: FloatArray

    @property
    def rms(self) -> float:
        """Root mean square of the difference."""
        return float(np.sqrt(np.nanmean((self.measured - self.simulated) ** 2)))

    @property
    def largest(self) -> float:
        """Largest difference."""
        return float(np.nanmax(np.abs(self.measured - self.simulated)))

    @property
    def bits(self) -> int:
        """Number of bits that differ; a NaN is as good as another."""
        both = np.isnan(self.measured) & np.isnan(self.simulated)
        words = [
            np.where(both, 0.0, each).view(np.uint64) for each in (self.measured, self.simulated)
        ]
        return int(np.bitwise_count(words[0] ^ words[1]).sum())


def run(options: Options) -> int:
    """Replay a log, and write and print how far the simulation is from it.

    Raises:
        ExperimentError: If the log or the model cannot be used.
    """
    try:
        if options.model is None:
            curves = replay_own(options.log)
        else:
            curves = replay_model(options)
    except (LogError, ModelError, FitError) as error:
        raise ExperimentError(str(error)) from None
    write_all(curves, options.out)
    print_curves(curves)
    print(f"next: look at {options.out / 'replay.png'}, or rerun {options.out / 'replay.rrd'}")
    return 0


def replay_own(path: Path) -> list[Curve]:
    """Replay a log of simulated or emulated robots of ours as they were connected.

    Args:
        path: File that `LogWriter` wrote.

    Returns:
        What was measured then and now.

    Raises:
        LogError: If it does not say how they were connected, or breaks off between two robots.
    """
    settings = read_settings(path)
    log = read_log(path)
    names = [robot.name for robot in settings.robots]
    rows = [(log.signals.get(f"{name}/wheels"), log.signals.get(f"{name}/arm")) for name in names]
    commands = {
        name: [applied_command(*each) for each in zip(wheels.values, arm.values)]
        for name, (wheels, arm) in zip(names, rows)
        if wheels is not None and arm is not None
    }
    if len(commands) < len(names):
        raise LogError(f"{path}: no commands of {', '.join(set(names) - set(commands))}")
    try:
        playback = Playback(commands)
    except ValueError as error:
        raise LogError(f"{path}: {error}") from None
    ticks = len(commands[names[0]])
    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder) / "again.mcap"
        with (
            connect(
                settings.target,
                robots=settings.robots,
                field=settings.field,
                realism=settings.realism,
                stereo=settings.stereo,
                seed=settings.seed,
            ) as connection,
            LogWriter(again) as writer,
        ):
            duration = ticks * connection.clock.period
            run_loop(connection.robots, [playback], connection.clock, [writer], duration)
        return _compared(path, log, read_log(again))


def _compared(path: Path, then: Log, now: Log) -> list[Curve]:
    curves: list[Curve] = []
    for name, signal in then.signals.items():
        other = now.signals.get(name)
        if other is None or signal.values.shape != other.values.shape:
            raise LogError(f"{path}: {name} was sampled otherwise; is this the version that ran?")
        count = signal.values.shape[1]
        for column in range(count):
            label = name + (f"[{column}]" if count > 1 else "")
            values = signal.values[:, column].copy(), other.values[:, column].copy()
            curves.append(Curve(label, signal.stamps, *values))
    return curves


def replay_model(options: Options) -> list[Curve]:
    """Drive a model by the commands of a log.

    Raises:
        ModelError: If the model cannot be read.
        LogError: If the log cannot be read, or does not fit the model.
        FitError: If the model diverges.
    """
    assert options.model is not None
    spec = load_model(options.model)
    spec.option.timestep = min(spec.option.timestep, options.step)
    logs = read_logs([options.log], options.mapping, anyway=True)
    found = predicted(spec, logs, options.start)
    return [
        Curve(
            channel,
            found.predictor.stamps(number, channel),
            found.predictor.measured[place],
            found.tuned[place],
        )
        for (number, channel), place in found.predictor.channels.items()
    ]


def write_all(curves: Sequence[Curve], folder: Path) -> None:
    """Write curves as a figure, a table, a recording and JSON."""
    use_style()
    folder.mkdir(parents=True, exist_ok=True)
    rows = [(each.name, len(each.stamps), each.rms, each.largest, each.bits) for each in curves]
    heads = ("name", "samples", "rms", "largest", "bits_different")
    with (folder / "replay.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([heads, *rows])
    found = [dict(zip(heads, row)) for row in rows]
    (folder / "replay.json").write_text(json.dumps(found, indent=1) + "\n")
    panels = [
        Panel(
            each.name,
            each.stamps,
            {"measured": each.measured, "simulated": each.simulated},
            each.measured - each.simulated,
        )
        for each in curves
    ]
    plot_panels(panels, "measured less simulated [SI]", folder / "replay.png")
    record(curves, folder / "replay.rrd")


def record(curves: Sequence[Curve], path: Path) -> None:
    """Write curves as a recording, a view for each with its difference beside it."""
    views = [
        view
        for curve in curves[:SHOWN]
        for view in (
            rrb.TimeSeriesView(
                name=curve.name,
                contents=[f"/measured/{curve.name}", f"/simulated/{curve.name}"],
            ),
            rrb.TimeSeriesView(name=f"{curve.name}, error", contents=[f"/error/{curve.name}"]),
        )
    ]
    layout = rrb.Blueprint(rrb.Grid(*views, grid_columns=2), collapse_panels=True)
    with recording(path, layout) as stream:
        for curve in curves:
            error = curve.measured - curve.simulated
            series = (
                ("measured", curve.measured),
                ("simulated", curve.simulated),
                ("error", error),
            )
            for kind, values in series:
                stream.send_columns(
                    f"{kind}/{curve.name}",
                    indexes=[rr.TimeColumn("sim_time", duration=curve.stamps)],
                    columns=rr.Scalars.columns(scalars=values),
                )


def print_curves(curves: Sequence[Curve]) -> None:
    """Print how far each curve is from what was measured."""
    table = Table(box=None, pad_edge=False)
    for heading in ("signal", "samples", "rms [SI]", "largest [SI]", "bits different"):
        table.add_column(heading, justify="left" if heading == "signal" else "right")
    for each in curves:
        rms, largest = f"{each.rms:.3g}", f"{each.largest:.3g}"
        table.add_row(escape(each.name), str(len(each.stamps)), rms, largest, str(each.bits))
    Console().print(table)
    if not sum(each.bits for each in curves):
        print("the same to the bit")
