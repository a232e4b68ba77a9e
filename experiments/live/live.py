"""``live``: the twin beside a rover: what it did not expect, and what has changed."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from controllers.sensing.changes import UNKNOWN, Change, ChangeConfig, ChangeDetector
from controllers.sensing.diagnosis import Finding
from experiments.harness.contract import ExperimentError
from experiments.harness.figure_style import use_style
from experiments.harness.recording import recording
from experiments.live.live_options import Options
from models.compose import RobotPlacement
from perception.geometry.arrays import FloatArray
from twin.describe import describe_rover
from twin.logs.log import LogError
from twin.logs.mapping import read_log
from twin.logs.settings import read_settings
from twin.logs.ticks import robots_of, ticks_of
from twin.robot import Command, Observation
from twin.servo import SERVO_PERIOD
from twin.shadow.deviations import Deviation, rover_deviations, shadow_scene
from twin.shadow.readings import CHANNELS
from twin.shadow.shadow import Shadow

KINDS = ("load", "spring", "grip", "drag", "supply", "zero")
"""First words of the deviations, each a panel of the figure."""


@dataclasses.dataclass(frozen=True)
class Block:
    """What the twin found in a block of ticks.

    Attributes:
        time: Robot time at its end [s].
        surprise: (channels,) root mean square of the innovations over their deviations.
        deviations: (k,) deviations from the drawing, as learned and as named.
        sigma: (k,) their standard deviations.
        evidence: Logarithm of how much likelier a change is than none; NaN while learning.
    """

    time: float
    surprise: FloatArray
    deviations: FloatArray
    sigma: FloatArray
    evidence: float


@dataclasses.dataclass(frozen=True)
class Named:
    """A change that was named.

    Attributes:
        time: Robot time at which it was [s].
        finding: Its name and size.
        unit: Unit of the size.
    """

    time: float
    finding: Finding
    unit: str


def run(options: Options) -> int:
    """Run the twin beside a log, and write what it found.

    Raises:
        ExperimentError: If the log cannot be used.
    """
    try:
        log = read_log(options.log)
        robot = options.robot or next(iter(robots_of(log)), "")
        ticks = list(ticks_of(log, robot))
        placed = placement_of(options.log, robot)
        scene = shadow_scene(placed)
    except ValueError as error:
        raise ExperimentError(f"{options.log}: {error}") from None
    drawn = describe_rover(robot, card=placed.card, mast=placed.mast)
    deviations = rover_deviations(drawn)
    twin = Twin(Shadow(scene, drawn, deviations), options.learning)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, transient=True) as progress:
        for seen, applied in progress.track(ticks, description="beside the log"):
            twin.step(seen, applied)
    twin.close()
    if not twin.blocks:
        raise ExperimentError(f"{options.log}: {robot} measured nothing to begin with")
    options.out.mkdir(parents=True, exist_ok=True)
    write_all(twin, deviations, options.out)
    print_found(twin, deviations)
    print(f"next: look at {options.out / 'deviations.png'}, or rerun {options.out / 'live.rrd'}")
    return 0


def placement_of(path: Path, robot: str) -> RobotPlacement:
    """Return what a log says that a rover carries; the log of a real one says nothing."""
    try:
        robots = read_settings(path).robots
    except LogError:
        return RobotPlacement(robot)
    return next((each for each in robots if each.name == robot), RobotPlacement(robot))


class Twin:
    """A shadow, and the detector that its innovations go to.

    Args:
        shadow: The shadow, whose deviations are learned.
        learning: Time for which the robot is only learned [s].

    Attributes:
        blocks: What was found, block by block.
        named: Changes that were named.
    """

    def __init__(self, shadow: Shadow, learning: float) -> None:
        self._shadow = shadow
        config = ChangeConfig()
        ticks = round(learning / SERVO_PERIOD)
        self._config = dataclasses.replace(config, learning=max(1, ticks // config.block))
        self._changes = changes_of(shadow.deviations)
        spreads = np.array([each.spread for each in shadow.deviations])
        self._detector = ChangeDetector(spreads, self._changes, self._config)
        self._applied: Command | None = None
        self._squares: list[FloatArray] = []
        self.blocks: list[Block] = []
        self.named: list[Named] = []

    @property
    def slope(self) -> FloatArray:
        """(2,) of the ground, pitch and roll [rad]."""
        return self._shadow.slope

    def close(self) -> None:
        """End the shadow's threads."""
        self._shadow.close()

    def step(self, seen: Observation, applied: Command) -> None:
        """Take a tick.

        Args:
            seen: What was measured.
            applied: What was applied from then on.
        """
        before, self._applied = self._applied, applied
        innovation = self._shadow.step(seen, before or applied)
        if innovation is None:
            return
        found = self._detector.step(innovation.values, innovation.sigma, innovation.sensitivities)
        self._squares.append(np.square(innovation.values / innovation.sigma))
        if len(self._squares) == self._config.block:
            self._end_block(innovation.time)
        if found is not None:
            self._name(found, innovation.time)

    def _end_block(self, time: float) -> None:
        rows = np.array(self._squares)
        self._squares = []
        places = self._shadow.channels.values()
        surprise = [_rms(rows[:, place]) for place in places]
        detector = self._detector
        self.blocks.append(
            Block(
                time,
                np.array(surprise),
                self._shadow.known + detector.deviations,
                np.sqrt(np.diag(detector.covariance)),
                detector.odds,
            )
        )

    def _name(self, found: Finding, time: float) -> None:
        there = {each.name: each for each in self._changes}
        change = there.get(found.name)
        self.named.append(Named(time, found, change.unit if change else ""))
        if change is None:
            self._detector.reset()
            return
        self._shadow.know(self._shadow.known + change.direction * found.size)
        self._detector.accept(change, found)


def changes_of(deviations: Sequence[Deviation]) -> list[Change]:
    """Return the changes that there may be: of each deviation, and of all motors' supply."""
    rows = np.eye(len(deviations))
    single = [
        Change(each.name, each.unit, row, each.change, each.sign)
        for each, row in zip(deviations, rows)
    ]
    supply = np.array([float(each.name.startswith("supply")) for each in deviations])
    return [*single, Change("battery", "1", supply, 0.3, 1)]


def _rms(squares: FloatArray) -> float:
    there = squares[np.isfinite(squares)]
    return float(np.sqrt(np.mean(there))) if len(there) else float("nan")


def write_all(twin: Twin, deviations: Sequence[Deviation], folder: Path) -> None:
    """Write figures, recording and JSON."""
    use_style()
    blocks = twin.blocks
    times = np.array([each.time for each in blocks])
    _plot_surprise(times, np.array([each.surprise for each in blocks]), folder)
    learned = np.array([each.deviations for each in blocks])
    sigma = np.array([each.sigma for each in blocks])
    _plot_deviations(times, learned, sigma, deviations, twin.named, folder)
    _record(twin, deviations, folder / "live.rrd")
    content = {
        "deviations": {
            each.name: {"value": value, "sigma": deviation, "unit": each.unit}
            for each, value, deviation in zip(deviations, learned[-1].tolist(), sigma[-1].tolist())
        },
        "changes": [
            {"time": each.time, "unit": each.unit, **dataclasses.asdict(each.finding)}
            for each in twin.named
        ],
        "slope": twin.slope.tolist(),
        "innovations_over_sigma": {
            name: value for name, value in zip(CHANNELS, _rms_of(blocks).tolist(), strict=True)
        },
    }
    (folder / "live.json").write_text(json.dumps(content, indent=1) + "\n")


def _rms_of(blocks: Sequence[Block]) -> FloatArray:
    return np.sqrt(np.nanmean(np.square([each.surprise for each in blocks]), axis=0))


def _plot_surprise(times: FloatArray, surprise: FloatArray, folder: Path) -> None:
    figure, axes = plt.subplots(figsize=(8.0, 3.5), layout="constrained")
    for name, values in zip(CHANNELS, surprise.T, strict=True):
        axes.plot(times, values, lw=0.8, label=name.replace("_", " "))
    axes.axhline(1.0, color="0.6", lw=0.8)
    axes.set_yscale("log")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("innovations, r.m.s.\nover what the twin states")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(folder / "innovations.png")
    plt.close(figure)


def _plot_deviations(
    times: FloatArray,
    learned: FloatArray,
    sigma: FloatArray,
    deviations: Sequence[Deviation],
    named: Sequence[Named],
    folder: Path,
) -> None:
    figure, rows = plt.subplots(
        len(KINDS), 1, figsize=(8.0, 1.7 * len(KINDS)), sharex=True, layout="constrained"
    )
    for axes, kind in zip(rows, KINDS, strict=True):
        chosen = [k for k, each in enumerate(deviations) if each.name.split()[0] == kind]
        for k in chosen:
            name = deviations[k].name.removeprefix(f"{kind} ").replace("_", " ")
            (line,) = axes.plot(times, learned[:, k], lw=1.0, label=name)
            half = 1.96 * sigma[:, k]
            axes.fill_between(
                times, learned[:, k] - half, learned[:, k] + half, color=line.get_color(),
                alpha=0.15, lw=0.0,
            )  # fmt: skip
        for each in named:
            axes.axvline(each.time, color="0.4", lw=0.8, ls=":")
        units = {deviations[k].unit for k in chosen}
        axes.set_ylabel(f"{kind} [{', '.join(sorted(units))}]")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="x-small")
    rows[0].set_title("learned deviations from the drawing, with 95 % bands; dotted: named changes")
    rows[-1].set_xlabel("time [s]")
    figure.savefig(folder / "deviations.png")
    plt.close(figure)


def _record(twin: Twin, deviations: Sequence[Deviation], path: Path) -> None:
    """Write what was found as a recording for the rerun viewer."""
    views = [rrb.TimeSeriesView(name="innovations over sigma", contents="/innovations/**")]
    views += [rrb.TimeSeriesView(name=kind, contents=f"/deviations/{kind}/**") for kind in KINDS]
    views += [rrb.TimeSeriesView(name="evidence of a change", contents="/evidence")]
    layout = rrb.Blueprint(rrb.Grid(*views, grid_columns=2), collapse_panels=True)
    blocks = twin.blocks
    times = [rr.TimeColumn("sim_time", duration=[each.time for each in blocks])]
    series = {
        f"innovations/{name}": [float(each.surprise[k]) for each in blocks]
        for k, name in enumerate(CHANNELS)
    }
    for k, deviation in enumerate(deviations):
        kind, _, name = deviation.name.partition(" ")
        series[f"deviations/{kind}/{name}"] = [float(each.deviations[k]) for each in blocks]
    series["evidence"] = [each.evidence for each in blocks]
    with recording(path, layout) as stream:
        for name, values in series.items():
            stream.send_columns(name, indexes=times, columns=rr.Scalars.columns(scalars=values))
        for each in twin.named:
            stream.set_time("sim_time", duration=each.time)
            stream.log("changes", rr.TextLog(_said(each)))


def print_found(twin: Twin, deviations: Sequence[Deviation]) -> None:
    """Print what was learned of the rover, and what changed."""
    last = twin.blocks[-1]
    table = Table(box=None, pad_edge=False)
    for heading in ("deviation", "learned", "sigma", "unit"):
        table.add_column(heading, justify="right" if heading in ("learned", "sigma") else "left")
    for each, value, sigma in zip(deviations, last.deviations.tolist(), last.sigma.tolist()):
        table.add_row(each.name, f"{value:+.3g}", f"{sigma:.2g}", each.unit)
    Console().print(table)
    for named in twin.named:
        print(_said(named))
    if not twin.named:
        print("no change was found")
    pitch, roll = np.degrees(twin.slope)
    print(f"the ground rises by {pitch:+.1f} deg ahead, and falls by {roll:+.1f} deg to the right")


def _said(named: Named) -> str:
    found = named.finding
    if found.name == UNKNOWN:
        return f"{named.time:.1f} s: {UNKNOWN}"
    unit = f" {named.unit}" if named.unit != "1" else ""
    return f"{named.time:.1f} s: {found.name} {found.size:+.3g} +- {1.96 * found.sigma:.2g}{unit}"
