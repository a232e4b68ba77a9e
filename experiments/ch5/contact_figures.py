"""Figures of ch5-contact: the six states, the contact point's error, success and forces."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from controllers.insertion.contact import CardInSlot, contacts_of, pose_in_state, turn
from controllers.insertion.guide import Phase
from experiments.ch5.contact_bench import shape_of
from models.datasheets import DEGREE, INCH

Floats = NDArray[np.float64]

CAPTIONS = {
    1: "mouth corner on leading edge",
    2: "mouth corner on side",
    3: "corner on face",
    4: "mouth corners on edge and side",
    5: "corner on wall, mouth corner on side",
    6: "corner on wall",
}


def card_outline(shape: CardInSlot, pose: Floats) -> Floats:
    """Return the card's closed outline (5, 2) in the slot's frame [m]."""
    half, length = shape.card_width / 2.0, shape.card_length
    corners = np.array([[-half, 0], [half, 0], [half, -length], [-half, -length], [-half, 0]])
    return corners @ turn(pose[2]).T + pose[:2]


def wall_outlines(shape: CardInSlot) -> list[Floats]:
    """Return the closed outlines (5, 2) of both walls, slot's frame [m]."""
    inner, outer = shape.slot_width / 2.0, shape.slot_width / 2.0 + shape.wall
    depth = shape.slot_depth
    right = np.array([[inner, 0], [outer, 0], [outer, depth], [inner, depth], [inner, 0]])
    return [right * [-1, 1], right]


def draw_states(width: float) -> Figure:
    """Draw the six contact states with their friction cones (Thesis figures A-5, A-6)."""
    shape = shape_of(width)
    steepest = math.acos(shape.card_width / shape.slot_width)
    figure = Figure(figsize=(11, 5.6))
    for state in range(1, 7):
        tilt = {4: steepest + 4 * DEGREE, 5: 0.62 * steepest}.get(state, 7 * DEGREE)
        pose = pose_in_state(shape, state, 1, tilt, 0.008 if state in (1, 3) else 0.02)
        axes = figure.add_subplot(2, 3, state)
        _draw_state(axes, shape, pose, state)
    note = "red: force of the slot on the card; dotted: edges of its friction cone"
    figure.text(0.5, 0.05, note, ha="center", fontsize=9)
    figure.subplots_adjust(hspace=0.15, wspace=0.1)
    return figure


def _draw_state(axes: Axes, shape: CardInSlot, pose: Floats, state: int) -> None:
    for wall in wall_outlines(shape):
        axes.fill(*(1e3 * wall.T), color="0.75")
    axes.fill(*(1e3 * card_outline(shape, pose).T), color="tab:green", alpha=0.35)
    rotation = turn(pose[2])
    for contact in contacts_of(shape, pose, state, 1):
        at = 1e3 * (pose[:2] + rotation @ contact.point)
        angle = math.atan(shape.friction)
        for sign, style in ((-1, ":"), (0, "-"), (1, ":")):
            tip = at + 28.0 * (rotation @ turn(sign * angle) @ contact.normal)
            axes.plot([at[0], tip[0]], [at[1], tip[1]], style, color="tab:red", linewidth=1.5)
        axes.plot(*at, "o", color="tab:red", markersize=4)
    axes.set(aspect="equal", xlim=(-95, 95), ylim=(-75, 50), xticks=[], yticks=[])
    axes.set_title(f"State {state}: {CAPTIONS[state]}", fontsize=9)


def draw_location(noises: Sequence[float], located: Mapping[int, Floats]) -> Figure:
    """Draw the error of the contact point against sensor noise (Thesis figure A-7).

    Args:
        noises: Fractions of the force.
        located: (noises, n) errors [mm] by state.
    """
    figure = Figure(figsize=(6.5, 4.2))
    axes = figure.add_subplot()
    percent = 100.0 * np.asarray(noises)
    for index, (state, errors) in enumerate(located.items()):
        colour = f"C{index}"
        axes.plot(percent, np.median(errors, axis=1), "o-", color=colour, label=f"state {state}")
        axes.plot(percent, np.percentile(errors, 95, axis=1), ":", color=colour)
    axes.set(xlabel="sensor noise [% of the force]", ylabel="error of the contact point [mm]")
    axes.set_title("median, dotted the 95th percentile; 3 and 6 touch at a corner", fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def draw_success(
    cells: Mapping[tuple[str, float, int], Sequence[Mapping[str, Any]]],
    widths: Sequence[float],
    rings: Sequence[int],
) -> Figure:
    """Draw success and largest force over misalignment, for every slot."""
    figure = Figure(figsize=(10, 4.2))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for index, width in enumerate(widths):
        for way, style in (("guided", "o-"), ("unguided", "s--")):
            # Beside each other, since many are equal.
            places = np.array(rings) + 0.05 * (2 * index + (way == "unguided") - len(widths) + 0.5)
            chosen = [cells[way, width, ring] for ring in rings]
            label = f'{width / INCH:g}" {way}'
            share = [np.mean([r["success"] for r in cell]) for cell in chosen]
            force = [max(r["peak"] for r in cell) for cell in chosen]
            left.plot(places, share, style, color=f"C{index}", label=label)
            right.plot(places, force, style, color=f"C{index}", label=label)
    left.set(ylabel="success", ylim=(-0.05, 1.05))
    right.set(ylabel="largest contact force [N]")
    for axes in (left, right):
        axes.set(xticks=list(rings), xlabel="misalignment, thirds of 4 mm and 6 deg")
        axes.grid(alpha=0.3)
    left.legend(fontsize=8)
    figure.subplots_adjust(wspace=0.3)
    return figure


def draw_courses(courses: Mapping[str, Floats]) -> Figure:
    """Draw pose and forces of one misalignment over time, a column for each way.

    Args:
        courses: (n, 11) each, as `ch5_contact_trial.run_insertion` returns it.
    """
    figure = Figure(figsize=(11, 7))
    for column, (way, course) in enumerate(courses.items()):
        time = course[:, 0]
        ending = list(Phase)[int(course[-1, 10])].value
        upper = figure.add_subplot(3, 2, 1 + column)
        upper.set_title(f"{way}: {ending}", fontsize=10)
        upper.plot(time, 1e3 * course[:, 4], label="across [mm]")
        upper.plot(time, 1e3 * course[:, 5], label="depth [mm]")
        upper.plot(time, np.degrees(course[:, 6]), label="tilt [deg]")
        upper.legend(fontsize=8)
        middle = figure.add_subplot(3, 2, 3 + column)
        middle.plot(time, course[:, 7], label="F across")
        middle.plot(time, course[:, 8], label="F along")
        middle.set(ylabel="force on the card [N]")
        middle.legend(fontsize=8)
        lower = figure.add_subplot(3, 2, 5 + column)
        lower.plot(time, course[:, 9], color="tab:purple")
        lower.set(ylabel="moment [N m]", xlabel="time [s]")
        for axes in (upper, middle, lower):
            axes.grid(alpha=0.3)
    for row in range(3):  # the same scale for all ways
        panels = figure.axes[row::3]
        limits = np.array([axes.get_ylim() for axes in panels])
        last = max(axes.get_xlim()[1] for axes in panels)
        for axes in panels:
            axes.set(xlim=(0.0, last), ylim=(limits[:, 0].min(), limits[:, 1].max()))
    figure.subplots_adjust(hspace=0.25, wspace=0.25)
    return figure
