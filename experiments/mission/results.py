"""Results of several missions by stage; a mission without a map has one stage less."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Results = Sequence[Mapping[str, Any]]


def stages_of(results: Results) -> list[str]:
    """Return the names of all stages that any mission has ended, in their order.

    Args:
        results: Of `mission_trial.run_mission`.
    """
    names: list[str] = []
    for result in sorted(results, key=lambda each: -len(each["stage_names"])):
        place = 0
        for name in result["stage_names"]:
            if name not in names:
                names.insert(place, name)
            place = names.index(name) + 1
    return names


def after_stage(results: Results, name: str) -> dict[str, list[Any]]:
    """Return what was so after a stage, of the missions that have ended it.

    Args:
        results: Of `mission_trial.run_mission`.
        name: Of the stage.

    Returns:
        One entry for each of these missions: ``ends`` [s], ``turn_shares``, and ``master_errors``,
        ``master_sigmas``, ``slave_errors`` and ``slave_sigmas`` (3,) [m].
    """
    keys = {"ends": "stage_ends", "turn_shares": "turn_shares"}
    keys |= {f"{who}_{what}": f"{who}_{what}" for who in ("master", "slave")
             for what in ("errors", "sigmas")}  # fmt: skip
    there = [(result, result["stage_names"].index(name)) for result in results
             if name in result["stage_names"]]  # fmt: skip
    return {key: [result[told][place] for result, place in there] for key, told in keys.items()}


def stage_seconds(result: Mapping[str, Any]) -> dict[str, float]:
    """Return how long each stage of a mission took [s].

    Args:
        result: Of `mission_trial.run_mission`.
    """
    ends = [0.0, *result["stage_ends"]]
    return {name: end - begin for name, begin, end in zip(result["stage_names"], ends, ends[1:])}


def first_stops(cells: Mapping[str, Results]) -> dict[str, list[float]]:
    """Return how far from the camera's place the master stopped at first [m], by kind of mission.

    Args:
        cells: Results of `mission_trial.run_mission`, by kind; missions that stayed are left out.
    """
    return {
        kind: [float(result["misses"][0, 0]) for result in results if len(result["misses"])]
        for kind, results in cells.items()
    }


def off_middle(cells: Mapping[str, Results]) -> dict[str, list[float]]:
    """Return how far inserted cards ended from the slot's middle [m], by kind of mission.

    Args:
        cells: Results of `mission_trial.run_mission`, by kind.
    """
    return {
        kind: [abs(float(result["across"])) for result in results if result["success"]]
        for kind, results in cells.items()
    }
