"""``crossing``: two rovers, dropped metres off their site, search it and drive to their places.

The field is drawn anew by each seed, and what each rover knows of its initial pose is half a metre
and 30 degrees off. Each searches for the panel by driving, chooses its views and plans its paths on
what it has mapped; then the slave drives before the slot, the master maps the site, chooses its
camera station and drives there. What is drawn and measured stands in ``docs/mission.md``.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from controllers.crossing.team import OMITTABLE
from experiments.crossing.figures import draw_crossing
from experiments.crossing.scene import MASTER
from experiments.crossing.trial import BeliefResult, CrossingResult, CrossingTrial, run_crossing
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.intervals import distribution, success_fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from twin.realism import RealismName

WANTED = 0.9
STAGES = ("search", "approach", "map", "place")
"""Stages in their order."""
Results = Sequence[CrossingResult]


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of crossing.

    Attributes:
        without: Points of the map that further crossings of the same seeds do without: paths (they
            are planned as if nothing stood on the ground) or occluders (so is the camera station
            chosen).
        realism: How far simulated robots, their sensors and cameras are from their drawings: ideal,
            default or harsh.
    """

    without: tuple[str, ...] = ()
    realism: RealismName = "default"

    def __post_init__(self) -> None:
        """Refuse unknown parts.

        Raises:
            OptionError: Naming it and the known ones.
        """
        super().__post_init__()
        if unknown := set(self.without) - set(OMITTABLE):
            raise OptionError(f"--without {min(unknown)}: expected some of {', '.join(OMITTABLE)}")


def run(options: Options, output: Output) -> None:
    """Run the crossings.

    Args:
        options: ``quick`` runs one crossing (some minutes), else there are 40.
        output: Receives ``arrived_fraction``, ``failures/<stage>`` and ``inconsistent/<stage>``
            (counts), ``station_error_mm``, ``station_error_deg``, ``station_nees``, ``collisions``
            and ``tip_overs`` (counts), ``collided_fraction``, ``seconds``, ``driven_m/<robot>``,
            ``wall_over_sim_time``; ``arrived_fraction/without_<part>`` and
            ``collisions/without_<part>`` of crossings without points of the map.
    """
    seeds = options.job_seeds(40, 1)
    kinds = ("", *options.without)
    jobs = [CrossingTrial(seed, kind, options.realism) for kind in kinds for seed in seeds]
    results = sweep(run_crossing, jobs, options, output, label="crossings")
    cells = {kind: [r for j, r in zip(jobs, results) if j.without == kind] for kind in kinds}
    _measure(cells[""], output)
    for kind in options.without:
        output.measure(f"arrived_fraction/without_{kind}", _arrived(cells[kind]))
        output.measure(f"collisions/without_{kind}", _touches(cells[kind]))
    columns = ["without", "seed", "arrived", "stage", "reason", "time [s]", "wall/time",
               "slave off its place [mm]", "collisions", "driven [m]"]  # fmt: skip
    rows = [
        [j.without or "-", j.seed, r.arrived, r.failed_stage or r.inconsistent, r.reason, r.seconds,
         r.wall_over_sim, 1e3 * r.place_error, len(r.collisions), sum(r.driven)]
        for j, r in zip(jobs, results)
    ]  # fmt: skip
    output.table("crossings", columns, rows)
    output.figure("crossing", draw_crossing(jobs[0], results[0]))


def _arrived(results: Results):  # noqa: ANN202
    return success_fraction(result.arrived for result in results)


def _touches(results: Results) -> int:
    return sum(len(result.collisions) for result in results)


def _measure(results: Results, output: Output) -> None:
    arrived = _arrived(results)
    output.measure("arrived_fraction", arrived)
    output.check(
        "crossings whose rovers arrive", arrived["mean"], f">= {WANTED}", arrived["mean"] >= WANTED
    )
    for stage in STAGES:
        output.measure(f"failures/{stage}", sum(r.failed_stage == stage for r in results))
        output.measure(f"inconsistent/{stage}", sum(r.inconsistent == stage for r in results))
    touches, fallen = _touches(results), sum(len(result.fallen) for result in results)
    output.measure("collisions", touches)
    output.measure("collided_fraction", success_fraction(bool(r.collisions) for r in results))
    output.check("collisions", touches, "0", touches == 0)
    output.measure("tip_overs", fallen)
    output.check("rovers tipped over", fallen, "0", fallen == 0)
    output.measure("seconds", distribution(r.seconds for r in results))
    for index, robot in enumerate(("master", "slave")):
        output.measure(f"driven_m/{robot}", distribution(r.driven[index] for r in results))
    walls = [r.wall_over_sim for r in results if math.isfinite(r.wall_over_sim)]
    if walls:
        output.measure("wall_over_sim_time", distribution(walls))
    stations = [each for result in results for each in result.beliefs if _is_station(each)]
    if stations:
        output.measure("station_error_mm", distribution(1e3 * each.error for each in stations))
        turns = [float(np.degrees(each.turn)) for each in stations]
        output.measure("station_error_deg", distribution(turns))
        output.measure("station_nees", distribution(each.nees / 6.0 for each in stations))


def _is_station(belief: BeliefResult) -> bool:
    return belief.stage == "place" and belief.robot == MASTER
