"""Two small worked pictures: how Gaussians are merged (3-6), how a view is evaluated (3-8)."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Wedge

from experiments.ch3.planar.figures import draw_picture
from experiments.ch3.planar.trial import PlanarTrial, build_world
from perception.geometry.arrays import FloatArray
from perception.planar.information import READINGS, KnownGround, new_information
from perception.planar.map import PlanarMap
from perception.planar.raycast import RangeSensor, expected_view, fan, scan
from perception.voxels.occupancy import State

HEADINGS = 24


def merge(
    mean_1: FloatArray, covariance_1: FloatArray, mean_2: FloatArray, covariance_2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Multiply two Gaussians (Thesis eq. 3-10 as mended: C1 - C1 (C1 + C2)^-1 C1).

    Args:
        mean_1: (n,) mean of the first.
        covariance_1: (n, n) covariance of the first.
        mean_2: (n,) mean of the second.
        covariance_2: (n, n) covariance of the second.

    Returns:
        Mean (n,) and covariance (n, n).
    """
    gain = np.linalg.solve(covariance_1 + covariance_2, covariance_1).T
    return mean_1 + gain @ (mean_2 - mean_1), covariance_1 - gain @ covariance_1


def merging_figure() -> Figure:
    """Draw two range measurements of one point from two sides, and their fusion (figure 3-6)."""
    figure = Figure(figsize=(6, 5))
    axes = figure.add_subplot()
    means = (np.array([0.0, 0.0]), np.array([0.35, 0.25]))
    covariances: list[FloatArray] = []
    for angle in np.radians([10.0, 80.0]):
        # Deviations along and across the line of sight, turned into the common frame (3-9).
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        covariances.append(turn @ np.diag([0.6**2, 0.12**2]) @ turn.T)
    mean, merged = merge(means[0], covariances[0], means[1], covariances[1])
    shown = zip((*means, mean), (*covariances, merged), ("C0", "C1", "k"))
    for (centre, covariance, colour), label in zip(shown, ("first", "second", "merged")):
        values, vectors = np.linalg.eigh(covariance)
        tilt = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        for scale in (1.0, 2.0):
            width, height = 2.0 * scale * np.sqrt(values[::-1])
            ellipse = Ellipse(
                (float(centre[0]), float(centre[1])), width, height, angle=tilt, fill=False,
                color=colour, label=f"{label}, 1 and 2 sigma" if scale == 1.0 else None,
            )  # fmt: skip
            axes.add_patch(ellipse)
    axes.set(xlim=(-1.5, 1.8), ylim=(-1.3, 1.6), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend()
    return figure


def evaluation_figure() -> Figure:
    """Draw the expected view behind known obstacles in three headings, and its NI (figure 3-8)."""
    world = build_world(PlanarTrial("unstructured", 5, "information"))
    sensor, grid = RangeSensor(), world.grid
    model = PlanarMap(grid)
    angles = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    scans = [scan(world.occupied, grid, world.start, angle, sensor) for angle in angles]
    facing = int(np.argmax([seen.hit.sum() for seen in scans]))
    model.insert(scans[facing].passed, scans[facing].hit)
    opaque = model.states() == State.OCCUPIED
    table = fan(sensor.depth, grid.cell, 240)
    ground = KnownGround(model.probability(), model.measured, opaque)
    readings = {
        name: new_information(name, ground, np.array([world.start]), table, sensor, HEADINGS)[0]
        for name in READINGS
    }
    x, y = grid.centre(world.start)
    half, reach = float(np.degrees(sensor.fov)) / 2.0, 1.2 * sensor.depth
    figure = Figure(figsize=(15, 5))
    for axes, turn in zip(figure.subplots(1, 3), (facing, facing + 3, facing + 6)):
        heading = float(2.0 * np.pi * turn / HEADINGS)
        seen = expected_view(opaque, world.start, heading, sensor.fov, table)
        picture = np.where(model.measured, 0.65, 1.0)
        picture[seen & ~model.measured] = 0.85
        picture[opaque] = 0.0
        draw_picture(axes, picture, grid)
        middle = float(np.degrees(heading))
        edges = (middle - half, middle + half)
        axes.add_patch(Wedge((x, y), sensor.depth, *edges, fill=False, color="r"))
        axes.set(xlim=(x - reach, x + reach), ylim=(y - reach, y + reach))
        values = (f"{name} {value[turn % HEADINGS]:.2f}" for name, value in readings.items())
        axes.set_title(f"NI: {', '.join(values)}", fontsize="small")
    return figure
