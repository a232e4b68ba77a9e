"""Growth of the cost with robots, with finer voxels, with stages, and with processes."""

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.figure import Figure

from controllers.braid.arm.inverse import BinaryArm, solve
from controllers.motion.simple_motions import DriveAndHold
from experiments.appe.arm.inverse_trial import draw_targets
from experiments.bench.bench_options import Options
from experiments.bench.loop import SPAN, WHEEL_SPEED
from experiments.bench.mapping import FINE_BOX, MEMORY, Scene, fast_map, random_view, see
from experiments.harness.figure_style import BLUE
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.provenance import free_cores
from experiments.harness.sweep import sweep
from experiments.harness.timing import timed
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from perception.voxels.map import VoxelMapConfig
from perception.voxels.occupancy import UpdateModel
from twin.loop import run
from twin.simulation import Simulation

ROBOTS, QUICK_ROBOTS = (1, 2, 4, 8), (1, 2, 4)
VOXELS, QUICK_VOXELS = (0.01, 0.005, 0.002, 0.001), (0.01, 0.005)  # [m]
STAGES, QUICK_STAGES = (7, 10, 14, 20), (7, 10)
"""Up to six stages a tree answers at once: no search, and no part of its curve."""
JOBS = (1, 2)
SPACING = 1.0  # [m] between robots
TARGETS, QUICK_TARGETS = 10, 3
SWEPT, LOOPS = 8, 1_500_000
"""Jobs of the sweep, and iterations of a Python loop in each."""
ROUNDS, QUICK_ROUNDS = 5, 2

Times = dict[float, list[float]]


@dataclasses.dataclass(frozen=True)
class Curve:
    """One measured curve.

    Attributes:
        axis: Name of the size, with its unit.
        times: Time of each round [s], by size.
    """

    axis: str
    times: Times

    @property
    def exponents(self) -> list[float]:
        """Exponents of ``time = a size^exponent``, one a round; none on a machine of one core."""
        if len(self.times) == 1:
            return []
        rounds = zip(*self.times.values(), strict=True)
        return [exponent(dict(zip(self.times, each, strict=True))) for each in rounds]


def bench_scaling(options: Options, output: Output) -> None:
    """Measure four curves and fit a power law to each.

    Times are processor time; only the sweep's is wall time, of the quickest of its rounds.

    Args:
        options: ``quick`` takes fewer sizes and rounds.
        output: Receives ``scaling_exponent/<what>``, ``scaling_s/<what>/<size>`` and a figure.
    """
    seed = options.job_seeds(1, 1)[0]
    rounds = QUICK_ROUNDS if options.quick else ROUNDS
    curves = {
        "robots": _curve("robots", _robots(options.quick), rounds),
        "voxels": _curve("edge of a voxel [m]", _voxels(options.quick, seed), rounds),
        "stages": _curve("stages", _stages(options.quick, seed), rounds),
        "jobs": _sweeps(options, output, rounds),
    }
    for name, curve in curves.items():
        if curve.exponents:
            output.measure(f"scaling_exponent/{name}", distribution(curve.exponents))
        for size, seconds in curve.times.items():
            output.measure(f"scaling_s/{name}/{size:g}", distribution(seconds))
    jobs = curves["jobs"].times
    if len(jobs) > 1:
        output.measure("sweep_speedup/2", min(jobs[1]) / min(jobs[2]))
    output.figure("scaling", draw(curves))


def exponent(times: Mapping[float, float]) -> float:
    """Return b of the least-squares fit of ``time = a size^b`` in logarithms.

    Args:
        times: Seconds by size; two at least.
    """
    return float(np.polyfit(np.log(list(times)), np.log(list(times.values())), 1)[0])


def draw(curves: Mapping[str, Curve]) -> Figure:
    """Draw all curves with their medians' fits, on logarithmic axes."""
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    for axes, curve in zip(figure.subplots(1, len(curves)), curves.values()):
        sizes = np.array(list(curve.times))
        medians = np.array([np.median(seconds) for seconds in curve.times.values()])
        for size, seconds in curve.times.items():
            axes.plot([size] * len(seconds), seconds, ".", color="0.6")
        axes.plot(sizes, medians, "o", color=BLUE)
        if len(sizes) > 1:
            fit = np.polyfit(np.log(sizes), np.log(medians), 1)
            axes.plot(sizes, np.exp(np.polyval(fit, np.log(sizes))), color=BLUE)
            axes.set_title(f"exponent {np.median(curve.exponents):.2f}")
        axes.set(xscale="log", yscale="log", xlabel=curve.axis, ylabel="time [s]")
        axes.minorticks_off()
        axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
        axes.grid(alpha=0.3)
    return figure


def _curve(axis: str, works: Mapping[float, Callable[[], object]], rounds: int) -> Curve:
    """Time every size once a round, after one untimed call."""
    times: Times = {size: [] for size in works}
    for work in works.values():
        work()
    for _ in range(rounds):
        for size, work in works.items():
            times[size].append(timed(work))
    return Curve(axis, times)


def _robots(quick: bool) -> dict[float, Callable[[], object]]:
    """Return the loop over robots that drive side by side."""

    def work(count: int) -> Callable[[], object]:
        names = [f"rover{i + 1}" for i in range(count)]
        placements = [RobotPlacement(name, (SPACING * i, 0.0)) for i, name in enumerate(names)]
        model = make_model(FieldConfig(size=(20.0, 20.0)), placements)
        simulation = Simulation(model, names, data=settle(model))
        clock, begin = simulation, simulation.save()

        def drive() -> None:
            simulation.restore(begin)
            run(simulation.robots, [DriveAndHold(WHEEL_SPEED)], clock, duration=SPAN)

        return drive

    return {count: work(count) for count in (QUICK_ROBOTS if quick else ROBOTS)}


def _voxels(quick: bool, seed: int) -> dict[float, Callable[[], object]]:
    """Return the insertion of the same clouds for each size of voxel."""
    rng = np.random.default_rng(seed)
    scene = Scene.random(rng)
    clouds = [see(scene, random_view(rng), rng) for _ in range(1 if quick else 2)]
    config = VoxelMapConfig(UpdateModel(), memory_limit=int(MEMORY))
    edges = QUICK_VOXELS if quick else VOXELS
    return {edge: functools.partial(fast_map, edge, clouds, config, FINE_BOX) for edge in edges}


def _stages(quick: bool, seed: int) -> dict[float, Callable[[], object]]:
    """Return the neighbourhood search for targets of arms of each length."""
    count = QUICK_TARGETS if quick else TARGETS

    def work(stages: int) -> Callable[[], object]:
        rng = np.random.default_rng(seed)
        arm = BinaryArm(stages)
        targets = draw_targets("reachable", stages, count, arm.geometry, rng)
        return lambda: [solve(arm, target, "neighbourhood", rng) for target in targets]

    return {stages: work(stages) for stages in (QUICK_STAGES if quick else STAGES)}


def _sweeps(options: Options, output: Output, rounds: int) -> Curve:
    """Time the same sweep with one process and with two, which are started before."""
    times: Times = {jobs: [] for jobs in JOBS if jobs <= free_cores()}
    for index in range(-1, rounds):
        for jobs in times:
            chosen = dataclasses.replace(options, jobs=int(jobs))
            # Configurations that no run before had: with --resume, a job that is done takes no
            # time.
            now = time.time_ns()
            configs = [(now, jobs, job) for job in range(SWEPT)]
            start = time.perf_counter()
            sweep(spin, configs, chosen, output, label=f"sweep by {jobs:g}")
            if index >= 0:
                times[jobs].append(time.perf_counter() - start)
    return Curve("processes", times)


def spin(config: tuple[int, float, int]) -> int:
    """Count; a job that needs a processor and nothing else.

    Args:
        config: Beginning of the sweep [ns], number of processes and number of the job.
    """
    total = 0
    for index in range(LOOPS):
        total += index & 1
    return total
