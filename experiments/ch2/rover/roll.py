"""How well a robot tells its roll, and what its centre joint's potentiometer brings to that."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from controllers.identification.pitch import UNITS, PitchData, PitchEstimate, PitchFit
from controllers.identification.pitch_model import smoothed
from controllers.identification.rover_identifier import RoverIdentifier
from controllers.identification.swing_plane import ROLL
from experiments.harness.intervals import distribution, success_fraction
from experiments.harness.output import Output
from perception.geometry.arrays import FloatArray

LEVER = ROLL.parameters.index("rx")
"""The arm's lever to the side, which only tolerances differ from zero: its error is in mm."""
_WITHIN = 1.96  # Deviations that hold 95 %.


def front_alone(identifier: RoverIdentifier) -> PitchEstimate:
    """Return what the same motion tells without the centre joint's angle.

    Args:
        identifier: Identifier of roll whose motion is over.
    """
    log, config = identifier.log, identifier.config
    front = np.array(log.tilt) - np.array(log.half_twist)[log.tilt_indices]
    fit = PitchFit(config.sensors, config.prior, names=config.plane.parameters)
    wrench = smoothed(np.array(log.wrench), config.sensors)
    for _ in fit.search(PitchData.of(wrench, log.tilt_indices, front)):
        pass
    return fit.estimate


def measure_roll(
    excitation: str,
    estimates: Sequence[PitchEstimate],
    fronts: Sequence[PitchEstimate],
    truths: Sequence[Mapping[str, float]],
    output: Output,
) -> None:
    """Report errors and stated deviations of roll against each robot's laboratory.

    Args:
        excitation: Name of the excitation.
        estimates: Estimates of roll.
        fronts: Estimates of the same motions without the centre joint's angle.
        truths: Laboratory values by name of each robot.
        output: Receives ``roll_error_percent/<excitation>`` and the like.
    """
    true = np.array([[truth[name] for name in ROLL.parameters] for truth in truths])
    found = np.array([each.parameters for each in estimates])
    sigma = np.sqrt([np.diag(each.covariance) for each in estimates])
    errors = roll_errors(found, true)
    apart = roll_errors(np.array([each.parameters for each in fronts]), true)
    within = np.abs(found - true) <= _WITHIN * sigma
    output.measure(f"roll_error_percent/{excitation}", distribution(errors.mean(axis=1)))
    output.measure(f"roll_front_alone_error_percent/{excitation}", distribution(apart.mean(axis=1)))
    names = [name for index, name in enumerate(ROLL.parameters) if index != LEVER]
    for name, own, front in zip(names, errors.T, apart.T, strict=True):
        output.measure(f"roll_error_percent/{excitation}/{name}", distribution(own))
        output.measure(f"roll_front_alone_error_percent/{excitation}/{name}", distribution(front))
    lever = 1e3 * np.abs(found - true)[:, LEVER]
    output.measure(f"roll_error_mm/{excitation}/rx", distribution(lever))
    output.measure(f"roll_deviation_mm/{excitation}/rx", distribution(1e3 * sigma[:, LEVER]))
    for name, column in zip(ROLL.parameters, within.T, strict=True):
        output.measure(f"roll_coverage95/{excitation}/{name}", success_fraction(column))
    chi_squares = [each.chi_square for each in estimates]
    output.measure(f"roll_chi_square/{excitation}", distribution(chi_squares))


def roll_errors(found: FloatArray, true: FloatArray) -> FloatArray:
    """Return (n, 4) errors of all but the lever to the side [%].

    Args:
        found: (n, 5) estimates.
        true: (n, 5) laboratory values.
    """
    relative = 100 * np.abs(found - true) / np.where(true == 0.0, np.inf, np.abs(true))
    return np.delete(relative, LEVER, axis=1)


def tabulate_roll(
    estimates: Mapping[str, Sequence[PitchEstimate]],
    truths: Sequence[Mapping[str, float]],
    output: Output,
) -> None:
    """Write the medians beside the laboratory's, to a file and to the terminal.

    Args:
        estimates: Estimates by excitation.
        truths: Laboratory values by name of each robot.
        output: Receives the table ``roll``.
    """
    medians = [
        np.median([each.parameters for each in found], axis=0) for found in estimates.values()
    ]
    columns = ["parameter", "unit", "laboratory", *(f"{name}, median" for name in estimates)]
    rows: list[Sequence[Any]] = []
    for index, (name, unit) in enumerate(zip(ROLL.parameters, UNITS, strict=True)):
        own = float(np.median([truth[name] for truth in truths]))
        rows.append([name, unit, f"{own:.4g}", *(f"{median[index]:.4g}" for median in medians)])
    output.table("roll", columns, rows)
    table = Table(*columns, title="Roll, laboratory and identified")
    for row in rows:
        table.add_row(*row)
    Console().print(table)
