"""``ch3-swarm``: one to fifty robots map one indoor world together (section 6.2 (d)).

Each round every robot chooses a pose, goes there and scans (75 deg, 10 m). Cooperating robots claim
what they are about to see; independent ones choose for themselves on the common map.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.ch3.planar.record import record_trial
from experiments.ch3.planar.trial import TARGET, PlanarRun, PlanarTrial, first_at, map_world
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep

SIZES, QUICK_SIZES = (1, 2, 5, 10, 20, 50), (2, 5, 20)
LARGEST = 200
LIMIT = 400
FOV_DEG, DEPTH = 75.0, 10.0
PLAN_BOUND = 100.0
"""Planning time of a robot's choice that is aimed at [ms]."""
TEAMS = ("cooperative", "independent")


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of ch3-swarm.

    Attributes:
        robots: Sizes of the swarm (unless said, 1 2 5 10 20 50; with --quick, 2 5 20).
    """

    robots: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Refuse swarms that are none.

        Raises:
            OptionError: Naming the size.
        """
        super().__post_init__()
        for size in self.robots:
            if not 1 <= size <= LARGEST:
                raise OptionError(f"--robots {size}: expected 1 to {LARGEST}")

    def sizes(self) -> tuple[int, ...]:
        """Return the sizes to run, each once, in order."""
        return tuple(sorted(set(self.robots or (QUICK_SIZES if self.quick else SIZES))))


def run(options: Options, output: Output) -> None:
    """Map every seed's floor by swarms of all sizes, cooperating and not.

    Args:
        options: ``quick`` takes 1 seed instead of 12.
        output: Receives ``rounds_to_90/<n>``, ``metres_to_90/<n>`` and ``plan_ms/<n>``; a
            recording shows the smallest swarm.
    """
    seeds = options.job_seeds(12, 1)
    cases = [(size, team) for size in options.sizes() for team in TEAMS[: 2 if size > 1 else 1]]
    trials = [
        PlanarTrial("indoor", seed, "information", FOV_DEG, DEPTH, LIMIT, size, team == TEAMS[0],
              target=TARGET)
        for size, team in cases
        for seed in seeds
    ]  # fmt: skip
    results = sweep(map_world, trials, options, output, label="runs")
    curves: dict[str, list[tuple[int, Any, Any]]] = {team: [] for team in TEAMS}
    rows: list[list[Any]] = []
    for index, (size, team) in enumerate(cases):
        chosen = results[index * len(seeds) : (index + 1) * len(seeds)]
        rounds, metres = _measure(size, team, chosen, output)
        curves[team].append((size, rounds, metres))
        for seed, result in zip(seeds, chosen):
            rows.append([size, team, seed, *first_at(result), float(np.mean(result.plan_ms))])
    columns = ("robots", "team", "seed", "rounds to 90 %", "metres to 90 %", "plan [ms a robot]")
    output.table("swarm_runs", columns, rows)
    output.figure("swarm", _figure(curves))
    if options.record:
        record_trial(trials[0], output.file("run.rrd"))


def _measure(size: int, team: str, chosen: Sequence[PlanarRun], output: Output) -> tuple[Any, Any]:
    """Store one size's metrics; return rounds and metres."""
    ending = str(size) if team == TEAMS[0] else f"{size}/{team}"
    when = np.array([first_at(result) for result in chosen])
    rounds, metres = distribution(when[:, 0]), distribution(when[:, 1])
    output.measure(f"rounds_to_90/{ending}", rounds)
    output.measure(f"metres_to_90/{ending}", metres)
    reached = int(np.isfinite(when[:, 0]).sum())
    output.measure(f"reached_90_fraction/{ending}", fraction(reached, len(chosen)))
    if team == TEAMS[0]:
        times = np.concatenate([result.plan_ms for result in chosen])
        plan = distribution(times)
        output.measure(f"plan_ms/{ending}", plan)
        name = f"choice of one of {size} robots in ms, median"
        median = float(plan["median"])
        output.check(name, median, f"<= {PLAN_BOUND:g}", median <= PLAN_BOUND)
    return rounds, metres


def _figure(curves: Mapping[str, Sequence[tuple[int, Any, Any]]]) -> Figure:
    """Draw rounds and metres over the size, against a perfect division of the work."""
    figure = Figure(figsize=(10, 4.5))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for team, points in curves.items():
        for axes, column in ((left, 1), (right, 2)):
            if not points:
                continue
            sizes = [point[0] for point in points]
            summaries: list[Any] = [point[column] for point in points]
            medians = np.array([summary["median"] for summary in summaries])
            low, high = (np.array([s[k] for s in summaries]) for k in ("low", "high"))
            finite = np.isfinite(low) & np.isfinite(high)
            bars = [np.where(finite, np.abs(side - medians), 0.0) for side in (low, high)]
            axes.errorbar(sizes, medians, bars, marker="o", capsize=3, label=team)
    first = curves[TEAMS[0]][0]
    sizes = np.array([point[0] for point in curves[TEAMS[0]]])
    ideal = first[1]["median"] * first[0] / sizes
    left.plot(sizes, ideal, "k:", linewidth=0.8, label="evenly divided")
    left.set(yscale="log", ylabel=f"rounds to {TARGET:.0%}")
    right.set(ylabel=f"metres to {TARGET:.0%}, all robots")
    for axes in (left, right):
        axes.set(xscale="log", xlabel="robots")
        axes.grid(alpha=0.3)
        axes.legend()
    figure.subplots_adjust(wspace=0.3)
    return figure
