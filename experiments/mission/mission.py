"""``mission``: two rovers, dropped metres off their site, find it and insert a card together.

One continuous run in a field that each seed draws anew; what a rover knows of its initial pose is
half a metre and 30 degrees off. Both swing their arms and identify their pitch dynamics (chapter 2)
and search for the panel by driving, on paths planned on what they have mapped (chapter 3). The
master maps the site, chooses its camera station and drives there (chapter 4); the slave drives
before the slot, and inserts the card, guided by the master (chapter 5). All that passes between
them goes by radio. What is drawn and measured stands in ``docs/mission.md``.
"""

import math
from collections.abc import Sequence

import numpy as np

from controllers.mission.config import STAGES
from experiments.ch2.rover.confidence import measure_confidence
from experiments.ch5.insertion_scene import TOUCH
from experiments.harness.contract import OptionError
from experiments.harness.intervals import (
    Distribution,
    distribution,
    holm,
    mcnemar,
    sign_test,
    success_fraction,
)
from experiments.harness.output import Output
from experiments.harness.recording import RunFiles
from experiments.harness.robot_option import check_calibrations
from experiments.harness.sweep import sweep
from experiments.mission.figures import draw_steps, draw_tracks
from experiments.mission.film import film_mission
from experiments.mission.mission_options import Options
from experiments.mission.scene import MASTER
from experiments.mission.trial import BeliefResult, MissionResult, MissionTrial, run_mission
from twin.hardware.wiring import wirings_of

ARRIVED, SUCCEEDED, OF_ARRIVED = 0.9, 0.85, 0.9
"""Bars of ``docs/mission.md``: fractions that arrive, that succeed, and that do of those."""
RATIO, STATION, NEES = 1.5, (30.0, 2.0), (0.5, 2.0)
"""Further bars: driven over shortest path, error of the station [mm, deg], and its squared
normalised error over its degrees of freedom."""
MAP_BYTES = 20_000
"""Bar of the bytes of maps on the air."""
TOUCHED, FORCE = 0.8, 20.0
"""Bars: share of the insertions in which the guides are touched, and the 95th percentile of the
largest contact forces [N]."""
Results = Sequence[MissionResult]


def run(options: Options, output: Output) -> None:
    """Run the missions.

    Args:
        options: ``quick`` runs one mission (some minutes), of a seed fixed beforehand unless
            ``seed`` or ``seeds`` is given; else there are 40 of each cell.
        output: Receives ``success_fraction``, ``arrived_fraction``, ``success_of_arrived``,
            ``failures/<stage>`` and
            ``inconsistent/<stage>`` (counts), ``station_error_mm``, ``station_error_deg``,
            ``station_nees``, ``first_stop_miss_mm``, ``first_stop_miss_deg``, ``path_ratio``,
            ``collisions`` and ``tip_overs`` (counts), ``collided_fraction``, ``map_bytes``,
            ``radio_bytes/<stage>``, ``stage_seconds/<stage>``, ``driven_m/<robot>``, ``seconds``,
            ``wall_over_sim_time``, ``contact_fraction``, ``contact_force_n``, ``snap_force_n`` and
            the identification's errors; with
            ``/<cell>`` fractions and collisions of further missions, ``lost_and_won/<cell>``, and
            the p of both, corrected for their number: ``success_p/<cell>``,
            ``collisions_p/<cell>``.
    """
    check_calibrations(options.robot)
    check_radios(options.robot)
    seeds = options.mission_seeds
    only = "" if options.only == "all" else options.only
    jobs = [
        MissionTrial(
            seed,
            without=cell.removeprefix("without_") if cell.startswith("without_") else "",
            loss=options.loss if cell == "with_loss" else 0.0,
            robot=options.robot,
            realism=options.realism,
            only=only,
        )
        for cell in options.cells
        for seed in seeds
    ]
    results = _run_all(jobs, options, output)
    cells = {
        cell: results[at * len(seeds) : (at + 1) * len(seeds)]
        for at, cell in enumerate(options.cells)
    }
    whole = cells[""]
    identified = [each for result in whole for each in result.identifications]
    if identified:
        measure_confidence(identified, output)
    _measure(whole, options, output)
    _compare(cells, output)
    _tabulate(options.cells, jobs, results, output)
    output.figure("mission_tracks", draw_tracks(jobs[0], results[0]))
    if options.only == "all" and not any(result.success for result in whole):
        first = whole[0]
        why = first.reason or f"the belief after {first.inconsistent or first.failed_stage} is off"
        output.failure = f"no mission succeeded; the first ended in {_stage_of(first)}: {why}"


def check_radios(target: str) -> None:
    """Refuse real robots that cannot reach each other.

    Args:
        target: Option ``--robot``.

    Raises:
        OptionError: If one has no radio.
    """
    if any(not wiring.radio for wiring in wirings_of(target)):
        raise OptionError("--robot serial: rovers of a mission need a radio: add radio=PORT")


def _run_all(jobs: list[MissionTrial], options: Options, output: Output) -> list[MissionResult]:
    """Run the missions; a single one with progress bars and pictures."""
    files = RunFiles.of(options, output)
    if len(jobs) > 1:
        results = sweep(run_mission, jobs, options, output, label="missions")
        if files:
            film_mission(jobs[0], files)
        return results
    filmed = film_mission(jobs[0], files)
    if filmed.steps:
        output.figure("mission_steps", draw_steps(filmed.steps))
    if filmed.film is not None and filmed.film.frames:  # None where a robot fails at once.
        filmed.film.save(output.file("mission.gif"))
    return [filmed.result]


def _stage_of(result: MissionResult) -> str:
    """Return the stage to which a mission without success is counted."""
    return result.inconsistent or result.failed_stage or "insert"


def _success(results: Results) -> Distribution:
    return success_fraction(result.success for result in results)


def _arrived(results: Results) -> Distribution:
    return success_fraction(result.arrived for result in results)


def _measure_some(key: str, values: Sequence[float], output: Output) -> None:
    """Store the distribution of the finite values, if there are any."""
    finite = [value for value in values if math.isfinite(value)]
    if finite:
        output.measure(key, distribution(finite))


def _check(what: str, value: float, low: float, high: float, output: Output) -> None:
    """Check that a value is within limits, of which one may be infinite."""
    limits = [f">= {low:g}"] * math.isfinite(low) + [f"<= {high:g}"] * math.isfinite(high)
    output.check(what, value, ", ".join(limits), low <= value <= high)


def _measure(results: Results, options: Options, output: Output) -> None:
    """Measure whole missions, as far as they were to run."""
    if options.only == "all":
        for what, share, bar in (
            ("arrived_fraction", _arrived(results), ARRIVED),
            ("success_fraction", _success(results), SUCCEEDED),
        ):
            output.measure(what, share)
            _check(what, share["mean"], bar, math.inf, output)
        there = [result for result in results if result.arrived]
        if there:
            share = _success(there)
            output.measure("success_of_arrived", share)
            _check("success_of_arrived", share["mean"], OF_ARRIVED, math.inf, output)
    for stage in STAGES:
        output.measure(f"failures/{stage}", sum(r.failed_stage == stage for r in results))
        output.measure(f"inconsistent/{stage}", sum(r.inconsistent == stage for r in results))
        spent = [r.radio_bytes[stage] for r in results if stage in r.radio_bytes]
        _measure_some(f"radio_bytes/{stage}", spent, output)
        lasted = [_seconds(r)[stage] for r in results if stage in r.stages]
        _measure_some(f"stage_seconds/{stage}", lasted, output)
    maps = [r.map_bytes for r in results]
    output.measure("map_bytes", distribution(maps))
    _check("bytes of maps on the air", max(maps), -math.inf, MAP_BYTES, output)
    output.measure("seconds", distribution(r.seconds for r in results))
    _measure_some("wall_over_sim_time", [r.wall_over_sim for r in results], output)
    for index, robot in enumerate(("master", "slave")):
        output.measure(f"driven_m/{robot}", distribution(r.driven[index] for r in results))
    _measure_contacts(results, output)
    _measure_places(results, output)


def _measure_contacts(results: Results, output: Output) -> None:
    seen = [result for result in results if _seen(result)]
    if seen:
        touches, fallen = _touches(seen), sum(len(result.fallen) for result in seen)
        output.measure("collisions", sum(touches))
        output.measure("collided_fraction", success_fraction(count > 0 for count in touches))
        output.measure("tip_overs", fallen)
        for what, count in (("collisions", sum(touches)), ("rovers tipped over", fallen)):
            _check(what, count, -math.inf, 0, output)
    _measure_some("snap_force_n", [r.snap for r in results], output)
    forces = [r.peak for r in results if r.peak > 0.0]
    if forces:
        output.measure("contact_force_n", distribution(forces))
        most = float(np.percentile(forces, 95.0))
        _check("contact force, p95 [N]", most, -math.inf, FORCE, output)
        touched = success_fraction(r.touch > TOUCH for r in results if r.peak > 0.0)
        output.measure("contact_fraction", touched)
        _check("insertions that touch the guides", touched["mean"], TOUCHED, math.inf, output)


def _measure_places(results: Results, output: Output) -> None:
    """Measure where the master believes the slot to be at its station, and the ways there."""
    ways = [path for r in results for path in r.paths if 0.0 < path.shortest < math.inf]
    ratios = [path.driven / path.shortest for path in ways]
    _measure_some("path_ratio", ratios, output)
    stops = [r.misses[0] for r in results if len(r.misses)]
    _measure_some("first_stop_miss_mm", [1e3 * far for far, _ in stops], output)
    _measure_some("first_stop_miss_deg", [math.degrees(turn) for _, turn in stops], output)
    stations = [each for result in results for each in result.beliefs if _is_station(each)]
    if not stations:
        return
    values = {
        "station_error_mm": ([1e3 * each.error for each in stations], -math.inf, STATION[0]),
        "station_error_deg": ([math.degrees(e.turn) for e in stations], -math.inf, STATION[1]),
        "station_nees": ([each.nees / 6.0 for each in stations], *NEES),
    }
    for key, (found, low, high) in values.items():
        output.measure(key, distribution(found))
        _check(f"{key}, median", float(np.median(found)), low, high, output)
    if ratios:
        _check("path_ratio, median", float(np.median(ratios)), -math.inf, RATIO, output)


def _is_station(belief: BeliefResult) -> bool:
    return belief.stage == "place" and belief.robot == MASTER


def _seen(result: MissionResult) -> bool:
    """Return whether it is known what rovers and card touched: not if boards run the physics."""
    return math.isfinite(result.peak)


def _touches(results: Results) -> list[int]:
    return [len(result.collisions) for result in results]


def _seconds(result: MissionResult) -> dict[str, float]:
    """Return the durations of the stages that have ended [s], by name."""
    ends = [0.0, *result.stages.values()]
    return {name: end - begin for name, begin, end in zip(result.stages, ends, ends[1:])}


def _compare(cells: dict[str, list[MissionResult]], output: Output) -> None:
    """Compare further missions with the whole ones of the same seeds."""
    whole, others = cells[""], [cell for cell in cells if cell]
    succeeded = [result.success for result in whole]
    tests: dict[str, float] = {}
    for cell in others:
        results = cells[cell]
        output.measure(f"success_fraction/{cell}", _success(results))
        output.measure(f"arrived_fraction/{cell}", _arrived(results))
        differ = [(a, b.success) for a, b in zip(succeeded, results, strict=True)]
        changes = [differ.count((True, False)), differ.count((False, True))]
        output.measure(f"lost_and_won/{cell}", changes)
        tests[f"success_p/{cell}"] = mcnemar(succeeded, [each for _, each in differ])
        if all(_seen(result) for result in [*whole, *results]):
            output.measure(f"collisions/{cell}", sum(_touches(results)))
            more = np.subtract(_touches(results), _touches(whole))
            tests[f"collisions_p/{cell}"] = sign_test(more)
    for key, p in holm(tests).items():
        output.measure(key, p)


def _tabulate(
    cells: Sequence[str], jobs: list[MissionTrial], results: Results, output: Output
) -> None:
    names = np.repeat(cells, len(jobs) // len(cells)).tolist()
    columns = ["cell", "seed", "success", "arrived", "stage", "reason", "time [s]", "wall/time",
               "slave off its place [mm]", "collisions", "driven [m]", "peak [N]", "snap [N]",
               "across [mm]", "ahead [mm]", "yaw [deg]", "map [bytes]"]  # fmt: skip
    rows = [
        [name or "whole", j.seed, r.success, r.arrived, "" if r.success else _stage_of(r),
         r.reason, r.seconds, r.wall_over_sim, 1e3 * r.place_error, len(r.collisions),
         sum(r.driven), r.peak, r.snap, 1e3 * r.card[0], 1e3 * r.card[1],
         math.degrees(r.card[4]), r.map_bytes]
        for name, j, r in zip(names, jobs, results, strict=True)
    ]  # fmt: skip
    output.table("missions", columns, rows)
    said = [
        [name or "whole", j.seed, words]
        for name, j, r in zip(names, jobs, results, strict=True)
        for words in r.notices
    ]
    for name, seed, words in said:
        print(f"{name} mission, seed {seed}: {words}")
    if said:
        output.table("notices", ["cell", "seed", "notice"], said)
