"""Figures of ch5-contact: the six states, the contact point's error, success and forces."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controllers.insertion.contact import CardInSlot, contacts_of, pose_in_state, turn
from controllers.insertion.guide import Phase
from experiments.ch5.contact.bench import shape_of
from experiments.ch5.contact.seating_trial import WAYS, SeatingResult
from experiments.ch5.contact.trial import InsertionResult
from experiments.harness.figure_style import GREEN, RED
from experiments.harness.intervals import error_bars, success_fraction
from models.datasheets import DEGREE, INCH
from perception.geometry.arrays import FloatArray

CAPTIONS = {
    1: "mouth corner on leading edge",
    2: "mouth corner on side",
    3: "corner on face",
    4: "mouth corners on edge and side",
    5: "corner on wall, mouth corner on side",
    6: "corner on wall",
}


def card_outline(shape: CardInSlot, pose: FloatArray) -> FloatArray:
    """Return the card's closed outline (5, 2) in the slot's frame [m]."""
    half, length = shape.card_width / 2.0, shape.card_length
    corners = np.array([[-half, 0], [half, 0], [half, -length], [-half, -length], [-half, 0]])
    return corners @ turn(pose[2]).T + pose[:2]


def wall_outlines(shape: CardInSlot) -> list[FloatArray]:
    """Return the closed outlines (5, 2) of both walls, slot's frame [m]."""
    inner, depth = shape.slot_width / 2.0, shape.slot_depth
    outer = inner + shape.wall
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
        _draw_state(figure.add_subplot(2, 3, state), shape, pose, state)
    note = "red: force of the slot on the card; dotted: edges of its friction cone"
    figure.text(0.5, 0.05, note, ha="center", fontsize="small")
    figure.subplots_adjust(hspace=0.15, wspace=0.1)
    return figure


def _draw_state(axes: Axes, shape: CardInSlot, pose: FloatArray, state: int) -> None:
    for wall in wall_outlines(shape):
        axes.fill(*(1e3 * wall.T), color="0.75")
    axes.fill(*(1e3 * card_outline(shape, pose).T), color=GREEN, alpha=0.35)
    rotation = turn(pose[2])
    for contact in contacts_of(shape, pose, state, 1):
        at = 1e3 * (pose[:2] + rotation @ contact.point)
        angle = math.atan(shape.friction)
        for sign, style in ((-1, ":"), (0, "-"), (1, ":")):
            tip = at + 28.0 * (rotation @ turn(sign * angle) @ contact.normal)
            axes.plot([at[0], tip[0]], [at[1], tip[1]], style, color=RED, linewidth=1.5)
        axes.plot(*at, "o", color=RED, markersize=4)
    axes.set(aspect="equal", xlim=(-95, 95), ylim=(-75, 50), xticks=[], yticks=[])
    axes.set_title(f"State {state}: {CAPTIONS[state]}", fontsize="small")


def draw_location(noises: Sequence[float], located: Mapping[int, FloatArray]) -> Figure:
    """Draw the error of the contact point against sensor noise (Thesis figure A-7).

    Args:
        noises: Standard deviations of the noise, fraction of the force.
        located: (noises, n) errors [mm] by state.
    """
    figure = Figure(figsize=(6.5, 4.2))
    axes = figure.add_subplot()
    percent = 100.0 * np.asarray(noises)
    for index, (state, errors) in enumerate(located.items()):
        middle, high = np.percentile(errors, [50, 95], axis=1)
        axes.plot(percent, middle, "o-", color=f"C{index}", label=f"state {state}")
        axes.plot(percent, high, ":", color=f"C{index}")
    axes.set(xlabel="sensor noise [% of the force]", ylabel="error of the contact point [mm]")
    axes.set_title(
        "median, dotted the 95th percentile; 3 and 6 touch at a corner", fontsize="small"
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def draw_success(
    cells: Mapping[tuple[str, float, int], Sequence[InsertionResult]],
    widths: Sequence[float],
    rings: Sequence[int],
) -> Figure:
    """Draw success and largest force over misalignment, for every slot."""
    figure = Figure(figsize=(10, 4.2))
    left, right = figure.subplots(1, 2)
    for index, width in enumerate(widths):
        for method, style in (("guided", "o-"), ("unguided", "s--")):
            # Beside each other, since many are equal.
            shift = 0.05 * (2 * index + (method == "unguided") - len(widths) + 0.5)
            chosen = [cells[method, width, ring] for ring in rings]
            share = [np.mean([r.success for r in cell]) for cell in chosen]
            force = [max(r.peak for r in cell) for cell in chosen]
            for axes, values in ((left, share), (right, force)):
                label = f'{width / INCH:g}" {method}'
                axes.plot(np.array(rings) + shift, values, style, color=f"C{index}", label=label)
    left.set(ylabel="success", ylim=(-0.05, 1.05))
    right.set(ylabel="largest contact force [N]")
    for axes in (left, right):
        axes.set(xticks=list(rings), xlabel="misalignment, thirds of 4 mm and 6 deg")
        axes.grid(alpha=0.3)
    left.legend()
    figure.subplots_adjust(wspace=0.3)
    return figure


def draw_seatings(cells: Mapping[tuple[str, float, int], Sequence[SeatingResult]]) -> Figure:
    """Draw success of each way into card guides over misalignment, a panel for each friction.

    Args:
        cells: Results by way, friction and third of the widest misalignment.
    """
    frictions = sorted({friction for _, friction, _ in cells})
    rings = sorted({ring for _, _, ring in cells})
    figure = Figure(figsize=(11, 3.8))
    panels = figure.subplots(1, len(frictions), sharey=True, squeeze=False)[0]
    for axes, friction in zip(panels, frictions):
        for index, (way, style) in enumerate(zip(WAYS, ("o-", "s--", "^:"))):
            shares = [
                success_fraction(result.success for result in cells[way, friction, ring])
                for ring in rings
            ]
            values, ends = error_bars(shares)
            places = np.array(rings) + 0.06 * (index - 1)
            axes.errorbar(places, values, ends, fmt=style, capsize=3, label=way)
        axes.set(title=f"friction {friction:g}", xticks=rings, ylim=(-0.05, 1.05))
        axes.set_xlabel("misalignment, thirds of the widest")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("seated (95 % interval) [-]")
    panels[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.subplots_adjust(wspace=0.1)
    return figure


def draw_courses(courses: Mapping[str, FloatArray]) -> Figure:
    """Draw pose and forces of one misalignment over time, a column for each method.

    Args:
        courses: (n, 11) courses by method, as in `InsertionResult.course`.
    """
    figure = Figure(figsize=(11, 7))
    panels = figure.subplots(3, len(courses), sharex=True, sharey="row", squeeze=False)
    for (upper, middle, lower), (method, course) in zip(panels.T, courses.items()):
        ending = list(Phase)[int(course[-1, 10])].value
        upper.set_title(f"{method}: {ending}")
        across, depth, tilt, *forces, moment = course[:, 4:10].T
        for axes, label, values in (
            (upper, "across [mm]", 1e3 * across),
            (upper, "depth [mm]", 1e3 * depth),
            (upper, "tilt [deg]", np.degrees(tilt)),
            (middle, "F across", forces[0]),
            (middle, "F along", forces[1]),
            (lower, "moment", moment),
        ):
            axes.plot(course[:, 0], values, label=label)
        middle.set(ylabel="force on the card [N]")
        lower.set(ylabel="moment [N m]", xlabel="time [s]", xlim=(0.0, None))
        for axes in (upper, middle, lower):
            axes.grid(alpha=0.3)
            axes.legend()
    figure.subplots_adjust(hspace=0.25, wspace=0.25)
    return figure
