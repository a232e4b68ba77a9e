"""Figures of ``appe-mechanism``: states, arms, a leg that switches, and sag."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from controllers.braid.arm.stage import STATES
from experiments.appe.mechanism.bench import BraidBench, make_bench
from experiments.appe.mechanism.trial import ArmTrial, WordErrors
from experiments.harness.figure_style import BLUE, GREEN, ORANGE, RED
from models.braid.build import BraidConfig
from models.datasheets import BRAID, MUSCLE_WIRE
from models.render_pictures import Shot, take
from perception.geometry.arrays import FloatArray, ImageArray, IntArray

ARMS = ((0, 0, 0, 0, 0), (7, 7, 7, 7, 7), (1, 1, 1, 1, 1), (6, 6, 1, 1, 6), (2, 4, 3, 5, 1))


def picture(bench: BraidBench, word: IntArray, height: float, distance: float) -> ImageArray:
    """Return a square picture of an arm at rest in a word.

    Args:
        bench: The arm.
        word: (n,) states, base first.
        height: Height of the point in the middle of the picture [m].
        distance: Distance of the eye from that point [m].
    """
    bench.put(word)
    bench.step(1.0)
    shot = Shot((0.0, 0.0, height), distance, 60.0, -18.0)
    return take(bench.model, bench.data, shot, (420, 420))


def gallery(
    pictures: Sequence[tuple[str, ImageArray]], columns: int, size: tuple[float, float]
) -> Figure:
    """Show pictures side by side.

    Args:
        pictures: Title and picture of each panel, row by row.
        columns: Number of panels in a row.
        size: Width and height of the figure [inch].
    """
    figure = Figure(figsize=size, layout="tight")
    for index, (title, image) in enumerate(pictures, start=1):
        axes = figure.add_subplot(-(-len(pictures) // columns), columns, index)
        axes.imshow(image)
        axes.set_title(title)
        axes.axis("off")
    return figure


def states() -> Figure:
    """Show the eight states of a stage (figure E-2)."""
    bench, pictures = make_bench(BraidConfig(1, head=False)), []
    for state in range(STATES):
        long = ", ".join(str(leg + 1) for leg in range(3) if state >> leg & 1)
        title = f"state {state}: " + (f"long {long}" if long else "all short")
        pictures.append((title, picture(bench, np.array([state]), 0.02, 0.27)))
    return gallery(pictures, 4, (11, 6.2))


def arms() -> Figure:
    """Show five stages with the stereo head in a few words (figures E-1, E-9)."""
    bench = make_bench(BraidConfig(5))
    pictures = [
        ("word " + "".join(map(str, word)), picture(bench, np.array(word), 0.17, 0.62))
        for word in ARMS
    ]
    return gallery(pictures, len(ARMS), (14, 3.4))


def toggle(course: FloatArray) -> Figure:
    """Show a leg there and back: temperatures, travel and force; and the detent's force.

    Args:
        course: (n, 5) what `toggle_course` returns.
    """
    figure = Figure(figsize=(12, 3.6), layout="tight")
    hot, where, well = figure.subplots(1, 3)
    for column, name in ((1, "extending"), (2, "retracting")):
        hot.plot(course[:, 0], MUSCLE_WIRE.ambient + course[:, column], label=f"{name} wires")
    hot.axhspan(*MUSCLE_WIRE.austenite, color="0.85", label="austenite starts to finishes")
    hot.set(xlabel="time [s]", ylabel="temperature [degC]")
    where.plot(course[:, 0], 1e3 * course[:, 3], color=GREEN)
    where.set(xlabel="time [s]", ylabel="leg from its middle [mm]")
    force = where.twinx()
    force.plot(course[:, 0], course[:, 4], color=RED, lw=0.8)
    force.set_ylabel("wires along the leg [N]", color=RED)
    h = BRAID.half_stroke
    x = np.linspace(-1.25 * h, 1.25 * h, 300)
    well.plot(1e3 * x, BRAID.detent * x * (1.0 - (x / h) ** 2))
    for sign in (-1.0, 1.0):
        where.axhline(sign * 1e3 * h, color="0.6", lw=0.8, ls="--")
        well.axhline(sign * BRAID.barrier, color="0.6", lw=0.8, ls="--")
        well.plot(sign * 1e3 * h, 0.0, "ko", ms=4)
    well.set(xlabel="leg from its middle [mm]", ylabel="detent on the leg [N]")
    hot.legend(loc="lower right")
    for axes in (hot, where, well):
        axes.grid(alpha=0.3)
    return figure


def sag(trials: Sequence[ArmTrial], results: Sequence[WordErrors]) -> Figure:
    """Draw sag and load of the detents by the number of stages."""
    figure = Figure(figsize=(10, 3.8), layout="tight")
    tip, load = figure.subplots(1, 2)
    for trial, result in zip(trials, results):
        held, colour = result.wrong == 0, BLUE if trial.head else ORANGE
        at = np.full(held.sum(), trial.stages + (0.1 if trial.head else -0.1))
        tip.plot(at, 1e3 * result.sag[held], ".", ms=3, color=colour)
        load.plot(at, result.load[held], ".", ms=3, color=colour)
    for name, colour in (("with head", BLUE), ("without head", ORANGE)):
        load.plot([], [], ".", color=colour, label=name)
    load.axhline(1.0, color="0.5", ls="--", lw=0.8, label="a leg switches")
    tip.set(xlabel="stages", ylabel="sag of the tip [mm]", yscale="log")
    load.set(xlabel="stages", ylabel="greatest load on a detent / barrier")
    load.legend()
    for axes in (tip, load):
        axes.grid(alpha=0.3)
    return figure
