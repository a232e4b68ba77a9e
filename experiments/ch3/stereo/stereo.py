"""``ch3-stereo``: two rovers map a cluttered field with stereo heads on their arms.

Four parts, each of which can be run alone: how certain stereo is, how well the camera's motion is
told by fiducials, how fast the map grows under three ways to choose views, and what two robots gain
by triangulating together. The truth only scores. Mapping drives robots, simulated or behind
emulated boards; the other three parts set cameras or draw points themselves, and need none.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
import tyro

from controllers.mapping.stereo_view import METHODS
from experiments.ch3.motion.cooperative import measure_cooperation
from experiments.ch3.motion.motion import measure_motion
from experiments.ch3.motion.rendered import measure_rendered_motion
from experiments.ch3.stereo.figures import growth_figure, points_figure, scene_figure, views_figure
from experiments.ch3.stereo.noise import measure_noise
from experiments.ch3.stereo.record import MapRecorder
from experiments.ch3.stereo.scene import StereoScene
from experiments.ch3.stereo.trial import MappingRun, MappingTrial, map_scene, run_trial
from experiments.harness import contract
from experiments.harness.contract import ExperimentError, OptionError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.voxels.files import export_mesh, export_points

SCENES, QUICK_SCENES = 6, 1
SCANS, QUICK_SCANS = 12, 3
RATIO_BOUND = 1.25
NEES_BOUNDS = (0.5, 2.0)
FIGURE = {"raster": "figure_3-26", "information": "figure_3-27"}


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of stereo mapping.

    Attributes:
        targets: What the experiment runs on.
        robot: What maps: sim, quantised or emulated. The parts noise, motion and cooperation need
            no robot.
        parts: Which parts to run: noise, motion, mapping, cooperation (unless said, all).
        scans: Looks of each robot (unless said, 12; with --quick, 3).
    """

    targets: ClassVar[tuple[str, ...]] = ("sim", "quantised", "emulated")
    robot: str = "sim"
    parts: tuple[str, ...] = ()
    scans: Annotated[int | None, tyro.conf.arg(metavar="N")] = None

    def __post_init__(self) -> None:
        """Refuse unknown parts.

        Raises:
            OptionError: Naming the part, or as `contract.Options`.
        """
        super().__post_init__()
        for part in self.parts:
            if part not in PARTS:
                raise OptionError(f"--parts {part}: expected some of {', '.join(PARTS)}")
        if self.scans is not None and self.scans < 1:
            raise OptionError(f"--scans: expected at least 1, got {self.scans}")
        if self.robot != "sim" and self.parts and "mapping" not in self.parts:
            raise OptionError(f"--robot {self.robot}: add mapping to --parts; the others need none")
        if self.record and self.parts and "mapping" not in self.parts:
            raise OptionError("--record shows the map: add mapping to --parts")


def run(options: Options, output: Output) -> None:
    """Run the parts that were asked for.

    Args:
        options: ``quick`` takes fewer scenes, scans and repetitions.
        output: Receives the metrics of all parts.
    """
    for part in options.parts or tuple(PARTS):
        PARTS[part](options, output)


def measure_all_motion(options: Options, output: Output) -> None:
    """Measure how well fiducials tell the camera's motion, in geometry and on rendered pairs."""
    measure_motion(options, output)
    measure_rendered_motion(options, output)


def measure_mapping(options: Options, output: Output) -> None:
    """Let two rovers map scenes under each way to choose views, and compare at equal scans.

    Args:
        options: ``seeds`` scenes, 6 unless said; ``quick`` takes 1, and no random views.
        output: Receives ``surface_ratio/information_over_raster``, ``nees`` and what they are
            made of.

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
        pooled = np.concatenate([r.corrected_error for r in runs[method]])
        guessed = np.concatenate([r.guess_error for r in runs[method]])
        output.measure(f"camera_error_mm/{method}/arm", distribution(1e3 * guessed))
        output.measure(f"camera_error_mm/{method}/corrected", distribution(1e3 * pooled))
        shares = [r.corrected_share for r in runs[method]]
        output.measure(f"corrected_share/{method}", distribution(shares))
    located = sum(r.located for r in results)
    output.measure("located_fraction", fraction(located, 2 * len(results)))
    turns = [1e3 * r.frame_turn for r in results if r.located]
    output.measure("frame_turn_mrad", distribution(turns))
    lost = max(r.lost_share for r in results)
    output.measure("surface_nowhere_near_share/worst", lost)
    _compare(curves, runs["information"], output)
    output.figure("figure_3-25", growth_figure(curves))
    _show(dict(zip(methods, results, strict=False)), seeds[0], output)
    if options.record:
        with MapRecorder(output.file("run.rrd")) as recorder:
            trial = MappingTrial(seeds[0], "information", scans, robot=options.robot)
            voxels = map_scene(trial, recorder.take).mapper.shared.voxels
        if len(voxels.surface().means):  # Else no robot has found the target.
            export_points(voxels, output.file("map_points.ply"))
            export_mesh(voxels, output.file("map_mesh.stl"))


def _compare(curves: dict[str, np.ndarray], informed: Sequence[MappingRun], output: Output) -> None:
    """Hold information against the others at equal scans, and its covariances against the truth."""
    for other in [method for method in curves if method != "information"]:
        ratios = curves["information"][:, -1, 0] / curves[other][:, -1, 0]
        output.measure(f"surface_ratio/information_over_{other}", distribution(ratios))
        if other == "raster":
            mean = float(ratios.mean())
            bound = f">= {RATIO_BOUND:g}"
            output.check(
                "surface mapped, information over raster, mean", mean, bound, mean >= RATIO_BOUND
            )
    nees = float(np.mean([r.nees.mean() for r in informed]))
    output.measure("nees", nees)
    low, high = NEES_BOUNDS
    bound = f"{low:g} to {high:g}"
    output.check("squared normalised error of fused points", nees, bound, low <= nees <= high)


def _aligned(curves: Sequence[np.ndarray], scans: int) -> np.ndarray:
    """Return (runs, looks, 2) share and voxels after each look; a run that ended early stays."""
    whole = np.zeros((len(curves), 2 * scans, 2))
    for row, curve in zip(whole, curves, strict=True):
        row[: len(curve)] = curve[:, 1:]
        row[len(curve) :] = curve[-1, 1:]
    return whole


def _show(runs: Mapping[str, MappingRun], seed: int, output: Output) -> None:
    """Draw one scene as it is, and as it was seen and mapped by each method."""
    output.figure("figure_3-22", scene_figure(StereoScene(seed=seed)))
    for method, name in FIGURE.items():
        shown = runs[method].shown
        assert shown is not None
        output.figure(f"{name}a", views_figure(shown.panoramas, shown.images))
        output.figure(f"{name}b", points_figure(shown.surface))


PARTS: dict[str, Callable[[Options, Output], None]] = {
    "noise": measure_noise,
    "motion": measure_all_motion,
    "mapping": measure_mapping,
    "cooperation": measure_cooperation,
}
