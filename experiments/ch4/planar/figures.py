"""Figures 4-6, 4-8, 4-10 and 4-11, how fast the searches are, and the film."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from PIL import Image

from controllers.placement.moving import cell_centres
from controllers.placement.planar.search import PlanarTask, best_view, rating_field
from controllers.placement.task import Target, View
from experiments.ch4.planar.motion import MappedSite, Moment
from experiments.ch4.planar.scenes import SIDE
from experiments.harness.figure_style import BLUE, GREEN, GREY, ORANGE, RED
from experiments.harness.recording import write_gif
from perception.geometry.arrays import FloatArray

EXTENT = (0.0, float(SIDE), 0.0, float(SIDE))
COLOURS = {"primary": RED, "secondary": BLUE}
FRAME, HOLD = 250, 2000
"""Duration of a picture of the film, and of the last one [ms]."""
SOFT = 0.4
"""Exponent of the shade: a rating falls so steeply with distance that its tail would not show."""


def draw_hull_cost(distances: FloatArray, angles: FloatArray) -> Figure:
    """Draw the occluded angle over the occluder's distance, true and by hulls (figure 4-6).

    Args:
        distances: (N,) distances of the occluder from the target [m].
        angles: (N, 2) occluded angles, true and by the hull [rad].
    """
    figure = Figure(figsize=(10, 4))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    degrees = np.degrees(angles)
    left.plot(distances, degrees[:, 0], label=r"true, $\alpha_2-\alpha_1$")
    left.plot(distances, degrees[:, 1], "--", label=r"expanded, $\beta_2-\beta_1$")
    left.set(ylabel="occluded angle [deg]")
    left.legend()
    right.plot(distances, degrees[:, 1] - degrees[:, 0], color=GREEN)
    right.set(ylabel="given up by the hull [deg]", ylim=(0.0, None))
    for axes in (left, right):
        axes.set(xscale="log", xlabel="occluder's distance from the target [m]")
        axes.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def draw_searches(rows: Sequence[Sequence[Any]], names: Sequence[str]) -> Figure:
    """Draw the times of both searches by density.

    Args:
        rows: Density [%] and the scene's results.
        names: Names of the results.
    """
    table = np.array(rows, dtype=float)
    figure = Figure(figsize=(6, 4))
    axes = figure.add_subplot()
    for name, colour in (("exhaustive_s", GREY), ("fast_s", RED)):
        place = 1 + list(names).index(name)
        for at, density in enumerate(np.unique(table[:, 0])):
            times = 1e6 * table[table[:, 0] == density, place]
            offsets = np.linspace(-0.25, 0.25, len(times))
            label = name.removesuffix("_s") if at == 0 else None
            axes.plot(at + offsets, times, ".", markersize=3, color=colour, label=label)
    densities = [f"{density:g} %" for density in np.unique(table[:, 0])]
    axes.set_xticks(range(len(densities)), densities)
    axes.set(yscale="log", xlabel="area covered", ylabel="time of a search [us]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.tight_layout()
    return figure


def draw_instances(tasks: Sequence[PlanarTask]) -> Figure:
    """Draw the world and the rating over it, for each task a row (figure 4-8)."""
    figure = Figure(figsize=(10, 4.6 * len(tasks)))
    fields = [rating_field(task, cell_centres(task.space)).max(axis=0) for task in tasks]
    norm = PowerNorm(SOFT, 0.0, max(float(field.max()) for field in fields))
    for row, (task, field) in enumerate(zip(tasks, fields)):
        view = best_view(task)
        world = figure.add_subplot(len(tasks), 2, 2 * row + 1)
        for occluder in task.occluders:
            world.fill(*occluder.points.T, color="0.35")
        rated = figure.add_subplot(len(tasks), 2, 2 * row + 2)
        image = rated.imshow(field, cmap="gray_r", norm=norm, origin="lower", extent=EXTENT)
        for occluder in task.occluders:
            rated.fill(*occluder.points.T, fill=False, edgecolor=GREEN)
        for axes in (world, rated):
            _draw_targets(axes, task.targets)
            _draw_view(axes, task, view)
            _frame(axes)
        world.set_title(f"instance {row + 1}: the {view.target} target is watched")
        rated.set_title("rating, darker is better")
        figure.colorbar(image, ax=rated, label="RF [1/m]", shrink=0.8)
    figure.tight_layout()
    return figure


def draw_site(site: MappedSite, first: Moment) -> Figure:
    """Draw the world and its map after few scans (figure 4-10)."""
    figure = Figure(figsize=(10, 5))
    maps = (site.world.occupied, site.mapped.probability)
    titles = ("world", "map, darker is more surely occupied")
    for place, (title, values) in enumerate(zip(titles, maps)):
        axes = figure.add_subplot(1, 2, place + 1)
        axes.imshow(1.0 - values, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=EXTENT)
        axes.fill(*first.panel.T, fill=False, edgecolor=ORANGE)
        _draw_targets(axes, first.task.targets)
        axes.set_title(title)
        _frame(axes)
    figure.tight_layout()
    return figure


def draw_steps(site: MappedSite, moments: Sequence[Moment]) -> Figure:
    """Draw the first step, the last of the primary target, and the last of all (figure 4-11)."""
    primary = [m.step for m in moments if m.view is not None and m.view.target == "primary"]
    steps = [0, primary[-1] if primary else len(moments) // 2, len(moments) - 1]
    figure = Figure(figsize=(13, 4.8))
    for place, step in enumerate(steps):
        axes = figure.add_subplot(1, 3, place + 1)
        _draw_moment(axes, site, moments, step)
        axes.set_title(f"({'abc'[place]}) {axes.get_title()}", fontsize="small")
    figure.tight_layout()
    return figure


def write_film(site: MappedSite, moments: Sequence[Moment], path: Path) -> None:
    """Write the approach as a moving picture."""
    frames: list[Image.Image] = []
    for step in range(len(moments)):
        figure = Figure(figsize=(4.6, 4.6), dpi=90)
        _draw_moment(figure.add_subplot(), site, moments, step)
        figure.subplots_adjust(0.12, 0.1, 0.98, 0.94)
        stream = io.BytesIO()
        FigureCanvasAgg(figure).print_png(stream)
        frames.append(Image.open(stream).convert("RGB"))
    write_gif(path, frames, frames[len(frames) // 2].quantize(64), FRAME, HOLD)


def _draw_moment(axes: Axes, site: MappedSite, moments: Sequence[Moment], step: int) -> None:
    """Draw the estimated map, the panel's true and estimated outline, and the camera's track."""
    moment = moments[step]
    axes.imshow(
        1.0 - moment.task.space.probability, cmap="gray", vmin=0.0, vmax=1.0, origin="lower",
        extent=EXTENT,
    )  # fmt: skip
    axes.fill(*moment.panel.T, fill=False, edgecolor=ORANGE, linewidth=1.5)
    axes.plot(*moment.task.occluders[-1].points.T, ",", color=ORANGE)
    _draw_targets(axes, moment.task.targets)
    trail = [m.view.position for m in moments[: step + 1] if m.view is not None]
    if trail:
        axes.plot(*np.array(trail).T, ":", color=GREEN, linewidth=1.2)
    if moment.view is not None:
        _draw_view(axes, moment.task, moment.view)
    watched = "nothing" if moment.view is None else f"the {moment.view.target} target"
    axes.set_title(f"step {step}: watches {watched}", fontsize="small")
    _frame(axes)


def _draw_targets(axes: Axes, targets: Sequence[Target]) -> None:
    for target in targets:
        colour = COLOURS[target.name]
        axes.plot(*(target.position + target.outline).T, color=colour, linewidth=3)
        x, y = map(float, target.position)
        box = {"facecolor": "white", "alpha": 0.7, "pad": 1.0, "linewidth": 0.0}
        axes.annotate(target.name, (x - 5.0, y), color=colour, ha="right",
                      va="center", fontsize="small", bbox=box)  # fmt: skip


def _draw_view(axes: Axes, task: PlanarTask, view: View) -> None:
    """Draw the camera and its field of view, as far as the target."""
    offset = task.target(view.target).position - view.position
    angle = np.arctan2(offset[1], offset[0])
    half = 0.5 * task.lens.field_of_view
    bearings = angle + np.linspace(-half, half, 16)
    edge = view.position + view.distance * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    axes.fill(*np.vstack([view.position, edge]).T, color=GREEN, alpha=0.25)
    axes.plot(*view.position, "o", color=GREEN, markersize=6)


def _frame(axes: Axes) -> None:
    axes.set(xlim=EXTENT[:2], ylim=EXTENT[2:], aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.tick_params(labelsize=7)
