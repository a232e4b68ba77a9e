"""What a twin beside a rover shows: curves and bodies in a recording, figures, and a table."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import mujoco
import numpy as np
import rerun.blueprint as rrb
from rich.console import Console
from rich.table import Table

from experiments.live.twin_beside import Block, Named, TwinBeside
from models.compose import RobotPlacement, build_scene
from models.configuration import FieldConfig
from perception.geometry.arrays import FloatArray
from twin.logs.ticks import RoverTick
from twin.loop import Tick
from twin.recording.layout import scene_view
from twin.recording.record import Recorder
from twin.shadow.deviations import Deviation
from twin.shadow.readings import CHANNELS

KINDS = ("load", "spring", "grip", "drag", "supply", "zero")
"""First words of the deviations, each a panel of the figure."""
_TWIN = "twin"
_GREEN = np.array([0.2, 0.8, 0.4, 0.35])


class Overlay:
    """A scene with the rover, and its twin where it is, seen through.

    The rover's arm and centre joint are as measured; where it is and how it tilts only the twin
    tells.

    Args:
        placed: The rover.
        twin: Its twin.

    Attributes:
        model: Both of them.
        data: Their poses.
    """

    def __init__(self, placed: RobotPlacement, twin: TwinBeside) -> None:
        shadow = twin.shadow.model
        drawn = RobotPlacement(placed.name, card=placed.card, mast=placed.mast)
        both = [drawn, dataclasses.replace(drawn, name=_TWIN)]
        self.model = build_scene(FieldConfig(texture_pixels=16), both).compile()
        self.data = mujoco.MjData(self.model)
        self._pairs: dict[str, tuple[list[int], list[int]]] = {}
        for name in (placed.name, _TWIN):
            ours: list[int] = []
            theirs: list[int] = []
            for index in range(shadow.njnt):
                joint = shadow.joint(index)
                to = self.model.joint(f"{name}/{joint.name.removeprefix(f'{placed.name}/')}")
                count = len(joint.qpos0)
                ours += range(to.qposadr[0], to.qposadr[0] + count)
                theirs += range(joint.qposadr[0], joint.qposadr[0] + count)
            self._pairs[name] = ours, theirs
        for geom in range(self.model.ngeom):
            body = self.model.body(int(self.model.geom_bodyid[geom])).name
            if body.startswith(f"{_TWIN}/"):
                self.model.geom_matid[geom] = -1
                self.model.geom_rgba[geom] = _GREEN * [1, 1, 1, self.model.geom_rgba[geom, 3] > 0]
        joints = [f"{placed.name}/{name}_joint" for name in twin.drawn.joint_names]
        self._arm = [self.model.joint(name).qposadr[0] for name in joints]
        self._centre = self.model.joint(f"{placed.name}/centre_joint").qposadr[0]

    def put(self, twin: FloatArray, tick: RoverTick) -> None:
        """Put both where they are.

        Args:
            twin: (nq,) places of the twin.
            tick: What was measured of the rover.
        """
        for ours, theirs in self._pairs.values():
            self.data.qpos[ours] = twin[theirs]
        if tick.seen.centre_angle.usable:
            self.data.qpos[self._centre] = tick.seen.centre_angle.value[0]
        if tick.seen.arm_angles.usable:
            self.data.qpos[self._arm] = tick.seen.arm_angles.value
        mujoco.mj_kinematics(self.model, self.data)


class TwinRecording:
    """Recording of a twin and its rover for the rerun viewer, written as they go.

    Args:
        path: File to write, ``.rrd``.
        placed: The rover.
        twin: Its twin.

    Attributes:
        path: The file.

    Raises:
        OSError: If it cannot be written.
    """

    def __init__(self, path: Path, placed: RobotPlacement, twin: TwinBeside) -> None:
        self.path, self._twin, self._step = path, twin, 0
        self._overlay = Overlay(placed, twin)
        self._kinds: dict[str, list[int]] = {}
        for place, each in enumerate(twin.deviations):
            self._kinds.setdefault(each.name.split()[0], []).append(place)
        views = [rrb.TimeSeriesView(name="innovations over sigma", contents="/innovations/**")]
        views += [rrb.TimeSeriesView(name=kind, contents=f"/deviations/{kind}") for kind in KINDS]
        views += [
            rrb.TimeSeriesView(name="evidence of a change", contents="/evidence"),
            rrb.TextLogView(name="changes", contents="/changes"),
        ]
        scene = scene_view("world", "rover, and its twin in green", (1.3, -1.3, 0.9), (0, 0.1, 0.1))
        layout = rrb.Blueprint(
            rrb.Horizontal(scene, rrb.Grid(*views, grid_columns=2)), collapse_panels=True
        )
        self._recorder = Recorder(path, {}, self._overlay, layout)

    def add(self, tick: RoverTick) -> None:
        """Show where rover and twin are."""
        places = self._twin.shadow.places
        if places is None:
            return
        self._overlay.put(places, tick)
        self._step += 1
        self._recorder.record(Tick(self._step, tick.seen.time, {}, {}))

    def add_block(self, block: Block) -> None:
        """Show what a block of ticks told."""
        for name, value in zip(CHANNELS, block.surprise.tolist(), strict=True):
            self._recorder.log_scalars(f"innovations/{name}", value)
        for kind, places in self._kinds.items():
            names = [self._twin.deviations[place].name for place in places]
            self._recorder.log_scalars(f"deviations/{kind}", block.deviations[places], names)
        self._recorder.log_scalars("evidence", block.evidence)

    def add_named(self, named: Named) -> None:
        """Show a change that was named."""
        self._recorder.log_text("changes", str(named))

    def close(self) -> None:
        """Complete the file."""
        self._recorder.close()


def write_report(
    blocks: Sequence[Block],
    named: Sequence[Named],
    twin: TwinBeside,
    folder: Path,
    more: Mapping[str, Any],
) -> None:
    """Write figures and JSON.

    Args:
        blocks: What was found, in order of time; at least one.
        named: Changes that were named.
        twin: The twin.
        folder: Where they are written.
        more: Further entries of the JSON.
    """
    deviations = twin.deviations
    times = np.array([each.time for each in blocks])
    _plot_surprise(times, np.array([each.surprise for each in blocks]), folder)
    learned = np.array([each.deviations for each in blocks])
    sigma = np.array([each.sigma for each in blocks])
    _plot_deviations(times, learned, sigma, deviations, named, folder)
    rms = [_rms(np.array(row)) for row in zip(*(each.surprise for each in blocks), strict=True)]
    nees = twin.foresight.nees
    content = {
        "deviations": {
            each.name: {"value": value, "sigma": deviation, "unit": each.unit}
            for each, value, deviation in zip(deviations, learned[-1].tolist(), sigma[-1].tolist())
        },
        "changes": [
            {"time": each.time, "unit": each.unit, **dataclasses.asdict(each.finding)}
            for each in named
        ],
        "slope": twin.shadow.slope.tolist(),
        "innovations_over_sigma": dict(zip(CHANNELS, rms, strict=True)),
        "prediction_nees": float(np.mean(nees)) if nees else None,
        **more,
    }
    (folder / "live.json").write_text(json.dumps(content, indent=1) + "\n")


def _rms(values: FloatArray) -> float | None:
    """Return the root mean square of a channel; none of one that was never measured."""
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if len(there) else None


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


def print_found(twin: TwinBeside) -> None:
    """Print what was learned of the rover, and what changed."""
    last = twin.blocks[-1]
    table = Table(box=None, pad_edge=False)
    for heading in ("deviation", "learned", "sigma", "unit"):
        table.add_column(heading, justify="right" if heading in ("learned", "sigma") else "left")
    for each, value, sigma in zip(twin.deviations, last.deviations.tolist(), last.sigma.tolist()):
        table.add_row(each.name, f"{value:+.3g}", f"{sigma:.2g}", each.unit)
    Console().print(table)
    for named in twin.named:
        print(named)
    if not twin.named:
        print("no change was found")
    pitch, roll = np.degrees(twin.shadow.slope)
    print(f"the ground rises by {pitch:+.1f} deg ahead, and falls by {roll:+.1f} deg to the right")
