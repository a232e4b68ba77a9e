"""Interactive calibration of the inclinometer with a weight and a few wedges (Thesis app. D).

`tilt_procedure` is a generator without input or output: it yields instructions and receives the
measurements. `run_procedure` connects it to the operator and the sensors by functions.
"""

import dataclasses
import datetime
import math
from collections.abc import Callable, Generator, Sequence
from typing import Final

import numpy as np

from models.datasheets import ARM, DEGREE, INCLINOMETER, INCLINOMETER_CALIBRATION
from perception.geometry.checks import check_numbers
from perception.geometry.gravity import GRAVITY
from twin.hardware.calibration.calibration import AngleSensor, Calibration
from twin.hardware.calibration.tilt_fit import (
    Sample,
    TiltLine,
    Weighing,
    fit_tilt,
    tilt_of_up,
    weighed_tilts,
)

_AXES: Final = ("pitch", "roll")
_TABLE_D_1: Final = [
    axis.sensitivity for axes in INCLINOMETER_CALIBRATION.values() for axis in axes.values()
]
USUAL_SENSITIVITY: Final = float(np.mean(_TABLE_D_1)) / DEGREE
"""Mean of Table D-1's sensitivities, for plausibility only [V/rad]."""


class ProcedureError(RuntimeError):
    """The readings give no valid calibration, or the operator stopped; nothing was changed."""


@dataclasses.dataclass(frozen=True)
class ProcedureConfig:
    """Tilts, weights and acceptance limits of the calibration.

    Attributes:
        tilts: Pitch and roll of each tilt [rad]; the wedges need not be exact.
        weight: Mass hung on the gripper [kg].
        arm_mass: Mass carried by the force/torque sensor [kg].
        least_span: Smallest angle between the outermost tilts of an axis [rad].
        least_step: Smallest angle between two tilts, in at least one of the axes [rad].
        largest_tilt: End of the inclinometer's linear range [rad].
        weight_tolerance: Largest relative difference between the added force and the weight.
        least_signal: Smallest ratio of the added force to its standard error.
        largest_wander: Largest standard error of a voltage, as an angle [rad]; a larger one means
            that the robot moved.
        sensitivity_tolerance: Largest relative difference from `USUAL_SENSITIVITY`.
        largest_residual: Largest residual of a fitted line, as an angle [rad].
        attempts: Number of failures of one tilt that end the procedure.
    """

    tilts: tuple[tuple[float, float], ...] = (
        (0.0, 0.0),
        (12.0 * DEGREE, 0.0),
        (-12.0 * DEGREE, 0.0),
        (0.0, 12.0 * DEGREE),
        (0.0, -12.0 * DEGREE),
    )
    weight: float = 0.5
    arm_mass: float = ARM.mass
    least_span: float = 12.0 * DEGREE
    least_step: float = 3.0 * DEGREE
    largest_tilt: float = INCLINOMETER.linear_range
    weight_tolerance: float = 0.1
    least_signal: float = 50.0
    largest_wander: float = 0.1 * DEGREE
    sensitivity_tolerance: float = 0.4
    largest_residual: float = 0.5 * DEGREE
    attempts: int = 5

    def __post_init__(self) -> None:
        """Reject tilts and limits from which no calibration follows.

        Raises:
            ValueError: Naming the field and its value.
        """
        if len(self.tilts) < 3:
            raise ValueError(f"procedure tilts: got {len(self.tilts)}, needs at least 3")
        if not np.all(np.abs(np.array(self.tilts)) < self.largest_tilt):
            raise ValueError(f"procedure tilts: {self.tilts} leave the linear range")
        fields = (field.name for field in dataclasses.fields(self) if field.name != "tilts")
        check_numbers("procedure", self, *fields)


@dataclasses.dataclass(frozen=True)
class Instruction:
    """Task of the operator before the next measurement.

    Attributes:
        text: Text to show.
        problem: Reason why the last measurement was rejected; empty if it was not.
    """

    text: str
    problem: str = ""


@dataclasses.dataclass(frozen=True)
class TiltResult:
    """Result of the calibration procedure.

    Attributes:
        calibration: Calibration with the new inclinometer section.
        pitch: Line of the pitch axis.
        roll: Line of the roll axis.
        weighings: Accepted weighings, one for each tilt.
    """

    calibration: Calibration
    pitch: TiltLine
    roll: TiltLine
    weighings: tuple[Weighing, ...]

    @property
    def text(self) -> str:
        """Constants with their standard errors, in the units of Table D-1."""
        rows = [
            f"{name}: zero at {line.zero_volts:.4f} +- {line.zero_error:.4f} V, "
            f"{1000.0 * line.volts_per_radian * DEGREE:.3f} +- "
            f"{1000.0 * line.slope_error * DEGREE:.3f} mV/degree"
            for name, line in zip(_AXES, (self.pitch, self.roll))
        ]
        return "\n".join(rows)


def tilt_procedure(
    calibration: Calibration, config: ProcedureConfig, today: datetime.date
) -> Generator[Instruction, Sample, TiltResult]:
    """Yield instructions, receive the sample measured after each, and return the new constants.

    Each tilt takes two samples, without and with the weight. An implausible sample or tilt is
    rejected with the reason, and repeated.

    Args:
        calibration: Present calibration of the robot; only the inclinometer section changes.
        config: Tilts and acceptance limits.
        today: Date of the new section.

    Raises:
        ProcedureError: If a tilt fails too often or the constants are not plausible.
    """
    weighings: list[Weighing] = []
    for number, wanted in enumerate(config.tilts, 1):
        problem = ""
        for _ in range(config.attempts):
            place = f"Tilt {number} of {len(config.tilts)}: take the weight off; {_words(wanted)}"
            before = yield Instruction(place, problem)
            hang = (
                f"Hang the weight of {config.weight:g} kg on the gripper, and let it come to rest."
            )
            after = yield Instruction(hang)
            weighing = Weighing(before, after)
            problem = _weighing_problem(weighing, weighings, config)
            if not problem:
                weighings.append(weighing)
                break
        else:
            raise ProcedureError(f"tilt {number} failed {config.attempts} times: {problem}")
    return _result(calibration, config, weighings, today)


def run_procedure(
    steps: Generator[Instruction, Sample, TiltResult],
    measure: Callable[[], Sample],
    ask: Callable[[str], str],
    show: Callable[[str], None],
) -> TiltResult:
    """Guide the operator through a procedure.

    Args:
        steps: Generator from `tilt_procedure`.
        measure: Returns a sample averaged over a second or more at rest.
        ask: Shows a question and returns the answer.
        show: Shows a line of text.

    Raises:
        ProcedureError: If the operator stops or the procedure fails.
    """
    try:
        instruction = next(steps)
        while True:
            if instruction.problem:
                show(f"Not taken: {instruction.problem}.")
            show(instruction.text)
            answer = ask("Enter when it is done, q to stop: ").strip().lower()
            if answer in ("q", "quit", "stop"):
                raise ProcedureError("stopped; the calibration is as it was")
            instruction = steps.send(measure())
    except StopIteration as end:
        result: TiltResult = end.value
    show(result.text)
    return result


def _words(tilt: tuple[float, float]) -> str:
    """Return the instruction that places the robot at a tilt."""
    pitch, roll = np.degrees(tilt).tolist()
    parts: list[str] = []
    if pitch:
        parts.append(f"raise its {'front' if pitch > 0.0 else 'rear'} by {abs(pitch):.0f} degrees")
    if roll:
        parts.append(
            f"raise its {'left' if roll > 0.0 else 'right'} side by {abs(roll):.0f} degrees"
        )
    what = " and ".join(parts) if parts else "put it on level ground"
    return f"{what}, roughly; block the wheels, keep the arm where it is and let go."


def _weighing_problem(
    weighing: Weighing, others: Sequence[Weighing], config: ProcedureConfig
) -> str:
    """Return the reason to reject a weighing; empty if it is plausible."""
    for one in (weighing.before, weighing.after):
        values = (one.volts, one.volts_error, one.force, one.force_error)
        if not all(np.all(np.isfinite(value)) for value in values):
            return "a sensor gave no number"
        if float(np.max(one.volts_error)) > config.largest_wander * USUAL_SENSITIVITY:
            return "the robot moved while it was measured"
    added, weight = float(np.linalg.norm(weighing.added)), config.weight * GRAVITY
    noise = math.hypot(*weighing.before.force_error, *weighing.after.force_error)
    if added < config.least_signal * noise:
        return f"the weight ({added:.2f} N) hardly shows above the noise ({noise:.3f} N)"
    if abs(added / weight - 1.0) > config.weight_tolerance:
        return f"the force grew by {added:.2f} N where the weight is {weight:.2f} N"
    tilt = tilt_of_up(weighing.added)
    if float(np.max(np.abs(tilt))) > config.largest_tilt:
        return (
            f"the tilt ({_degrees(tilt)}) leaves the linear range of {_degree(config.largest_tilt)}"
        )
    if others:
        nearest = np.abs(weighed_tilts(others, None, 0.0) - tilt).max(axis=1).min()
        if nearest < config.least_step:
            return f"the tilt ({_degrees(tilt)}) is too close to one that was measured before"
    return ""


def _result(
    calibration: Calibration,
    config: ProcedureConfig,
    weighings: Sequence[Weighing],
    today: datetime.date,
) -> TiltResult:
    """Fit the lines, check them and return the new calibration."""
    tilts = weighed_tilts(weighings, None, 0.0)
    for name, span in zip(_AXES, np.ptp(tilts, axis=0).tolist()):
        if span < config.least_span:
            raise ProcedureError(
                f"{name}: the tilts span {_degree(span)}, needs {_degree(config.least_span)}"
            )
    lines = fit_tilt(weighings, config.arm_mass * GRAVITY)
    for name, line in zip(_AXES, lines):
        slope = abs(line.volts_per_radian)
        if abs(slope / USUAL_SENSITIVITY - 1.0) > config.sensitivity_tolerance:
            raise ProcedureError(
                f"{name}: {1000.0 * line.volts_per_radian * DEGREE:.2f} mV/degree is far from the "
                f"usual {1000.0 * USUAL_SENSITIVITY * DEGREE:.0f}; is the right input wired?"
            )
        if line.residual > config.largest_residual * slope:
            raise ProcedureError(
                f"{name}: the readings lie {_degree(line.residual / slope)} off their line; "
                "something slipped or swung"
            )
    old = calibration.inclinometer
    section = dataclasses.replace(
        old,
        calibrated_on=today,
        source=f"weighings of {config.weight:g} kg at {len(weighings)} tilts (Thesis app. D)",
        pitch=_sensor(old.pitch, lines[0]),
        roll=_sensor(old.roll, lines[1]),
    )
    new = dataclasses.replace(calibration, inclinometer=section)
    return TiltResult(new, *lines, tuple(weighings))


def _sensor(old: AngleSensor, line: TiltLine) -> AngleSensor:
    return dataclasses.replace(
        old, zero_volts=line.zero_volts, volts_per_radian=line.volts_per_radian
    )


def _degree(angle: float) -> str:
    return f"{angle / DEGREE:.1f} degrees"


def _degrees(tilt: np.ndarray) -> str:
    pitch, roll = np.degrees(tilt).tolist()
    return f"pitch {pitch:.1f}, roll {roll:.1f} degrees"
