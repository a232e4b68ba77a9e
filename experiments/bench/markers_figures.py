"""Figures 5-5, 5-7, 5-8, 5-9 and 5-10: the steps of the thesis' marker detector on one image."""

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.ellipses import MarkerExpectation, Markers
from perception.markers.hough import (
    BELOW_PEAK,
    LEAST_COVERAGE,
    black_markers,
    circle_of_three,
    drop_specks,
    equalise,
    fewest_pixels,
    hough_circles,
    low_pass,
    rim_points,
    signed_laplacian,
    threshold_level,
)
from perception.stereo.geometry import StereoGeometry


def draw_steps(
    image: ImageArray, geometry: StereoGeometry, expected: MarkerExpectation, found: Markers
) -> dict[str, Figure]:
    """Draw what each step makes of an image.

    Args:
        image: (H, W) uint8.
        geometry: Geometry of the camera.
        expected: Sizes and range of the markers.
        found: What `detect_hough` found in it, at least one.

    Returns:
        Figures by name.

    Raises:
        ValueError: If nothing was found.
    """
    if not len(found):
        raise ValueError("marker figures: no marker was found in the image, needs at least one")
    level = threshold_level(image, geometry, expected)
    black = black_markers(image, level)
    kept = drop_specks(black, fewest_pixels(geometry, expected))
    laplacian = signed_laplacian(kept)
    blurred = low_pass(laplacian)
    rims = rim_points(blurred)
    circles = hough_circles(rims, geometry, expected)
    reduced = [
        (f"equalised and cut at grey level {level}", black),
        ("specks dropped", kept),
        ("Laplacian about mid-grey", laplacian),
        ("low pass", blurred),
        ("cut below the peak: rim points", ~rims),
    ]
    around = _around(found, image.shape)
    return {
        "figure_5-5": _plain(image, "card and slot with their markers"),
        "figure_5-7": _histograms(laplacian, blurred),
        "figure_5-8": _reduction(image, reduced, around),
        "figure_5-9": _three_points(rims, geometry, circles, found),
        "figure_5-10": _found(image, geometry, circles, found, around),
    }


def _canvas(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def _show(axes: Axes, image: NDArray[np.generic], title: str) -> None:
    axes.imshow(image, cmap="gray", interpolation="nearest")
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


def _plain(image: ImageArray, title: str) -> Figure:
    figure = _canvas(5, 5)
    _show(figure.add_subplot(), image, title)
    return figure


def _around(found: Markers, shape: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of a frame about all markers [px]."""
    low, high = found.centres.min(axis=0) - 25.0, found.centres.max(axis=0) + 25.0
    low, high = np.maximum(low, 0.0), np.minimum(high, [shape[1] - 1.0, shape[0] - 1.0])
    return float(low[0]), float(high[0]), float(high[1]), float(low[1])


def _crop(axes: Axes, around: tuple[float, float, float, float]) -> None:
    axes.set_xlim(around[0], around[1])
    axes.set_ylim(around[2], around[3])


def _histograms(laplacian: ImageArray, blurred: ImageArray) -> Figure:
    figure = _canvas(9, 3)
    for number, (name, image) in enumerate(
        (("after the Laplacian", laplacian), ("after the low pass", blurred)), start=1
    ):
        axes = figure.add_subplot(1, 2, number)
        counts = np.asarray(cv2.calcHist([image], [0], None, [256], [0, 256])).ravel()
        axes.bar(np.arange(256), counts, width=1.0)
        cut = int(np.argmax(counts)) - BELOW_PEAK
        axes.axvline(cut, color="tab:red", label=f"peak less {BELOW_PEAK}")
        axes.set(yscale="log", xlabel="grey level", ylabel="pixels", title=name)
        axes.legend()
    figure.tight_layout()
    return figure


def _reduction(
    image: ImageArray,
    steps: list[tuple[str, NDArray[np.generic]]],
    around: tuple[float, float, float, float],
) -> Figure:
    figure = _canvas(12, 8)
    pictures = [("equalised", equalise(image)), *steps]
    for number, (name, picture) in enumerate(pictures, start=1):
        axes = figure.add_subplot(2, 3, number)
        _show(axes, picture, name)
        if number > 1:
            _crop(axes, around)
    figure.tight_layout()
    return figure


def _three_points(
    rims: NDArray[np.bool_], geometry: StereoGeometry, circles: FloatArray, found: Markers
) -> Figure:
    """Draw the circle through three rim points about the first marker, in square pixels."""
    stretch = geometry.fy / geometry.fx
    middle = found.centres[0] * [stretch, 1.0]
    away = np.hypot(circles[:, 0] * stretch - middle[0], circles[:, 1] - middle[1])
    circle = circles[np.argmin(away - circles[:, 3])]
    rows, columns = np.nonzero(rims)
    points = np.column_stack([columns * stretch, rows])
    offsets = points - [circle[0] * stretch, circle[1]]
    near = np.hypot(*offsets.T) < 2.0 * circle[2]
    points, offsets = points[near], offsets[near]
    # The points next to the circle in three directions.
    chosen = []
    for angle in np.radians([20.0, 140.0, 260.0]):
        place = circle[2] * np.array([np.cos(angle), np.sin(angle)])
        chosen.append(points[np.argmin(np.hypot(*(offsets - place).T))])
    x, y, radius, turn = circle_of_three(*np.concatenate(chosen).tolist())
    figure = _canvas(5, 5)
    axes = figure.add_subplot()
    axes.plot(*points.T, "s", color="0.75", label="rim points")
    axes.plot(*np.array(chosen).T, "o", color="tab:red", label="three of them")
    axes.add_patch(Circle((x, y), radius, fill=False, color="tab:blue"))
    axes.plot(x, y, "+", color="tab:blue", label="centre (eq. 5-7)")
    for first, second in ((0, 1), (1, 2)):
        half = 0.5 * (chosen[first] + chosen[second])
        axes.plot([half[0], x], [half[1], y], ":", color="tab:blue")
    axes.set_title(f"radius {radius:.2f} px, bisectors at {np.degrees(turn):.0f} deg", fontsize=9)
    axes.set(xlabel="column, square pixels", ylabel="row", aspect="equal")
    axes.invert_yaxis()
    axes.legend(fontsize=8)
    return figure


def _found(
    image: ImageArray,
    geometry: StereoGeometry,
    circles: FloatArray,
    found: Markers,
    around: tuple[float, float, float, float],
) -> Figure:
    figure = _canvas(10, 5)
    axes = figure.add_subplot(1, 2, 1)
    _show(axes, image, f"circles by the Hough transform, above {LEAST_COVERAGE:.0%}")
    for column, row, radius, coverage in circles:
        if coverage > LEAST_COVERAGE:
            width = 2.0 * radius * geometry.fx / geometry.fy
            axes.add_patch(
                Ellipse((column, row), width, 2.0 * radius, fill=False, color="tab:orange")
            )
    _crop(axes, around)
    axes = figure.add_subplot(1, 2, 2)
    _show(axes, image, "markers by region growing")
    for (column, row), (major, minor), angle in zip(
        found.centres, found.axes, found.angles, strict=True
    ):
        axes.add_patch(
            Ellipse((column, row), 2 * major, 2 * minor, angle=float(np.degrees(angle)), fill=False,
                    color="tab:red")
        )  # fmt: skip
        axes.plot(column, row, "+", color="tab:red")
    _crop(axes, around)
    figure.tight_layout()
    return figure
