"""Figures 3-22 and 3-25 to 3-27: the scene, how its map grows, and what was seen and mapped."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from controllers.mapping.stereo_view import StereoView
from experiments.ch3.stereo.scene import StereoScene, left_name, look_at
from experiments.harness.figure_style import COLOURS
from perception.geometry.arrays import FloatArray
from perception.stereo.geometry import StereoGeometry
from twin.camera import renderer

_PANORAMA = (720, 300)
"""Columns over all azimuths, rows from 75 degrees below the horizon to 75 above."""


def scene_figure(scene: StereoScene) -> Figure:
    """Draw the scene with its rovers, from behind them (figure 3-22); moves the free rig."""
    target = scene.transform_panel_to_world.translation
    scene.set_rig(look_at(target + [0.5, -3.2, 1.9], target + [0.0, -0.5, -0.1]))
    image = renderer().render(scene.model, scene.data, left_name(), 1020, 984)
    figure = Figure(figsize=(6.4, 6.2))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(image)
    axes.set_axis_off()
    return figure


def growth_figure(curves: Mapping[str, FloatArray]) -> Figure:
    """Draw the map's growth (figure 3-25).

    Args:
        curves: (runs, views, 2) share of the surface [-] and occupied voxels, by method.
    """
    figure = Figure(figsize=(11, 4.5), layout="constrained")
    labels = ("share of the visible surface mapped [-]", "mapped points (voxels of 5 mm)")
    for column, (axes, label) in enumerate(zip(figure.subplots(1, 2), labels, strict=True)):
        for method, runs in curves.items():
            values = runs[:, :, column]
            views = np.arange(1, values.shape[1] + 1)
            colour = COLOURS[method]
            axes.plot(views, np.median(values, axis=0), color=colour, label=method)
            low, high = values.min(axis=0), values.max(axis=0)
            axes.fill_between(views, low, high, color=colour, alpha=0.15)
        axes.set(xlabel="scans of both robots", ylabel=label, ylim=(0.0, None))
        axes.grid(alpha=0.3)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3,
        title="median and range of the scenes",
    )  # fmt: skip
    return figure


def views_figure(panoramas: NDArray[np.float32], counts: Sequence[int]) -> Figure:
    """Draw all left images of each robot where they were taken (figures 3-26 a, 3-27 a).

    Args:
        panoramas: (robots, rows, columns) as `panorama`.
        counts: (robots,) how many images are in it.
    """
    figure = Figure(figsize=(11, 4.6 * len(counts)), layout="constrained")
    rows = np.atleast_1d(figure.subplots(len(counts), 1))
    for number, (axes, shown, count) in enumerate(zip(rows, panoramas, counts, strict=True)):
        axes.imshow(shown, cmap="gray", vmin=0, vmax=255, extent=(-180, 180, -75, 75))
        axes.set(
            title=f"rover{number + 1}: {count} left images",
            xlabel="azimuth in the map [deg]",
            ylabel="elevation [deg]",
        )
    return figure


def panorama(views: Sequence[StereoView], geometry: StereoGeometry) -> FloatArray:
    """Return what was seen by direction, NaN where nobody looked; later views on top.

    Args:
        views: Views whose camera pose is known.
        geometry: Geometry of the cameras.
    """
    width, height = _PANORAMA
    canvas = np.full((height, width), np.nan)
    for view in views:
        assert view.correction is not None
        pose = view.correction.camera.transform_camera_to_world
        image = view.pair[0]
        world = pose.rotation.apply(geometry.directions())
        azimuth = np.rad2deg(np.arctan2(-world[:, 0], world[:, 1]))
        elevation = np.rad2deg(np.arcsin(np.clip(world[:, 2], -1.0, 1.0)))
        across = ((180.0 - azimuth) / 360.0 * width).astype(int) % width
        down = ((75.0 - elevation) / 150.0 * height).astype(int)
        inside = (down >= 0) & (down < height)
        canvas[down[inside], across[inside]] = image.ravel()[inside]
    return canvas


def points_figure(surface: FloatArray) -> Figure:
    """Draw the map's surface (N, 3) [m] from above and from the side (figures 3-26 b, 3-27 b)."""
    points = surface[np.argsort(surface[:, 2])]
    figure = Figure(figsize=(11, 5.5), layout="constrained")
    above, side = figure.subplots(1, 2, width_ratios=[1, 1])
    for axes, (first, second) in ((above, (0, 1)), (side, (0, 2))):
        drawn = axes.scatter(
            points[:, first],
            points[:, second],
            s=0.3,
            c=points[:, 2],
            cmap="viridis",
            linewidths=0,
            rasterized=True,
        )
        axes.set(xlabel="x [m], along the panel", aspect="equal")
        axes.grid(alpha=0.3)
    above.set(ylabel="y [m], into the panel", title=f"{len(points)} points, from above")
    side.set(ylabel="z [m]", title="from the robots' side")
    figure.colorbar(drawn, ax=[above, side], label="height [m]", shrink=0.6)
    return figure
