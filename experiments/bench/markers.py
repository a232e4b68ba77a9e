"""Both marker detectors beside OpenCV's circles, and the poses that come out, on rendered pairs.

`fiducials` then sets the circles beside ArUco and AprilTag.
"""

import functools
import math

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse
from numpy.typing import NDArray

from experiments.bench.bench_options import Options
from experiments.bench.fiducials import bench_fiducials
from experiments.ch3.stereo.scene import HEAD
from experiments.ch5.marker_scene import MarkerScene, MarkerView, expectation, normal_prior
from experiments.harness.figure_style import BLUE, ORANGE, RED
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.timing import compare
from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.bodies import DETECTORS, MarkerPairs, match_bodies, triangulate
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

RANGES = (0.35, 0.5, 0.7, 0.9, 1.1)
"""Distances from the cameras to the middle of the markers [m]."""
QUICK_RANGES = (0.35, 0.5, 1.1)
SLANTS = (0.0, 20.0, 40.0, 60.0)
"""Angles between the markers' normal and the line of sight [deg]."""
VIEWS, QUICK_VIEWS = 12, 1
"""Number of pairs of each range and slant."""
HEAD_ON = (0.5, 0.0)
_FAR = 3.0  # Largest distance of a detection from the marker that it belongs to [px].


Crop = tuple[float, float, float, float]
"""Left, right, bottom and top of a part of an image [px]."""


def hough_peer(image: ImageArray, view: MarkerView) -> FloatArray:
    """Return (N, 2) centres [px] by ``cv2.HoughCircles``, on square pixels and with known radii."""
    stretch = HEAD.fy / HEAD.fx
    size = round(HEAD.width * stretch), HEAD.height
    wide = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    least, most = expectation(view.distance).radii(HEAD)
    circles = cv2.HoughCircles(
        wide, cv2.HOUGH_GRADIENT, 1.0, 4.0 * least, param1=150.0, param2=8.0,
        minRadius=max(1, int(0.5 * least)), maxRadius=math.ceil(most) + 1,
    )  # fmt: skip
    if circles is None:
        return np.empty((0, 2))
    found = np.asarray(circles, dtype=float).reshape(-1, 3)[:, :2]
    return (found + 0.5) * [HEAD.width / size[0], 1.0] - 0.5


def hough_pair(view: MarkerView) -> list[FloatArray]:
    """Return the centres that `hough_peer` finds in the left and in the right image."""
    return [hough_peer(image, view) for image in view.pair]


def detect_pair(detector: str, view: MarkerView, scene: MarkerScene) -> list[Markers]:
    """Return the markers that one of our detectors finds in the left and in the right image."""
    expected = expectation(view.distance)
    return [DETECTORS[detector](image, scene.geometry, expected) for image in view.pair]


def centre_errors(centres: FloatArray, truth: FloatArray) -> FloatArray:
    """Return (M,) distances of the true centres to the nearest found [px], NaN where none is."""
    if not len(centres):
        return np.full(len(truth), np.nan)
    away = np.linalg.norm(truth[:, None, :2] - centres, axis=2).min(axis=1)
    return np.where(away < _FAR, away, np.nan)


def bench_markers(options: Options, output: Output) -> None:
    """Detect markers in rendered pairs by both detectors and by OpenCV, and find the bodies.

    Figures 5-5 to 5-10 show the steps of the thesis' detector on the first head-on image. The same
    bodies with tags follow in `bench_fiducials`.

    Args:
        options: ``quick`` takes fewer views.
        output: Receives ``marker_error_px/*``, ``marker_ms/*``, ``pose_error_mm/*`` and more.
    """
    seed = options.job_seeds(1, 1)[0]
    scene = MarkerScene(np.random.default_rng(seed))
    count = QUICK_VIEWS if options.quick else VIEWS
    views = [
        scene.view(distance, slant)
        for distance in (QUICK_RANGES if options.quick else RANGES)
        for slant in SLANTS
        for _ in range(count)
    ]
    _draw(views, scene, output)
    _centres(views, scene, output)
    _times(views, scene, output)
    _poses(views, scene, seed, output)
    bench_fiducials(options, output)


def _draw(views: list[MarkerView], scene: MarkerScene, output: Output) -> None:
    """Draw the steps on the left image at half a metre, head on."""
    view = next(view for view in views if (view.distance, view.slant) == HEAD_ON)
    expected = expectation(view.distance)
    found = DETECTORS["tht"](view.pair[0], scene.geometry, expected)
    if not len(found):
        return
    for name, figure in draw_steps(view.pair[0], scene.geometry, expected, found).items():
        output.figure(name, figure)


def _centres(views: list[MarkerView], scene: MarkerScene, output: Output) -> None:
    """Measure the errors of the centres, and how many are missed."""
    errors: dict[str, list[FloatArray]] = {"tht": [], "blob": [], "cv2_hough": []}
    extra, nees = {"tht": 0, "blob": 0}, {"tht": [], "blob": []}
    rows = []
    for view in views:
        expected = expectation(view.distance)
        for image, truth in zip(view.pair, view.ellipses, strict=True):
            for name, detect in DETECTORS.items():
                markers = detect(image, scene.geometry, expected)
                away = centre_errors(markers.centres, truth)
                errors[name].append(away)
                extra[name] += len(markers) - int(np.isfinite(away).sum())
                for ellipse in truth[np.isfinite(away)]:
                    k = np.argmin(np.linalg.norm(markers.centres - ellipse[:2], axis=1))
                    off = markers.centres[k] - ellipse[:2]
                    nees[name].append(off @ np.linalg.solve(markers.centre_covariances[k], off) / 2)
            errors["cv2_hough"].append(centre_errors(hough_peer(image, view), truth))
        rows.append((view.distance, view.slant, *(np.nanmedian(np.concatenate(e[-2:])) if
                     np.isfinite(np.concatenate(e[-2:])).any() else np.nan
                     for e in errors.values())))  # fmt: skip
    output.table("marker_errors", ("range_m", "slant_deg", "tht_px", "blob_px", "cv2_px"), rows)
    for name, lists in errors.items():
        values = np.concatenate(lists)
        output.measure(f"marker_error_px/{name}", distribution(values[np.isfinite(values)]))
        output.measure(f"marker_found_fraction/{name}", float(np.mean(np.isfinite(values))))
    for name in DETECTORS:
        output.measure(f"marker_false_per_image/{name}", extra[name] / (2 * len(views)))
        output.measure(f"marker_nees/{name}", float(np.mean(nees[name])))
        median = float(np.nanmedian(np.concatenate(errors[name])))
        output.check(f"markers, centroid error, {name} [px]", median, "<= 0.1", median <= 0.1)
    peer = float(np.nanmedian(np.concatenate(errors["cv2_hough"])))
    ratio = peer / float(np.nanmedian(np.concatenate(errors["tht"])))
    output.measure("marker_error_ratio/cv2_over_tht", ratio)
    output.check("markers, cv2.HoughCircles' error over the THT's", ratio, ">= 5", ratio >= 5.0)


def _times(views: list[MarkerView], scene: MarkerScene, output: Output) -> None:
    """Time both detectors and OpenCV's on the same pairs."""
    spent: dict[str, list[float]] = {"tht": [], "blob": [], "cv2_hough": []}
    for view in views:
        for name in DETECTORS:
            ours = functools.partial(detect_pair, name, view, scene)
            times = compare(ours, functools.partial(hough_pair, view), 1)
            spent[name].append(1e3 * times["ours_s"]["median"])
            spent["cv2_hough"].append(1e3 * times["peer_s"]["median"])
    for name, values in spent.items():
        output.measure(f"marker_ms/{name}", distribution(values))
        median = float(np.median(values))
        if name in DETECTORS:
            output.check(f"markers, a pair, {name} [ms]", median, "<= 15", median <= 15.0)
    ratio = float(np.median(spent["cv2_hough"]) / np.median(spent["tht"]))
    output.measure("marker_time_ratio/cv2_over_tht", ratio)
    output.check("markers, cv2.HoughCircles' time over the THT's", ratio, ">= 1", ratio >= 1.0)


def _poses(views: list[MarkerView], scene: MarkerScene, seed: int, output: Output) -> None:
    """Measure the bodies' poses with and without a prior of the normal."""
    for detector in DETECTORS:
        pairs = []
        for view in views:
            left, right = detect_pair(detector, view, scene)
            pairs.append(triangulate(left, right, scene.geometry, expectation(view.distance)))
        for known in ("alone", "tilt_known"):
            # Both detectors get the same priors.
            rng = np.random.default_rng((seed, 1))
            _poses_of(views, pairs, scene, f"{detector}/{known}", rng, output)


def _poses_of(
    views: list[MarkerView],
    pairs: list[MarkerPairs],
    scene: MarkerScene,
    key: str,
    rng: np.random.Generator,
    output: Output,
) -> None:
    rows: list[tuple[float, float, float]] = []
    head_on: list[float] = []
    for view, markers in zip(views, pairs, strict=True):
        priors = [
            normal_prior(body, rng) if key.endswith("known") else None for body in view.bodies
        ]
        expected = expectation(view.distance)
        fits = match_bodies(markers, scene.geometry, scene.cads, expected, priors)
        for fit, truth, cad in zip(fits, view.bodies, scene.cads, strict=True):
            if fit is None:
                continue
            twist = (truth * fit.transform_body_to_camera.inv()).as_exp_coords()
            nees = float(twist @ np.linalg.solve(fit.covariance, twist)) / 6.0
            middle = cad.points.mean(axis=0)
            off = fit.transform_body_to_camera.apply(middle) - truth.apply(middle)
            turn = math.degrees(float(np.linalg.norm(twist[:3])))
            rows.append((1e3 * float(np.linalg.norm(off)), turn, nees))
            if (view.distance, view.slant) == HEAD_ON:
                head_on.append(rows[-1][0])
    output.measure(f"pose_found_fraction/{key}", len(rows) / (2 * len(views)))
    for name, values in zip(("error_mm", "turn_deg", "nees"), zip(*rows), strict=True):
        output.measure(f"pose_{name}/{key}", distribution(values))
    output.measure(f"pose_error_mm/head_on_0.5m/{key}", distribution(head_on))
    median = float(np.median(head_on)) if head_on else math.nan
    text = f"markers, head-on pose at 0.5 m, {key} [mm]"
    output.check(text, median, "<= 0.2", median <= 0.2)


def draw_steps(
    image: ImageArray, geometry: StereoGeometry, expected: MarkerExpectation, found: Markers
) -> dict[str, Figure]:
    """Draw the result of each step of the detector on an image.

    Args:
        image: (H, W) uint8.
        geometry: Geometry of the camera.
        expected: Sizes and range of the markers.
        found: Markers that `detect_hough` found in it, at least one.

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
        ("specks removed", kept),
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


def _show(axes: Axes, image: NDArray[np.generic], title: str, around: Crop | None = None) -> None:
    """Show an image, or a part of it."""
    axes.imshow(image, cmap="gray", interpolation="nearest")
    axes.set_title(title, fontsize="small")
    axes.set_axis_off()
    if around is not None:
        axes.axis(around)


def _plain(image: ImageArray, title: str) -> Figure:
    figure = Figure(figsize=(5, 5))
    _show(figure.add_subplot(), image, title)
    return figure


def _around(found: Markers, shape: tuple[int, ...]) -> Crop:
    """Return left, right, bottom and top of a frame about all markers [px]."""
    low, high = found.centres.min(axis=0) - 25.0, found.centres.max(axis=0) + 25.0
    low, high = np.maximum(low, 0.0), np.minimum(high, [shape[1] - 1.0, shape[0] - 1.0])
    (left, top), (right, bottom) = low.tolist(), high.tolist()
    return left, right, bottom, top


def _histograms(laplacian: ImageArray, blurred: ImageArray) -> Figure:
    figure = Figure(figsize=(9, 3), layout="tight")
    pictures = ("after the Laplacian", laplacian), ("after the low pass", blurred)
    for axes, (name, image) in zip(figure.subplots(1, 2), pictures, strict=True):
        counts = np.asarray(cv2.calcHist([image], [0], None, [256], [0, 256])).ravel()
        axes.bar(np.arange(256), counts, width=1.0)
        cut = int(np.argmax(counts)) - BELOW_PEAK
        axes.axvline(cut, color=RED, label=f"peak less {BELOW_PEAK}")
        axes.set(yscale="log", xlabel="grey level", ylabel="pixels", title=name)
        axes.legend()
    return figure


def _reduction(
    image: ImageArray,
    steps: list[tuple[str, NDArray[np.generic]]],
    around: Crop,
) -> Figure:
    figure = Figure(figsize=(12, 8), layout="tight")
    whole, *panels = figure.subplots(2, 3).flat
    _show(whole, equalise(image), "equalised")
    for axes, (name, picture) in zip(panels, steps, strict=True):
        _show(axes, picture, name, around)
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
    figure = Figure(figsize=(5, 5))
    axes = figure.add_subplot()
    axes.plot(*points.T, "s", color="0.75", label="rim points")
    axes.plot(*np.array(chosen).T, "o", color=RED, label="three of them")
    axes.add_patch(Circle((x, y), radius, fill=False, color=BLUE))
    axes.plot(x, y, "+", color=BLUE, label="centre (eq. 5-7)")
    for first, second in ((0, 1), (1, 2)):
        half = 0.5 * (chosen[first] + chosen[second])
        axes.plot([half[0], x], [half[1], y], ":", color=BLUE)
    axes.set_title(
        f"radius {radius:.2f} px, bisectors at {np.degrees(turn):.0f} deg", fontsize="small"
    )
    axes.set(xlabel="column, square pixels", ylabel="row", aspect="equal")
    axes.invert_yaxis()
    axes.legend()
    return figure


def _found(
    image: ImageArray,
    geometry: StereoGeometry,
    circles: FloatArray,
    found: Markers,
    around: Crop,
) -> Figure:
    figure = Figure(figsize=(10, 5), layout="tight")
    left, right = figure.subplots(1, 2)
    _show(left, image, f"circles by the Hough transform, above {LEAST_COVERAGE:.0%}", around)
    for column, row, radius, coverage in circles:
        if coverage > LEAST_COVERAGE:
            width = 2.0 * radius * geometry.fx / geometry.fy
            left.add_patch(Ellipse((column, row), width, 2.0 * radius, fill=False, color=ORANGE))
    _show(right, image, "markers by region growing", around)
    for (column, row), (major, minor), angle in zip(
        found.centres, found.axes, found.angles, strict=True
    ):
        right.add_patch(
            Ellipse((column, row), 2 * major, 2 * minor, angle=float(np.degrees(angle)), fill=False,
                    color=RED)
        )  # fmt: skip
        right.plot(column, row, "+", color=RED)
    return figure
