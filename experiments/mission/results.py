"""Results of several missions by stage; a mission without a map has one stage less."""

from collections.abc import Mapping, Sequence

from experiments.mission.trial import MissionResult, StageResult

Results = Sequence[MissionResult]


def stages_of(results: Results) -> list[str]:
    """Return the names of all stages that any mission has ended, in their order.

    Args:
        results: Results of missions.
    """
    names: list[str] = []
    for result in sorted(results, key=lambda each: -len(each.stages)):
        place = 0
        for name in result.stage_names:
            if name not in names:
                names.insert(place, name)
            place = names.index(name) + 1
    return names


def after_stage(results: Results, name: str) -> list[StageResult]:
    """Return the results of a stage in the missions that have ended it.

    Args:
        results: Results of missions.
        name: Name of the stage.
    """
    return [stage for result in results for stage in result.stages if stage.name == name]


def stage_seconds(result: MissionResult) -> dict[str, float]:
    """Return the durations of a mission's stages [s], by name.

    Args:
        result: Result of the mission.
    """
    ends = [0.0, *(stage.ended for stage in result.stages)]
    return {name: end - begin for name, begin, end in zip(result.stage_names, ends, ends[1:])}


def first_stops(cells: Mapping[str, Results]) -> dict[str, list[float]]:
    """Return the distances of the master's first stops from its station [m], by kind of mission.

    Args:
        cells: Results of missions, by kind; missions without a drive are left out.
    """
    return {
        kind: [float(result.misses[0, 0]) for result in results if len(result.misses)]
        for kind, results in cells.items()
    }


def off_middle(cells: Mapping[str, Results]) -> dict[str, list[float]]:
    """Return the final distances of inserted cards from the slot's middle [m], by kind of mission.

    Args:
        cells: Results of missions, by kind.
    """
    return {
        kind: [abs(float(result.across)) for result in results if result.success]
        for kind, results in cells.items()
    }
