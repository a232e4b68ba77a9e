"""``ch3-stereo``: two rovers map a cluttered field with stereo heads on their arms.

Four parts, each of which can be run alone: the noise of stereo, the camera's motion by fiducials,
the growth of the map under three methods to choose views, and the gain of two robots that
triangulate together. The truth only scores. Mapping drives robots, simulated or behind emulated
boards; the other three parts set cameras or draw points themselves, and need none.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from controllers.mapping.stereo_view import METHODS
from experiments.ch3.motion.cooperative import measure_cooperation
from experiments.ch3.motion.motion import measure_motion
from experiments.ch3.motion.rendered import measure_rendered_motion
from experiments.ch3.stereo.figures import growth_figure, points_figure, scene_figure, views_figure
from experiments.ch3.stereo.noise import measure_noise
from experiments.ch3.stereo.record import record_map
from experiments.ch3.stereo.scene import StereoScene
from experiments.ch3.stereo.stereo_options import PARTS, Options
from experiments.ch3.stereo.trial import MappingRun, MappingTrial, run_trial
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.recording import RunFiles
from experiments.harness.sweep import sweep
from perception.voxels.files import export_mesh, export_points

SCENES, QUICK_SCENES = 6, 1
SCANS, QUICK_SCANS = 12, 3
RATIO_BOUND = 1.25
NEES_BOUNDS = (0.5, 2.0)
FIGURE = {"raster": "figure_3-26", "information": "figure_3-27"}


def run(options: Options, output: Output) -> None:
    """Run the chosen parts.

    Args:
        options: ``quick`` takes fewer scenes, scans and repetitions.
        output: Receives the metrics of all parts.
    """
    for part in options.parts or PARTS:
        _MEASURES[part](options, output)


def measure_all_motion(options: Options, output: Output) -> None:
    """Measure the camera's motion by fiducials, in geometry alone and on rendered pairs."""
    measure_motion(options, output)
    measure_rendered_motion(options, output)


def measure_mapping(options: Options, output: Output) -> None:
    """Let two rovers map scenes by each method to choose views, and compare at equal scans.

    Args:
        options: ``seeds`` scenes, 6 by default; ``quick`` takes 1, and no random views.
        output: Receives ``surface_ratio/information_over_raster``, ``nees`` and the quantities
            behind them.

    Raises:
        ExperimentError: If no robot found the target in any scene.
    """
    scans = options.scans or (QUICK_SCANS if options.quick else SCANS)
    seeds = options.job_seeds(SCENES, QUICK_SCENES)
    methods = METHODS[:2] if options.quick else METHODS
    configs = [
        MappingTrial(seed, method, scans, seed == seeds[0] and method in FIGURE, options.robot)
        for seed in seeds
        for method in methods
    ]
    results = sweep(run_trial, configs, options, output, label="scenes mapped")
    scenes = [results[i : i + len(methods)] for i in range(0, len(results), len(methods))]
    mapped = [scene for scene in scenes if all(run.located for run in scene)]
    output.measure("mapped_scenes_fraction", fraction(len(mapped), len(scenes)))
    if not mapped:
        raise ExperimentError("no robot found the target in any scene; try another --seed")
    runs = dict(zip(methods, map(list, zip(*mapped)), strict=True))
    curves = {method: _aligned([r.curve for r in runs[method]], scans) for method in methods}
    for method in methods:
        output.measure(f"surface_share/{method}", distribution(curves[method][:, -1, 0]))
        output.measure(f"points_mapped/{method}", distribution(curves[method][:, -1, 1]))
        output.measure(f"nees/{method}", distribution([float(r.nees.mean()) for r in runs[method]]))
        guess, corrected = np.hstack([r.camera_errors for r in runs[method]])
        output.measure(f"camera_error_mm/{method}/arm", distribution(1e3 * guess))
        output.measure(f"camera_error_mm/{method}/corrected", distribution(1e3 * corrected))
        shares = [r.corrected_share for r in runs[method]]
        output.measure(f"corrected_share/{method}", distribution(shares))
    output.measure("located_fraction", fraction(sum(r.located for r in results), 2 * len(results)))
    turns = [1e3 * r.frame_turn for r in results if r.located]
    output.measure("frame_turn_mrad", distribution(turns))
    output.measure("surface_nowhere_near_share/worst", max(r.lost_share for r in results))
    _compare(curves, runs["information"], output)
    output.figure("figure_3-25", growth_figure(curves))
    _show(dict(zip(methods, results, strict=False)), seeds[0], output)
    files = RunFiles.of(options, output)
    if files:
        trial = MappingTrial(seeds[0], "information", scans, robot=options.robot)
        voxels = record_map(trial, files)
        if len(voxels.surface().means):  # Else no robot has found the target.
            export_points(voxels, output.file("map_points.ply"))
            export_mesh(voxels, output.file("map_mesh.stl"))


def _compare(curves: dict[str, np.ndarray], informed: Sequence[MappingRun], output: Output) -> None:
    """Hold information against the others at equal scans, and its covariances against the truth."""
    for other in [method for method in curves if method != "information"]:
        ratios = curves["information"][:, -1, 0] / curves[other][:, -1, 0]
        output.measure(f"surface_ratio/information_over_{other}", distribution(ratios))
        if other == "raster":
            subject = "surface mapped, information over raster, mean"
            mean = float(ratios.mean())
            output.check(subject, mean, f">= {RATIO_BOUND:g}", mean >= RATIO_BOUND)
    nees = float(np.mean([r.nees.mean() for r in informed]))
    output.measure("nees", nees)
    output.check_within("squared normalised error of fused points", nees, NEES_BOUNDS)


def _aligned(curves: Sequence[np.ndarray], scans: int) -> np.ndarray:
    """Return (runs, views, 2) share and voxels after each view; a run that ended early stays."""
    missing = [2 * scans - len(curve) for curve in curves]
    return np.array([np.pad(c, ((0, n), (0, 0)), "edge") for c, n in zip(curves, missing)])


def _show(runs: Mapping[str, MappingRun], seed: int, output: Output) -> None:
    """Draw one scene, and the views and the map of it by each method."""
    output.figure("figure_3-22", scene_figure(StereoScene(seed)))
    for method, name in FIGURE.items():
        shown = runs[method].shown
        assert shown is not None
        output.figure(f"{name}a", views_figure(shown.panoramas, shown.images))
        output.figure(f"{name}b", points_figure(shown.surface))


_MEASURES: dict[str, Callable[[Options, Output], None]] = dict(
    zip(
        PARTS,
        (measure_noise, measure_all_motion, measure_mapping, measure_cooperation),
        strict=True,
    )
)
