"""How well the robots of a mission identify themselves, and whether they know it."""

from collections.abc import Sequence

import numpy as np

from controllers.identification.pitch import NAMES
from experiments.harness.intervals import distribution, success_fraction
from experiments.harness.output import Output
from experiments.mission.trial import MissionResult, RobotIdentification

FALSE_DEVIATIONS = 4.0
"""Deviations from the laboratory's value beyond which a used parameter counts as falsely known."""


def measure_identification(missions: Sequence[MissionResult], output: Output) -> None:
    """Report errors, coverage and confidence of all identifications.

    Args:
        missions: Missions whose robots identified themselves.
        output: Receives ``identification_error_percent/<robot>``,
            ``identification_error_percent/<robot>/<parameter>``, ``identification_chi_square``,
            ``identification_coverage95/<parameter>``, ``identified_fraction``,
            ``false_confidence_fraction`` and a table of all.
    """
    found = [each for mission in missions for each in mission.identifications]
    if not found:
        return
    for robot in sorted({each.robot for each in found}):
        errors = np.array([_error_percent(each) for each in found if each.robot == robot])
        key = f"identification_error_percent/{robot}"
        output.measure(key, distribution(errors.mean(axis=1)))
        for name, column in zip(NAMES, errors.T):
            output.measure(f"{key}/{name}", distribution(column))
    output.measure("identification_chi_square", distribution([e.chi_square for e in found]))
    used = [each for each in found if not each.doubts]
    output.measure("identified_fraction", success_fraction(not each.doubts for each in found))
    if used:
        off = np.array([_deviations(each) for each in used])
        for name, column in zip(NAMES, off.T):
            within = success_fraction(np.abs(column) <= 1.96)  # noqa: PLR2004
            output.measure(f"identification_coverage95/{name}", within)
        false = np.abs(off).max(axis=1) > FALSE_DEVIATIONS
        output.measure("false_confidence_fraction", success_fraction(false))
    columns = ["robot", *(f"{name} [deviations]" for name in NAMES), "error [%]", "chi squared"]
    rows = [
        [
            each.robot,
            *(f"{value:.2f}" for value in _deviations(each)),
            f"{_error_percent(each).mean():.1f}",
            f"{each.chi_square:.2f}",
            "; ".join(each.doubts),
        ]
        for each in found
    ]
    output.table("identification", [*columns, "not used because"], rows)


def _error_percent(each: RobotIdentification) -> np.ndarray:
    return 100 * np.abs(each.parameters - each.truth) / np.abs(each.truth)


def _deviations(each: RobotIdentification) -> np.ndarray:
    return (each.parameters - each.truth) / each.sigma
