"""Pictures of ch4-stereo."""

# matplotlib's 3-D axes are typed as plain ones.
# pyright: reportAttributeAccessIssue=false

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from controllers.placement.spatial.field import signed_caps
from controllers.placement.spatial.occluders import TargetField
from controllers.placement.spatial.search import rate_positions, spherical
from controllers.placement.task import Lens, View
from experiments.ch4.spatial.search import SpatialSearch, SpatialSearchTrial
from models.blocks import Arrangement
from models.datasheets import CAMERA, INCH
from perception.geometry.arrays import FloatArray

_COLOURS = ("#bf7330", "#4073b3", "#599959", "#b3a64d")


def wall_curve(field: TargetField, lens: Lens, view: View) -> Figure:
    """Draw the rating over the elevation, and the closed form."""
    elevation = np.linspace(0.01, np.pi - 0.01, 400)
    places = lens.near * np.column_stack([np.cos(elevation), 0.0 * elevation, np.sin(elevation)])
    rated = rate_positions(field, lens, field.to_world(places))
    closed = np.sin(elevation) * np.clip(np.minimum(elevation, 2 * np.pi / 3 - elevation), 0, None)
    closed /= lens.near * lens.pixel_per_metre
    figure = Figure(figsize=(6.5, 4))
    axes = figure.add_subplot()
    degrees = np.rad2deg(elevation)
    axes.plot(degrees, [v.rating for v in rated], linewidth=3, alpha=0.5, label="by the hulls")
    axes.plot(degrees, closed, "k--", linewidth=1, label="sin(phi) min(phi, 120 deg - phi) Res")
    found = np.rad2deg(spherical(field, view.position)[2])
    axes.plot(found, view.rating, "ro", label=f"found: {found:.2f} deg")
    axes.axvline(60.0, color="grey", linewidth=0.5)
    axes.set(xlabel="elevation at azimuth 0, 5 inches off [deg]", ylabel="rating [1/m]")
    axes.set_ylim(0.0, 1.35 * view.rating)
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def scene(
    field: TargetField, view: View, cloud: tuple[FloatArray, FloatArray], arrangement: Arrangement
) -> Figure:
    """Draw the blocks, the expanded hulls, the rating as a cloud, and the chosen pose."""
    figure = Figure(figsize=(12, 6))
    for index, title in enumerate(("arrangement and rating", "expanded hulls")):
        axes = figure.add_subplot(1, 2, index + 1, projection="3d")
        if index == 0:
            for block, colour in zip(arrangement.blocks, itertools.cycle(_COLOURS)):
                _solid(axes, 1e3 * block.corners, colour, 0.55)
            points, ratings = cloud
            good = ratings > 0.0
            order = np.argsort(ratings[good])
            dots = axes.scatter(
                *(1e3 * points[good][order]).T, c=ratings[good][order], s=4, cmap="viridis",
                alpha=0.5,
            )  # fmt: skip
            figure.colorbar(dots, ax=axes, shrink=0.6, pad=0.13, label="rating [1/m]")
        else:
            for shape, colour in zip(field.shapes, itertools.cycle(_COLOURS)):
                _solid(axes, 1e3 * shape, colour, 0.35)
        rim = 1e3 * (field.target.position + field.target.outline)
        axes.add_collection3d(Poly3DCollection([rim], facecolor="k"))
        line = 1e3 * np.array([field.target.position, view.position])
        axes.plot(*line.T, "r-", linewidth=1.5)
        axes.plot(*line[1:].T, "r^", markersize=8)
        axes.set(xlim=(-180, 200), ylim=(-190, 190), zlim=(-20, 260), title=title)
        axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
        axes.set_box_aspect((1, 1, 280 / 380))
        axes.view_init(elev=28, azim=-50)
    distance, azimuth, elevation = spherical(field, view.position)
    figure.suptitle(
        f"optimal pose: r = {distance / INCH:.2f} in, theta = {np.rad2deg(azimuth):.1f} deg, "
        f"phi = {np.rad2deg(elevation):.1f} deg"
    )
    return figure


def hull_edges(points: FloatArray) -> list[FloatArray]:
    """Return the ends (2, 3) of each edge of points' hull (N, 3) at which its surface bends."""
    hull = ConvexHull(points)
    normals = hull.equations[:, :3]
    return [
        points[np.delete(hull.simplices[face], corner)]
        for face, row in enumerate(hull.neighbors)
        for corner, other in enumerate(row)
        if other > face and normals[face] @ normals[other] < 0.999  # noqa: PLR2004
    ]


def _solid(axes: Any, points: FloatArray, colour: str, opacity: float) -> None:
    faces = points[ConvexHull(points).simplices]
    axes.add_collection3d(
        Poly3DCollection(faces, facecolor=colour, alpha=opacity, edgecolor="none")
    )
    for edge in hull_edges(points):
        axes.plot(*edge.T, color="k", linewidth=0.4, alpha=0.6)


def sphere(field: TargetField, view: View, lens: Lens) -> Figure:
    """Draw the sphere about the target from above: the free cap, and what the hulls hide."""
    side = np.linspace(-1.0, 1.0, 401)
    x, y = np.meshgrid(side, side)
    # Equal angles about the normal are equal lengths in the picture.
    far = np.hypot(x, y)
    polar = 0.5 * np.pi * far
    scale = np.where(far > 0, np.sin(polar) / np.maximum(far, 1e-12), 0.0)
    directions = np.stack([x * scale, y * scale, np.cos(polar)], axis=-1)
    figure = Figure(figsize=(11, 5))
    for index, radius in enumerate((view.distance, 2.0 * view.distance)):
        places = field.to_world(radius * directions.reshape(-1, 3))
        caps = np.rad2deg(signed_caps(field, places)).reshape(x.shape)
        shown = np.where(far < 1.0, caps, np.nan)
        axes = figure.add_subplot(1, 2, index + 1)
        image = axes.imshow(
            np.where(shown > 0.0, shown, np.nan), extent=(-90, 90, -90, 90), origin="lower",
            cmap="viridis", vmin=0.0, vmax=90.0,
        )  # fmt: skip
        hidden = np.where(shown <= 0.0, 1.0, np.nan)
        axes.imshow(
            hidden, extent=(-90, 90, -90, 90), origin="lower", cmap="Greys", vmin=0.0, vmax=1.4
        )
        figure.colorbar(image, ax=axes, shrink=0.8, label="target field visibility [deg]")
        axes.contour(90 * side, 90 * side, shown, levels=range(10, 90, 10), colors="w",
                     linewidths=0.5)  # fmt: skip
        if index == 0:
            _, azimuth, elevation = spherical(field, view.position)
            polar_deg = 90.0 - np.rad2deg(elevation)
            spot = polar_deg * np.array([np.cos(azimuth), np.sin(azimuth)])
            axes.plot(*spot, "r^", markersize=9, label="chosen")
            axes.legend(loc="lower left")
        axes.set(title=f"sphere of {radius / INCH:.1f} in, hidden in grey")
        axes.set(xlabel="off the normal, along x [deg]", ylabel="along y [deg]")
    return figure


def pictures(
    views: Sequence[View], images: Sequence[NDArray[np.uint8]], names: Sequence[str]
) -> Figure:
    """Show the pictures of the target by several cameras."""
    figure = Figure(figsize=(3.6 * len(views), 4.2))
    for index, (view, image, name) in enumerate(zip(views, images, names)):
        axes = figure.add_subplot(1, len(views), index + 1)
        # Pixels are wider than high.
        axes.imshow(image, aspect=CAMERA.pinhole.fx / CAMERA.pinhole.fy)
        axes.set_title(f"{name}\n{view.distance / INCH:.1f} in, rating {view.rating:.0f} per m")
        axes.axis("off")
    return figure


def searches(
    trials: Sequence[SpatialSearchTrial], results: Sequence[SpatialSearch], hull: NDArray[Any],
    exact: NDArray[Any], far: FloatArray,
) -> Figure:  # fmt: skip
    """Draw both searches' times over the number of occluders, and the views lost by the hulls."""
    figure = Figure(figsize=(11, 4))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for key, name in (("slow_s", "every candidate"), ("fast_s", "best first")):
        for patchy, marker in ((False, "o"), (True, "x")):
            chosen = [(t.occluders, 1e3 * getattr(r, key)) for t, r in zip(trials, results)
                      if t.patchy == patchy]  # fmt: skip
            if chosen:
                label = f"{name}{', map' if patchy else ''}"
                left.plot(*np.array(chosen).T, marker, markersize=4, alpha=0.7, label=label)
    left.set(yscale="log", xlabel="solids", ylabel="search of 81920 poses [ms]")
    bins = np.linspace(far.min(), far.max(), 7)
    which = np.clip(np.digitize(far, bins) - 1, 0, len(bins) - 2)
    middles = 0.5 * (bins[1:] + bins[:-1]) / INCH
    for name, values in (("visible", exact), ("visible by the hulls", hull)):
        share = [100.0 * values[which == k].mean() if np.any(which == k) else np.nan
                 for k in range(len(middles))]  # fmt: skip
        right.plot(middles, share, "o-", label=name)
    right.set(xlabel="distance of the camera [in]", ylabel="views that see the whole target [%]")
    right.set_ylim(0, None)
    left.set_ylim(None, 5e3)
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend()
    left.legend(loc="upper left", ncols=2, columnspacing=0.8)
    return figure


def seen(optimal: FloatArray, others: FloatArray, pixels: FloatArray, drawn: FloatArray) -> Figure:
    """Draw how much of the hole planned and random cameras see, in part and in pixels."""
    figure = Figure(figsize=(11, 4))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    bins = np.linspace(0.0, 100.0, 21).tolist()
    for values, name in ((others, "random poses"), (optimal, "planned poses")):
        weights = np.full(len(values), 100.0 / len(values))
        left.hist(100 * values, bins, weights=weights, alpha=0.6, label=name)
    left.set(xlabel="part of the hole that is seen [%]", ylabel="poses [%]")
    for values, name in ((drawn, "random poses"), (pixels, "planned poses")):
        ordered = np.sort(values)
        share = 100.0 * np.arange(1, len(ordered) + 1) / len(ordered)
        right.step(ordered, share, where="post", label=name)
    right.set(xlabel="pixels of the hole that are seen", ylabel="poses with no more [%]")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend()
    return figure
