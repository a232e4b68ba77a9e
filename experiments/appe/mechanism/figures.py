"""Figures of ``appe-mechanism``: states, arms, a leg that switches, and sag."""

from collections.abc import Sequence

import mujoco
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from controllers.braid.arm.stage import STATES
from experiments.appe.mechanism.bench import BraidBench, make_bench
from experiments.appe.mechanism.trial import SagRun, SagTrial
from models.braid.build import BraidConfig
from models.datasheets import BRAID, MUSCLE_WIRE
from perception.geometry.arrays import FloatArray, IntArray

Image = NDArray[np.uint8]

ARMS = ((0, 0, 0, 0, 0), (7, 7, 7, 7, 7), (1, 1, 1, 1, 1), (6, 6, 1, 1, 6), (2, 4, 3, 5, 1))
_PIXELS = 420


def look(
    bench: BraidBench, word: IntArray, lookat: tuple[float, float, float], distance: float
) -> Image:
    """Return a square picture of an arm at rest in a word."""
    bench.put(word)
    bench.step(1.0)
    view = mujoco.MjvCamera()
    view.lookat[:] = lookat
    view.distance, view.azimuth, view.elevation = distance, 60.0, -18.0
    with mujoco.Renderer(bench.model, _PIXELS, _PIXELS) as renderer:
        renderer.update_scene(bench.data, view)
        return renderer.render().copy()


def states() -> Figure:
    """Show the eight states of a stage (figure E-2)."""
    bench = make_bench(BraidConfig(1, head=False))
    figure = Figure(figsize=(11, 6.2))
    for state in range(STATES):
        axes = figure.add_subplot(2, 4, state + 1)
        axes.imshow(look(bench, np.array([state]), (0.0, 0.0, 0.02), 0.27))
        long = [str(leg + 1) for leg in range(3) if state >> leg & 1]
        axes.set_title(f"state {state}: " + (f"long {', '.join(long)}" if long else "all short"))
        axes.axis("off")
    figure.tight_layout()
    return figure


def arms() -> Figure:
    """Show five stages with the stereo head in a few words (figures E-1, E-9)."""
    bench = make_bench(BraidConfig(5))
    figure = Figure(figsize=(14, 3.4))
    for index, word in enumerate(ARMS):
        axes = figure.add_subplot(1, len(ARMS), index + 1)
        axes.imshow(look(bench, np.array(word), (0.0, 0.0, 0.17), 0.62))
        axes.set_title("word " + "".join(map(str, word)))
        axes.axis("off")
    figure.tight_layout()
    return figure


def toggle(course: FloatArray) -> Figure:
    """Show a leg there and back: temperatures, place and force; and the detent's force.

    Args:
        course: (n, 5) of `toggle_course`.
    """
    figure = Figure(figsize=(12, 3.6))
    hot, where, well = (figure.add_subplot(1, 3, index + 1) for index in range(3))
    for column, name in ((1, "extending"), (2, "retracting")):
        hot.plot(course[:, 0], MUSCLE_WIRE.ambient + course[:, column], label=f"{name} wires")
    hot.axhspan(*MUSCLE_WIRE.austenite, color="0.85", label="austenite starts to finishes")
    hot.set(xlabel="time [s]", ylabel="temperature [degC]")
    where.plot(course[:, 0], 1e3 * course[:, 3], color="tab:green")
    for level in (-1e3 * BRAID.half_stroke, 1e3 * BRAID.half_stroke):
        where.axhline(level, color="0.6", lw=0.8, ls="--")
    where.set(xlabel="time [s]", ylabel="leg from its middle [mm]")
    force = where.twinx()
    force.plot(course[:, 0], course[:, 4], color="tab:red", lw=0.8)
    force.set_ylabel("wires along the leg [N]", color="tab:red")
    h = BRAID.half_stroke
    x = np.linspace(-1.25 * h, 1.25 * h, 300)
    well.plot(1e3 * x, BRAID.detent * x * (1.0 - (x / h) ** 2))
    for sign in (-1.0, 1.0):
        well.axhline(sign * BRAID.barrier, color="0.6", lw=0.8, ls="--")
        well.plot(sign * 1e3 * h, 0.0, "ko", ms=4)
    well.set(xlabel="leg from its middle [mm]", ylabel="detent on the leg [N]")
    hot.legend(fontsize=7, loc="lower right")
    for axes in (hot, where, well):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def sag(trials: Sequence[SagTrial], results: Sequence[SagRun]) -> Figure:
    """Draw sag and load of the detents by the number of stages."""
    figure = Figure(figsize=(10, 3.8))
    tip, load = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for head, colour in ((True, "tab:blue"), (False, "tab:orange")):
        name = "with head" if head else "without head"
        for trial, result in zip(trials, results):
            if trial.head != head:
                continue
            held = result.held == 1
            at = np.full(held.sum(), trial.stages + (0.1 if head else -0.1))
            tip.plot(at, 1e3 * result.sag[held], ".", ms=3, color=colour)
            load.plot(at, result.load[held], ".", ms=3, color=colour)
        load.plot([], [], ".", color=colour, label=name)
    load.axhline(1.0, color="0.5", ls="--", lw=0.8, label="a leg goes over")
    tip.set(xlabel="stages", ylabel="sag of the tip [mm]", yscale="log")
    load.set(xlabel="stages", ylabel="greatest load on a detent / barrier")
    load.legend(fontsize=8)
    for axes in (tip, load):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    return figure
