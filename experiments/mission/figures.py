"""Figures of ``mission``: the field and both rovers' tracks, and the site after each stage."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from experiments.harness.figure_style import COLOURS, RED
from experiments.mission.scene import CARD_PLACE, MASTER, SLAVE, draw_scene
from experiments.mission.trial import MissionResult, MissionTrial, generators
from models.clutter import Solids
from models.compose import make_terrain
from perception.geometry.arrays import ImageArray

ROLES = {MASTER: "master", SLAVE: "slave"}
_NAMES = {MASTER: "master", SLAVE: "slave, with the card"}


def draw_tracks(trial: MissionTrial, result: MissionResult) -> Figure:
    """Draw the field as it is, and both rovers' tracks.

    Args:
        trial: Settings of the mission.
        result: Its result.
    """
    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    axes = figure.add_subplot()
    draw_field(axes, trial)
    for robot, track in result.tracks.items():
        colour = COLOURS[ROLES[robot]]
        axes.plot(*track.T, color=colour, label=_NAMES[robot])
        axes.plot(*track[0], "o", color=colour)
    points = np.vstack([np.zeros((1, 2)), *result.tracks.values()])
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    axes.legend(loc="best")
    return figure


def draw_field(axes: Axes, trial: MissionTrial) -> None:
    """Draw what stands in the field of a mission, as it is.

    Args:
        axes: Axes in metres of the field's plane.
        trial: Settings of the mission.
    """
    scene = draw_scene(trial.width, generators(trial.seed)[0], trial.hardness)
    ground = make_terrain(scene.field, scene.robots)
    for solids, colour in (
        (ground.rocks, "0.8"), (ground.blocks, "0.55"), (ground.screens, "0.2"),
    ):  # fmt: skip
        _draw_solids(axes, solids, colour)
    panel = scene.field.panel
    assert panel is not None
    along = 0.5 * panel.size[0] * np.array([np.cos(panel.yaw), np.sin(panel.yaw)])
    ends = np.array([np.array(panel.position) - along, np.array(panel.position) + along])
    axes.plot(*ends.T, color=RED, linewidth=3, label="panel")
    axes.plot(*CARD_PLACE[:2], "x", color="black", label="the slave's place")


def draw_steps(steps: Sequence[tuple[str, float, ImageArray]]) -> Figure:
    """Draw the site at the end of each stage.

    Args:
        steps: Names of the stages, times [s] and colour pictures.
    """
    columns = 2 if len(steps) > 1 else 1
    rows = max(1, -(-len(steps) // columns))
    figure = Figure(figsize=(5.2 * columns, 4.1 * rows))
    for index, (name, time, picture) in enumerate(steps):
        axes = figure.add_subplot(rows, columns, index + 1)
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(f"{name}, {time:.1f} s")
    figure.tight_layout()
    return figure


def _draw_solids(axes: Axes, solids: Solids, colour: str) -> None:
    for centre, half, yaw in zip(solids.centres, solids.half_sizes, solids.yaws):
        if colour == "0.8":
            axes.add_patch(Circle(centre[:2], float(half[:2].mean()), color=colour))
            continue
        c, s = np.cos(yaw), np.sin(yaw)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half[:2]
        axes.add_patch(Polygon(corners @ np.array([[c, s], [-s, c]]) + centre[:2], color=colour))
