"""Draw the pictures of docs/concepts.md and docs/frames.md: ``python tools/draw_concepts.py``.

What has a shape is drawn from the compiled models, so that frames are where the models have them.
"""

import itertools
import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import matplotlib as mpl
import matplotlib.pyplot as plt
import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from models.compose import FLAT, RobotPlacement, make_model, settle
from models.datasheets import CARD_AND_SLOT

FOLDER = Path(__file__).parent.parent / "docs" / "drawings"
BLUE, ORANGE, GREY, PALE = "#0072b2", "#d55e00", "#555555", "#e8eef4"
STYLE = {
    "font.size": 9.0,
    "svg.hashsalt": "fieldtwin",  # the same file from the same drawing
    "savefig.facecolor": "white",  # readable on a dark page, too
    "savefig.bbox": "tight",
}


def box(axes: Axes, middle: tuple[float, float], text: str, size: tuple[float, float]) -> None:
    """Draw a box with text in it.

    Args:
        axes: Axes to draw in.
        middle: Middle of the box.
        text: Text; its first line is bold.
        size: Width and height.
    """
    x, y = middle[0] - size[0] / 2, middle[1] - size[1] / 2
    axes.add_patch(FancyBboxPatch((x, y), *size, boxstyle="round,pad=0.02", fc=PALE, ec=GREY))
    first, _, rest = text.partition("\n")
    lines = rest.count("\n") + 1 if rest else 0
    axes.text(*middle, first + "\n" * lines, ha="center", va="center", weight="bold")
    axes.text(*middle, "\n" + rest, ha="center", va="center")


def arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str = "", **look: object
) -> None:
    """Draw an arrow with a text at its middle.

    Args:
        axes: Axes to draw in.
        start: Where it begins.
        end: Where it points.
        text: Text beside it.
        look: More properties of the arrow.
    """
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": GREY, **look})
    middle = (np.array(start) + end) / 2
    axes.text(*middle, text, ha="center", va="bottom", color=GREY)


def canvas(width: float, height: float) -> Axes:
    """Return axes of a picture of a size [in] without frame, one unit an inch."""
    _, axes = plt.subplots(figsize=(width, height))
    axes.set(xlim=(0, width), ylim=(0, height), aspect="equal")
    axes.axis("off")
    return axes


def draw_contract() -> Figure:
    """Draw a controller, what passes between it and a robot, and the four kinds of robots."""
    axes = canvas(7.7, 3.5)
    box(axes, (1.3, 1.7), "Controller\nreset()\nstep(observations)\n→ commands", (2.0, 1.5))
    kinds = ("sim", "quantised", "emulated", "serial:PORT")
    details = ("MuJoCo", "counts as the boards do", "boards in another process", "real boards")
    for row, (kind, detail) in enumerate(zip(kinds, details, strict=True)):
        box(axes, (6.4, 3.0 - 0.86 * row), f"{kind}\n{detail}", (2.4, 0.6))
    axes.plot([4.9, 4.9], [0.2, 3.2], color=GREY)
    axes.text(4.82, 3.3, "connect(TARGET)", ha="center", va="bottom", color=GREY)
    arrow(axes, (4.8, 2.2), (2.4, 2.2), "Observation: channels\nvalue, stamp, validity")
    arrow(axes, (2.4, 1.35), (4.8, 1.35), "Command")
    arrow(axes, (4.8, 0.9), (2.4, 0.9), "applied, after limits", linestyle="--")
    arrow(axes, (4.8, 0.3), (1.3, 0.9), linestyle=":", connectionstyle="angle,angleA=0,angleB=90")
    axes.text(3.1, 0.35, "RobotDescription, as drawn", ha="center", va="bottom", color=GREY)
    return figure_of(axes)


def draw_lifecycle() -> Figure:
    """Draw the states of a robot."""
    axes = canvas(7.4, 1.9)
    states = ("UNCONFIGURED", "INACTIVE\nreads only", "ACTIVE\ndrives", "ERROR\nall axes stopped")
    for place, state in enumerate(states):
        box(axes, (0.85 + 1.9 * place, 0.9), state, (1.5, 0.6))
    arrow(axes, (1.62, 0.9), (1.98, 0.9))
    arrow(axes, (3.52, 1.05), (3.88, 1.05))
    arrow(axes, (3.88, 0.75), (3.52, 0.75))
    arrow(axes, (5.42, 0.9), (5.78, 0.9))
    axes.text(1.8, 1.3, "connect", ha="center", color=GREY)
    axes.text(3.7, 1.3, "activate()", ha="center", color=GREY)
    axes.text(3.7, 0.35, "deactivate()", ha="center", color=GREY)
    axes.text(5.6, 1.3, "any fault", ha="center", color=GREY)
    arrow(axes, (6.5, 0.55), (4.7, 0.55), connectionstyle="arc3,rad=-0.35")
    axes.text(5.6, 0.0, "activate() again, after the cause is mended", ha="center", color=GREY)
    return figure_of(axes)


def draw_drawn_and_made() -> Figure:
    """Draw which model the controller gets, which one is stepped, and who sees the truth."""
    axes = canvas(7.6, 3.7)
    box(axes, (1.3, 2.9), "as drawn\ndata sheets, MJCF", (2.0, 0.7))
    box(axes, (1.3, 0.8), "as made\nby the robot's seed", (2.0, 0.7))
    box(axes, (4.2, 2.9), "RobotDescription\nwith tolerances", (1.9, 0.7))
    box(axes, (6.7, 2.9), "Controller", (1.3, 0.7))
    box(axes, (4.2, 0.8), "Simulation\nsteps this one", (1.9, 0.7))
    box(axes, (6.7, 0.8), "score\nafterwards", (1.3, 0.7))
    arrow(axes, (1.3, 2.5), (1.3, 1.2))
    axes.text(1.4, 2.05, "tolerances, biases,\nplay, clock", va="center", color=GREY)
    arrow(axes, (2.35, 2.9), (3.2, 2.9))
    arrow(axes, (5.2, 2.9), (6.0, 2.9))
    arrow(axes, (2.35, 0.8), (3.2, 0.8))
    arrow(axes, (5.2, 0.8), (6.0, 0.8))
    axes.text(5.6, 0.9, "truth", ha="center", va="bottom", color=GREY)
    arrow(axes, (4.9, 1.2), (6.4, 2.5))
    arrow(axes, (6.9, 2.5), (5.15, 1.15))
    axes.text(5.2, 2.1, "observations", ha="right", va="center", color=GREY)
    axes.text(6.5, 2.1, "commands", ha="left", va="center", color=GREY)
    axes.plot([3.15, 7.6], [1.42, 1.42], color=ORANGE, linestyle="--")
    axes.text(7.6, 1.45, "no truth passes", ha="right", va="bottom", color=ORANGE)
    return figure_of(axes)


STAGES = {
    "identify": "springs,\nturn share",
    "search": "panel, so\nown pose",
    "map": "voxels of\nthe site",
    "place": "camera\nstation",
    "approach": "slot in own\nframe",
    "insert": "slot in\ncard's frame",
}


def draw_belief() -> Figure:
    """Draw what each stage of a mission adds to a rover's belief."""
    axes = canvas(8.2, 1.9)
    axes.text(0.1, 1.75, "drawings first: springs, wheels, site, initial pose ± 0.5 m", color=GREY)
    for place, (stage, gain) in enumerate(STAGES.items()):
        x = 0.7 + 1.36 * place
        box(axes, (x, 0.95), f"{stage}\n{gain}", (1.12, 0.95))
        if place:
            arrow(axes, (x - 0.8, 0.95), (x - 0.56, 0.95))
    axes.text(0.1, 0.05, "all along: odometry, elevation map, other rover's slot pose by radio",
              color=GREY)  # fmt: skip
    return figure_of(axes)


def frame(
    axes: Axes,
    origin: NDArray[np.float64],
    directions: dict[str, NDArray[np.float64]],
    name: str,
    side: tuple[float, float],
    size: float = 0.07,
) -> None:
    """Draw a frame's axes that lie in the picture, and its name.

    Args:
        axes: Axes to draw in.
        origin: (2,) origin.
        directions: (2,) direction of each axis by its letter.
        name: Name of the frame.
        side: Offset of the name from the origin.
        size: Length of an axis.
    """
    for letter, direction in directions.items():
        end = origin + size * direction
        colour = {"x": ORANGE, "y": "#009e73", "z": BLUE}[letter]
        axes.annotate("", end, origin, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8})
        axes.text(
            *(origin + 1.3 * size * direction), letter, color=colour, ha="center", va="center"
        )
    if np.linalg.norm(side) > size:
        axes.plot(*np.transpose([origin, origin + 0.82 * np.array(side)]), color=GREY, lw=0.6)
    axes.text(*(origin + side), name, ha="center", va="center")


def silhouette(axes: Axes, model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> None:
    """Draw a geom as it looks from the right: the outline of its box, or a wheel's circle."""
    centre, half = np.split(np.array(model.geom_aabb[geom], dtype=float), 2)
    turn = data.geom_xmat[geom].reshape(3, 3)
    middle = (data.geom_xpos[geom] + turn @ centre)[1:]
    look = {"fc": PALE, "ec": GREY, "lw": 0.7}
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER and abs(turn[0, 2]) > 0.9:  # noqa: PLR2004
        axes.add_patch(Circle(tuple(middle), model.geom_size[geom][0], **look))
        return
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * half
    flat = (corners @ turn.T)[:, 1:] + middle
    axes.add_patch(Polygon(flat[ConvexHull(flat).vertices], **look))


def draw_rover_frames() -> Figure:
    """Draw the rover from its right with the frames that code and descriptions use."""
    model = make_model(FLAT, [RobotPlacement()])
    data = settle(model)
    for name, angle in (("shoulder", 0.75), ("elbow", -0.6), ("wrist", -0.5)):
        data.joint(f"rover1/{name}_joint").qpos = angle
    mujoco.mj_forward(model, data)
    _, axes = plt.subplots(figsize=(7.6, 3.6))
    own = model.body_rootid[model.geom_bodyid] == model.body("rover1/chassis").id
    shown = np.flatnonzero(own & (model.geom_group < 3) & (model.geom_rgba[:, 3] > 0))  # noqa: PLR2004
    for geom in shown:
        silhouette(axes, model, data, int(geom))
    axes.axhline(0.0, color=GREY)
    yz = np.eye(3)[:, 1:]
    for body, name, side in (
        ("chassis", "robot frame,\nat the chassis", (-0.16, 0.16)),
        ("arm_base_link", "arm base frame,\nforce/torque sensor", (-0.1, 0.27)),
    ):
        place, turn = (
            data.body(f"rover1/{body}").xpos,
            data.body(f"rover1/{body}").xmat.reshape(3, 3),
        )
        frame(axes, place[1:], {"y": turn[:, 1] @ yz, "z": turn[:, 2] @ yz}, name, side)
    eye = data.camera("rover1/stereo_left")
    turn = eye.xmat.reshape(3, 3) * [1, -1, -1]  # MuJoCo's cameras look along -z, y up
    looking = {"y": turn[:, 1] @ yz, "z": turn[:, 2] @ yz}
    frame(axes, eye.xpos[1:], looking, "camera frame,\nleft eye", (0.12, 0.13))
    frame(axes, np.array([-0.42, 0.03]), {"y": np.array([1.0, 0.0]), "z": np.array([0.0, 1.0])},
          "world", (0.04, -0.015))  # fmt: skip
    axes.set(aspect="equal", xlim=(-0.5, 0.72), ylim=(-0.05, 0.5))
    axes.text(
        -0.48, 0.47, "seen from the right; x of all frames points out of the page", color=GREY
    )
    axes.axis("off")
    return figure_of(axes)


def draw_camera_frame() -> Figure:
    """Draw the camera's frame, its pixels and the disparity."""
    axes = canvas(7.2, 2.9)
    axes.add_patch(Polygon([(0.4, 0.5), (3.2, 0.5), (3.2, 2.5), (0.4, 2.5)], fc=PALE, ec=GREY))
    axes.text(0.4, 2.58, "(0, 0) is the middle of the first pixel", color=GREY)
    arrow(axes, (0.45, 2.3), (1.4, 2.3), "")
    axes.text(1.5, 2.3, "u, columns", va="center")
    arrow(axes, (0.6, 2.45), (0.6, 1.5), "")
    axes.text(0.7, 1.4, "v, rows", va="center")
    axes.plot(1.8, 1.5, "+", color=GREY, ms=12)
    axes.text(1.9, 1.55, "(cx, cy)", color=GREY)
    for x, name in ((4.6, "left"), (5.9, "right")):
        frame(axes, np.array([x, 1.0]), {"x": np.array([1.0, 0.0]), "z": np.array([0.0, 1.0])},
              f"{name} eye", (0.0, -0.25), 0.6)  # fmt: skip
        axes.plot([x, 5.4], [1.0, 2.5], color=GREY, lw=0.7, linestyle="--")
    axes.plot(5.4, 2.5, "o", color=GREY)
    axes.text(5.5, 2.5, "point", va="center")
    arrow(axes, (4.6, 0.45), (5.9, 0.45), "")
    arrow(axes, (5.9, 0.45), (4.6, 0.45), "baseline b")
    axes.text(5.25, 0.1, "disparity = left column - right column > 0", ha="center", color=GREY)
    return figure_of(axes)


def draw_card_frames() -> Figure:
    """Draw card and slot to scale with their frames, from above their faces."""
    sheet, width = CARD_AND_SLOT, CARD_AND_SLOT.slot_widths[1]
    _, axes = plt.subplots(figsize=(5.0, 3.5))
    for side in (-1, 1):
        inner = side * width / 2
        outer = inner + side * sheet.wall
        axes.add_patch(Polygon([(inner, 0), (outer, 0), (outer, sheet.slot_depth),
                                (inner, sheet.slot_depth)], fc="#c9c9c9", ec=GREY))  # fmt: skip
    turn = np.radians(6.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    half, place = sheet.card_width / 2, np.array([0.004, -0.03])
    corners = np.array(
        [(-half, 0), (half, 0), (half, -sheet.card_length), (-half, -sheet.card_length)]
    )
    axes.add_patch(Polygon(corners @ rotation.T + place, fc="#cfe8da", ec=GREY))
    across, ahead = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    frame(axes, np.zeros(2), {"x": across, "y": ahead}, "slot", (-0.018, 0.008), size=0.025)
    frame(
        axes,
        place,
        {"x": rotation @ across, "y": rotation @ ahead},
        "card",
        (-0.014, -0.01),
        size=0.025,
    )
    axes.text(0.07, -0.05, "z of both: out of the page", color=GREY)
    axes.set(aspect="equal", xlim=(-0.1, 0.14), ylim=(-0.14, 0.05))
    axes.axis("off")
    return figure_of(axes)


def figure_of(axes: Axes) -> Figure:
    """Return the figure that axes are in."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    return figure


DRAWINGS = {
    "contract": draw_contract,
    "lifecycle": draw_lifecycle,
    "drawn_and_made": draw_drawn_and_made,
    "belief": draw_belief,
    "rover_frames": draw_rover_frames,
    "camera_frame": draw_camera_frame,
    "card_frames": draw_card_frames,
}


def main(folder: Path = FOLDER) -> None:
    """Write all drawings as SVG files into a folder."""
    folder.mkdir(exist_ok=True)
    with mpl.rc_context(STYLE):
        for name, draw in DRAWINGS.items():
            figure = draw()
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
            plt.close(figure)


if __name__ == "__main__":
    main()
