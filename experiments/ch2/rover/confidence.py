"""How well robots know themselves, and whether they know how well."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from controllers.identification.pitch import NAMES, PitchEstimate
from experiments.harness.intervals import distribution, success_fraction
from experiments.harness.output import Output
from perception.geometry.arrays import FloatArray

FALSE_DEVIATIONS = 4.0
"""Deviations from the laboratory's value beyond which a used parameter counts as falsely known."""


@dataclasses.dataclass(frozen=True)
class RobotIdentification:
    """Identification of one robot, beside what a laboratory measures of it.

    Attributes:
        robot: Name of the robot.
        parameters: (5,) estimates, in the order of `controllers.identification.pitch.NAMES`.
        sigma: (5,) their standard deviations.
        chi_square: Squared prediction errors over their variances, per reading.
        doubts: Why the estimate is not used; none if it is.
        truth: (5,) what a laboratory measures of this robot.
    """

    robot: str
    parameters: FloatArray
    sigma: FloatArray
    chi_square: float
    doubts: tuple[str, ...]
    truth: FloatArray

    @classmethod
    def of(
        cls,
        robot: str,
        estimate: PitchEstimate,
        doubts: tuple[str, ...],
        truth: Mapping[str, float],
    ) -> "RobotIdentification":
        """Return an estimate beside the laboratory's values.

        Args:
            robot: Name of the robot.
            estimate: Final estimate.
            doubts: Why it is not used; none if it is.
            truth: Laboratory's values by name.
        """
        return cls(
            robot,
            estimate.parameters,
            np.sqrt(np.diag(estimate.covariance)),
            estimate.chi_square,
            doubts,
            np.array([truth[name] for name in NAMES]),
        )

    @property
    def error_percent(self) -> FloatArray:
        """Magnitude of each parameter's error in percent of its true value, (5,)."""
        return 100 * np.abs(self.parameters - self.truth) / np.abs(self.truth)

    @property
    def deviations(self) -> FloatArray:
        """Error of each parameter over its standard deviation, (5,)."""
        return (self.parameters - self.truth) / self.sigma


def measure_confidence(found: Sequence[RobotIdentification], output: Output) -> None:
    """Report errors, coverage and confidence of identifications.

    Args:
        found: Identifications, at least one.
        output: Receives ``identification_error_percent/<robot>``,
            ``identification_error_percent/<robot>/<parameter>``, ``identification_chi_square``,
            ``identification_coverage95/<parameter>``, ``identified_fraction``,
            ``false_confidence_fraction`` and a table of all.
    """
    for robot in sorted({each.robot for each in found}):
        errors = np.array([each.error_percent for each in found if each.robot == robot])
        key = f"identification_error_percent/{robot}"
        output.measure(key, distribution(errors.mean(axis=1)))
        for name, column in zip(NAMES, errors.T):
            output.measure(f"{key}/{name}", distribution(column))
    output.measure("identification_chi_square", distribution([e.chi_square for e in found]))
    output.measure("identified_fraction", success_fraction(not each.doubts for each in found))
    off = np.array([each.deviations for each in found if not each.doubts]).reshape(-1, len(NAMES))
    if len(off):
        for name, column in zip(NAMES, np.abs(off).T):
            within = success_fraction(column <= 1.96)  # noqa: PLR2004
            output.measure(f"identification_coverage95/{name}", within)
        false = np.abs(off).max(axis=1) > FALSE_DEVIATIONS
        output.measure("false_confidence_fraction", success_fraction(false))
    columns = ["robot", *(f"{name} [deviations]" for name in NAMES), "error [%]", "chi squared"]
    rows = [
        [
            each.robot,
            *(f"{value:.2f}" for value in each.deviations),
            f"{each.error_percent.mean():.1f}",
            f"{each.chi_square:.2f}",
            "; ".join(each.doubts),
        ]
        for each in found
    ]
    output.table("identification", [*columns, "not used because"], rows)
