"""``mission``: two rovers start near a slot, and insert a card by their own estimates.

One continuous run: both swing their arms and identify their pitch dynamics (chapter 2); the master
finds the panel and maps the site (chapter 3); it finds the card in the slave's gripper, and the
slave identifies its turn share from the master's measurements; the master drives to the best camera
station for card and slot (chapter 4), finds the panel again, and guides the slave, which feeds
forward its tilt on the springs under the arm (chapter 5). Each stage uses the estimates of earlier
stages. The ablation leaves a stage out.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from controllers.mission.team import OMITTABLE
from experiments.ch2.rover.confidence import measure_confidence
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.intervals import Distribution, distribution, mcnemar, success_fraction
from experiments.harness.output import Output
from experiments.harness.robot_option import check_calibrations, check_robot
from experiments.harness.sweep import sweep
from experiments.mission.figures import draw_knowledge, draw_steps, draw_worth
from experiments.mission.film import film_mission
from experiments.mission.results import (
    after_stage,
    first_stops,
    off_middle,
    stage_seconds,
    stages_of,
)
from experiments.mission.trial import MissionResult, MissionTrial, run_mission
from twin.realism import RealismName

WANTED = 0.9
_SLIP_STAGE = "identification"
"""Part whose omission degrades dead reckoning."""
Results = list[MissionResult]


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of mission.

    Attributes:
        robot: Robots that are driven: sim, quantised (counts as the boards do), emulated (over the
            boards' own protocols) or both robots' boards, serial:PORT,...,serial:PORT,...
        without: Knowledge that further missions do without: identification, mapping, placement
            (unless said, each of them in a full run and none in a quick one; "none" for none), one
            at a time and with the same seeds.
        realism: How far simulated robots, their sensors and cameras are from their drawings: ideal,
            default or harsh; with any but ideal each seed has robots of its own.
        only: Last stage to run, which is identify, or all.
    """

    robot: str = "sim"
    without: tuple[str, ...] = ()
    realism: RealismName = "default"
    only: Literal["identify", "all"] = "all"

    def __post_init__(self) -> None:
        """Refuse unknown robots and stages.

        Raises:
            OptionError: Naming it and the known ones.
        """
        super().__post_init__()
        check_robot(self.robot)
        missions = len(self.job_seeds(20, 1)) * (1 + len(self.ablations))
        if self.robot.startswith("serial:") and missions > 1:
            raise OptionError("--robot serial: one mission at a time, with --quick")
        known = (*OMITTABLE, "none")
        if unknown := set(self.without) - set(known):
            raise OptionError(f"--without {min(unknown)}: expected some of {', '.join(known)}")

    @property
    def ablations(self) -> tuple[str, ...]:
        """Stages that are left out, one at a time."""
        if "none" in self.without or self.only != "all":
            return ()
        return self.without or (() if self.quick else OMITTABLE)


def run(options: Options, output: Output) -> None:
    """Run the missions.

    Args:
        options: ``quick`` runs one mission (about a minute), else there are 20, and as many
            without each stage.
        output: Receives ``success_fraction``, ``success_fraction/without_<stage>``,
            ``mcnemar_p/without_<stage>``, ``stage_longer_by_s/without_<stage>/<stage>``,
            ``first_stop_miss_mm``, ``first_stop_miss_deg``, ``stops`` and ``card_off_middle_mm`` of
            whole missions and without each stage, ``first_stop_miss_more_by_mm/without_<stage>``,
            ``card_off_middle_more_by_mm/without_<stage>`` (where both inserted),
            ``last_stop_miss_mm``, ``last_stop_miss_deg``, ``wall_over_sim_time``,
            ``turn_share/<stage>``, ``turn_share_sigma/<stage>``, ``slave_place/<stage>/<part>`` and
            the errors of the estimates after each stage.
    """
    check_calibrations(options.robot)
    seeds = options.job_seeds(20, 1)
    kinds = ("", *options.ablations)
    jobs = [
        MissionTrial(
            seed,
            without=kind,
            robot=options.robot,
            realism=options.realism,
            only="" if options.only == "all" else options.only,
        )
        for kind in kinds
        for seed in seeds
    ]
    if options.only != "all":
        _measure_identification(sweep(run_mission, jobs, options, output, label="missions"), output)
        return
    if len(jobs) == 1:
        result, steps = film_mission(jobs[0], output.file("run.rrd") if options.record else None)
        results = [result]
        if steps:
            output.figure("mission_steps", draw_steps(steps))
    else:
        results = sweep(run_mission, jobs, options, output, label="missions")
        if options.record:
            film_mission(jobs[0], output.file("run.rrd"))
    cells = {
        kind: [r for j, r in zip(jobs, results, strict=True) if j.without == kind] for kind in kinds
    }
    _measure(cells, output)
    _measure_identification(cells[""], output)
    _tabulate(jobs, results, output)
    _measure_stages(cells[""], output)
    output.figure("mission_knowledge", draw_knowledge(cells[""]))
    if not any(result.success for result in cells[""]):
        output.failure = f"no card was inserted: {cells[''][0].reason or 'not seated'}"
    if len(kinds) > 1:
        shares = {kind: _success(results) for kind, results in cells.items()}
        output.figure("mission_ablation", draw_worth(shares, first_stops(cells), off_middle(cells)))


def _measure_identification(results: Results, output: Output) -> None:
    found = [each for result in results for each in result.identifications]
    if found:
        measure_confidence(found, output)


def _success(results: Results) -> Distribution:
    return success_fraction(result.success for result in results)


def _measure(cells: dict[str, Results], output: Output) -> None:
    whole = cells[""]
    share = _success(whole)
    output.measure("success_fraction", share)
    output.check(
        "missions that end with an inserted card", share["mean"], f">= {WANTED}",
        share["mean"] >= WANTED,
    )  # fmt: skip
    output.measure("seconds", distribution(r.seconds for r in whole))
    _measure_some("wall_over_sim_time", [r.wall_over_sim for r in whole], output)
    forces = [r.peak for r in whole if np.isfinite(r.peak)]
    if forces:
        output.measure("largest_force", max(forces))
        output.check("largest force on the card [N]", max(forces), "<= 10", max(forces) <= 10.0)  # noqa: PLR2004
    for kind, off in off_middle(cells).items():
        _measure_some(f"card_off_middle_mm{_suffix(kind)}", [1e3 * far for far in off], output)
    for kind, results in cells.items():
        _measure_stops(kind, results, output)
        if kind:
            _compare(kind, whole, results, output)


def _measure_some(key: str, values: Sequence[float], output: Output) -> None:
    """Store the distribution of the finite values, if there are any."""
    finite = [value for value in values if np.isfinite(value)]
    if finite:
        output.measure(key, distribution(finite))


def _suffix(kind: str) -> str:
    return f"/without_{kind}" if kind else ""


def _compare(kind: str, whole: Results, results: Results, output: Output) -> None:
    """Compare missions of the same seeds with and without a stage."""
    share, without = _success(whole), _success(results)
    output.measure(f"success_fraction/without_{kind}", without)
    with_it, left_out = ([bool(r.success) for r in each] for each in (whole, results))
    lost = sum(a and not b for a, b in zip(with_it, left_out))
    won = sum(b and not a for a, b in zip(with_it, left_out))
    output.measure(f"lost_and_won/without_{kind}", [lost, won])
    output.measure(f"mcnemar_p/without_{kind}", mcnemar(with_it, left_out))
    output.measure(f"seconds/without_{kind}", distribution(r.seconds for r in results))
    pairs = [(stage_seconds(a), stage_seconds(b)) for a, b in zip(whole, results)]
    for stage in pairs[0][0]:
        longer = [b[stage] - a[stage] for a, b in pairs if stage in a and stage in b]
        _measure_some(f"stage_longer_by_s/without_{kind}/{stage}", longer, output)
    _compare_places(kind, whole, results, output)
    fewer = without["mean"] < share["mean"]
    output.check(
        f"without {kind}: fewer cards inserted", without["mean"], f"< {share['mean']:.2f}", fewer
    )


def _compare_places(kind: str, whole: Results, results: Results, output: Output) -> None:
    """Measure the increase of the master's and the card's position errors without a stage."""
    more = {
        "first_stop_miss_more_by_mm": [
            1e3 * (b.misses[0, 0] - a.misses[0, 0])
            for a, b in zip(whole, results)
            if len(a.misses) and len(b.misses)
        ],
        "card_off_middle_more_by_mm": [
            1e3 * (abs(b.across) - abs(a.across))
            for a, b in zip(whole, results)
            if a.success and b.success
        ],
    }
    for name, values in more.items():
        _measure_some(f"{name}/without_{kind}", values, output)
    farther = more["first_stop_miss_more_by_mm"]
    if kind == _SLIP_STAGE and farther:
        low = distribution(farther)["low"]
        output.check(
            f"without {kind}: first stop farther from the camera's place [mm]", low,
            "> 0 within its interval", low > 0.0,
        )  # fmt: skip


def _measure_stops(kind: str, results: Results, output: Output) -> None:
    """Store how often the master stopped on its path, and its error at the first stop."""
    stops = [result.misses for result in results if len(result.misses)]
    for name, values in (
        ("stops", [len(misses) for misses in stops]),
        ("first_stop_miss_mm", [1e3 * misses[0, 0] for misses in stops]),
        ("first_stop_miss_deg", [float(np.degrees(misses[0, 1])) for misses in stops]),
        ("last_stop_miss_mm", [1e3 * misses[-1, 0] for misses in stops]),
        ("last_stop_miss_deg", [float(np.degrees(misses[-1, 1])) for misses in stops]),
    ):
        _measure_some(f"{name}{_suffix(kind)}", values, output)


def _measure_stages(results: Results, output: Output) -> None:
    """Store the errors of the estimates after each stage, over the missions that have ended it."""
    rows: list[list[Any]] = []
    for name in stages_of(results):
        if name == "insert":
            continue
        known = after_stage(results, name)
        master, slave = (
            [1e3 * float(np.linalg.norm(getattr(ended, f"{robot}_error"))) for ended in known]
            for robot in ("master", "slave")
        )
        output.measure(f"slot_error_mm/master/{name}", distribution(master))
        output.measure(f"slot_error_mm/slave/{name}", distribution(slave))
        for robot, turns in zip(("master", "slave"), np.degrees([e.turns for e in known]).T):
            output.measure(f"slot_error_deg/{robot}/{name}", distribution(turns))
        for what, values in zip(
            ("x_m", "y_m", "yaw_rad"), np.transpose([e.slave_place for e in known])
        ):
            output.measure(f"slave_place/{name}/{what}", distribution(values))
        ends, shares, sigmas = (
            [getattr(e, what) for e in known]
            for what in ("ended", "turn_share", "turn_share_sigma")
        )
        output.measure(f"turn_share/{name}", distribution(shares))
        output.measure(f"turn_share_sigma/{name}", distribution(sigmas))
        values = (ends, master, slave, shares, sigmas)
        rows.append([name, *(float(np.median(each)) for each in values)])
    columns = ["after", "time [s]", "slot from the master, error [mm]",
               "slot from the slave, error [mm]", "share of a turn", "its deviation"]  # fmt: skip
    output.table("stages", columns, rows)


def _tabulate(jobs: Sequence[MissionTrial], results: Results, output: Output) -> None:
    columns = ["without", "seed", "success", "reason", "time [s]", "peak [N]", "across [mm]",
               "ahead [mm]", "wall/time", "stops"]  # fmt: skip
    rows = [
        [j.without or "-", j.seed, r.success, r.reason, r.seconds, r.peak,
         1e3 * r.across, 1e3 * r.ahead, r.wall_over_sim, len(r.misses)]
        for j, r in zip(jobs, results)
    ]  # fmt: skip
    output.table("missions", columns, rows)
