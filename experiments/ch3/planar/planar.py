"""``ch3-planar``: planar worlds mapped by one and two vision systems (figures 3-12 to 3-21).

Each seed draws an unstructured and an indoor world of 100 x 100 m and a start; every method maps
the same ones. Ranges are free of noise as in the thesis' simulation (``--noise`` adds some), the
map is shared at once, robots are points. The fraction mapped counts the cells that can be seen from
somewhere that can be reached.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from controllers.mapping.planar_planner import METHODS, UTILITIES, Method, Utility
from experiments.ch3.planar.explain import evaluation_figure, merging_figure
from experiments.ch3.planar.figures import draw_group
from experiments.ch3.planar.record import record_trial
from experiments.ch3.planar.trial import (
    TARGET,
    PlanarRun,
    PlanarTrial,
    build_world,
    first_at,
    map_world,
)
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.planar.information import READINGS, Reading
from perception.planar.raycast import RangeSensor

QUICK_METHODS: tuple[Method, ...] = ("max_new", "information")
THESIS_METHODS: tuple[Method, ...] = ("random", "raster", "max_new", "min_old", "information")
WIDE, NARROW = (90.0, 15.0), (75.0, 10.0)
"""Field of view [deg] and depth of field [m] of the thesis' two kinds of vision system."""
LIMITS = {"unstructured": 200, "narrow": 320, "indoor": 400}
END = 0.95
"""Fraction mapped at which a run ends (with --quick, as soon as it is scored)."""

Groups = dict[str, list[PlanarTrial]]
"""Trials by world and team: unstructured, indoor, and so on."""


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of ch3-planar.

    Attributes:
        world: Map this picture instead (dark is obstacle, a pixel is half a metre, larger
            pictures are shrunk to 200); each seed draws a start and candidates.
        methods: Which to compare (unless said, all; with --quick, max_new and information).
        reading: What new information means, histogram (3-14 as mended), premultiplied or entropy.
        utility: What method information makes of it: distance at its going rate, or at the fixed
            price of 3-15, K = 0.1 and n = 2.
        noise: Deviation of a range over its square [1/m] (3-7).
        fov: Field of view for --world [deg].
        depth: Depth of field for --world [m].
        explain: Also draw how Gaussians are merged and how a view is evaluated (3-6, 3-8).
    """

    world: Annotated[Path | None, tyro.conf.arg(metavar="PICTURE")] = None
    methods: tuple[Method, ...] = ()
    reading: Literal["histogram", "premultiplied", "entropy"] = "entropy"
    utility: Literal["going_rate", "fixed"] = "going_rate"
    noise: float = 0.0
    fov: float = NARROW[0]
    depth: float = NARROW[1]
    explain: bool = False

    def __post_init__(self) -> None:
        """Refuse unknown methods and sensors that cannot be.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        choices = (("methods", self.methods, METHODS), ("reading", (self.reading,), READINGS))
        for name, given, valid in (*choices, ("utility", (self.utility,), UTILITIES)):
            for word in given:
                if word not in valid:
                    raise OptionError(f"--{name} {word}: expected {', '.join(valid)}")
        if not 0.0 < self.fov <= 360.0:
            raise OptionError(f"--fov: expected more than 0 and at most 360 deg, got {self.fov}")
        try:
            RangeSensor(float(np.radians(self.fov)), self.depth, self.noise)
        except ValueError as error:
            raise OptionError(f"--{error}") from None

    def chosen_methods(self) -> tuple[Method, ...]:
        """Return the methods to run, each once."""
        return tuple(dict.fromkeys(self.methods or (QUICK_METHODS if self.quick else METHODS)))


def run(options: Options, output: Output) -> None:
    """Map all worlds by all methods, score and draw.

    Args:
        options: ``quick`` takes 2 seeds and 2 methods instead of 12 and 7.
        output: Receives the metrics of DESIGN.md, figures, tables, and the recording.
    """
    seeds = options.job_seeds(12, 2)
    if options.world is not None:
        build_world(PlanarTrial(str(options.world), seeds[0], "information"))  # a bad one ends here
    groups = make_groups(options, seeds)
    trials = [trial for group in groups.values() for trial in group]
    found = sweep(map_world, trials, options, output, label="runs")
    results = dict(zip(trials, found))
    for name, group in groups.items():
        _measure_group(name, group, results, output)
        draw_group(name, group, results, output)
    _measure_ratios(groups, results, output)
    _judge(output)
    times = np.concatenate([result.plan_ms for result in found if len(result.plan_ms)])
    output.measure("plan_ms", distribution(times))
    output.measure("called_wrong_fraction", distribution([r.called_wrong for r in found]))
    if options.explain:
        output.figure("figure_3-6", merging_figure())
        output.figure("figure_3-8", evaluation_figure())
    if options.record:
        shown = next((t for t in trials if t.method == "information"), trials[0])
        record_trial(shown, output.file("run.rrd"))


def make_groups(options: Options, seeds: Sequence[int]) -> Groups:
    """Return the trials of every figure and ratio."""
    reading: Reading = options.reading
    utility: Utility = options.utility

    def trials(
        world: str, methods: Sequence[Method], sensor: tuple[float, float], limit: int,
        robots: int = 1, cooperative: bool = True,
    ) -> list[PlanarTrial]:  # fmt: skip
        return [
            PlanarTrial(world, seed, method, *sensor, limit, robots, cooperative, reading, utility,
                  options.noise, TARGET if options.quick else END)
            for method in methods
            for seed in seeds
        ]  # fmt: skip

    methods = options.chosen_methods()
    if options.world is not None:
        sensor = (options.fov, options.depth)
        return {"picture": trials(str(options.world), methods, sensor, LIMITS["indoor"])}
    groups = {
        "unstructured": trials("unstructured", methods, WIDE, LIMITS["unstructured"]),
        "indoor": trials("indoor", methods, NARROW, LIMITS["indoor"]),
    }
    if "information" in methods:
        only: tuple[Method, ...] = ("information",)
        both: list[Method] = [m for m in THESIS_METHODS if m in methods]
        two = only if options.quick else both
        field, narrow, floor = "unstructured", LIMITS["narrow"], LIMITS["indoor"]
        groups |= {
            "unstructured_one_narrow": trials(field, only, NARROW, narrow),
            "unstructured_two": trials(field, two, NARROW, narrow, 2),
            "indoor_two": trials("indoor", only, NARROW, floor, 2),
        }
        if not options.quick:
            groups |= {
                "unstructured_two_independent": trials(field, only, NARROW, narrow, 2, False),
                "indoor_two_independent": trials("indoor", only, NARROW, floor, 2, False),
            }
    return groups


def select(
    group: Sequence[PlanarTrial], results: Mapping[PlanarTrial, PlanarRun], method: str
) -> list[PlanarRun]:
    """Return one method's results of a group, in the order of the seeds."""
    return [results[trial] for trial in group if trial.method == method]


def _measure_group(
    name: str,
    group: Sequence[PlanarTrial],
    results: Mapping[PlanarTrial, PlanarRun],
    output: Output,
) -> None:
    """Store when each method had mapped 90 %; an infinity (null) where it never had."""
    ending = "" if name == "unstructured" else f"_{name}"
    rows: list[list[Any]] = []
    for method in dict.fromkeys(trial.method for trial in group):
        chosen = select(group, results, method)
        when = np.array([first_at(result) for result in chosen])
        output.measure(f"scans_to_90{ending}/{method}", distribution(when[:, 0]))
        output.measure(f"metres_to_90{ending}/{method}", distribution(when[:, 1]))
        reached = int(np.isfinite(when[:, 0]).sum())
        output.measure(f"reached_90_fraction{ending}/{method}", fraction(reached, len(chosen)))
        last = [float(result.fraction[-1]) for result in chosen]
        output.measure(f"fraction_at_end{ending}/{method}", distribution(last))
        seeds = [trial.seed for trial in group if trial.method == method]
        rows += [[method, s, *w, f] for s, w, f in zip(seeds, when.tolist(), last)]
    columns = ("method", "seed", "rounds to 90 %", "metres to 90 %", "fraction at the end")
    output.table(f"runs_{name}", columns, rows)
    difference = paired_difference(group, results)
    if difference:
        key = f"fraction_difference{ending}/information_minus_max_new"
        output.measure(key, distribution(difference))


def paired_difference(
    group: Sequence[PlanarTrial], results: Mapping[PlanarTrial, PlanarRun]
) -> list[float]:
    """Return by how much information is ahead of max_new scan for scan, one mean for each seed.

    Taken until one of both has mapped 90 %.
    """
    pairs = zip(*(select(group, results, method) for method in ("information", "max_new")))
    means = []
    for ours, theirs in pairs:
        last = min(*(first_at(r)[0] for r in (ours, theirs)), len(ours.fraction))
        last = int(min(last, len(theirs.fraction)))
        means.append(float(np.mean(ours.fraction[:last] - theirs.fraction[:last])))
    return means


def _measure_ratios(
    groups: Groups, results: Mapping[PlanarTrial, PlanarRun], output: Output
) -> None:
    """Store paired ratios; a pair counts where both runs got there."""

    def when(group: str, method: str = "information") -> np.ndarray:
        found = [first_at(result) for result in select(groups.get(group, []), results, method)]
        return np.array(found).reshape(-1, 2)

    def ratio(key: str, above: np.ndarray, below: np.ndarray, column: int) -> None:
        if len(above) and len(above) == len(below):
            both = np.isfinite(above[:, 0]) & np.isfinite(below[:, 0])
            if both.any():
                output.measure(key, distribution(above[both, column] / below[both, column]))

    for name, ending in (("unstructured", ""), ("indoor", "_indoor")):
        one = when(name)
        key = f"distance_ratio{ending}/max_new_over_information"
        ratio(key, when(name, "max_new"), one, 1)
        ratio(f"scans_ratio{ending}/information_over_max_new", one, when(name, "max_new"), 0)
        alone = when("unstructured_one_narrow") if name == "unstructured" else one
        ratio(f"rounds_ratio_two/{name}", when(f"{name}_two"), alone, 0)
        key = f"rounds_ratio_two_independent/{name}"
        ratio(key, when(f"{name}_two_independent"), alone, 0)


BARS = (
    ("scans_to_90/information", "<=", 80.0),
    ("metres_to_90/information", "<=", 700.0),
    ("distance_ratio/max_new_over_information", ">=", 5.0),
    ("metres_to_90_indoor/information", "<=", 2000.0),
    ("scans_ratio_indoor/information_over_max_new", "<=", 1.25),
    ("rounds_ratio_two/unstructured", "<=", 0.55),
    ("rounds_ratio_two/indoor", "<=", 0.60),
)


def _judge(output: Output) -> None:
    """Hold the medians against the bars."""
    measured = output.metrics()["measured"]
    for key, sign, bound in BARS:
        if key not in measured:
            continue
        median = measured[key]["median"]
        value = float("inf") if median is None else float(median)
        ok = value <= bound if sign == "<=" else value >= bound
        name = key.replace("_to_90", f" to {TARGET:.0%}").replace("_", " ") + ", median"
        output.check(name, value, f"{sign} {bound:g}", ok)
