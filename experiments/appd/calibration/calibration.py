"""``appd-calibration``: Table D-1, the inclinometers calibrated by weighing on a tilting table.

The emulated inclinometers have Table D-1's constants, which the procedure must find again. It sees
voltages after a 10-bit converter and the force/torque sensor, never the tilt itself.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.appd.calibration.calibration_options import Options
from experiments.appd.calibration.tilt_table import (
    BITS,
    WeighedRobot,
    WeighingJob,
    converter,
    true_sensors,
    weigh_one,
)
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.datasheets import ARM, DEGREE, INCLINOMETER, INCLINOMETER_CALIBRATION
from perception.geometry.gravity import GRAVITY
from twin.hardware.calibration.tilt_fit import (
    Sample,
    TiltLine,
    Weighing,
    fit_tilt,
    weighed_tilts,
)

AXES = ("pitch", "roll")
FITS = {
    "two_point/with_sag": {"two_point": True, "without_sag": False},
    "two_point/without_sag": {"two_point": True, "without_sag": True},
    "least_squares/with_sag": {"two_point": False, "without_sag": False},
    "least_squares/without_sag": {"two_point": False, "without_sag": True},
}
THESIS, OURS = "two_point/with_sag", "least_squares/without_sag"
MISALIGNMENT = 0.5 * DEGREE  # of the force/torque sensor about each axis, one standard deviation
ARM_WEIGHT = ARM.mass * GRAVITY
SLOPE_BOUND, ZERO_BOUND, TILT_BOUND = 1.0, 0.5, 0.3  # [%], [%], [deg]


def run(options: Options, output: Output) -> None:
    """Calibrate both robots of Table D-1 once for each seed, and score.

    Args:
        options: ``quick`` takes 3 seeds instead of 24.
        output: Receives ``calibration_error_percent`` and the constants beside Table D-1's.
    """
    configs = [
        WeighingJob(seed, key)
        for seed in options.job_seeds(24, 3)
        for key in INCLINOMETER_CALIBRATION
    ]
    runs = sweep(weigh_one, configs, options, output, label="calibrations")
    rows = [row for run in runs for row in _rows(run)]
    _measure_constants(rows, output)
    _measure_errors(rows, runs, output)
    _check(rows, output)
    columns = [field.name for field in dataclasses.fields(FittedAxis)]
    output.table("calibrations", columns, [dataclasses.astuple(row) for row in rows])
    output.table("table_d-1", *_table_d_1(rows))
    output.figure("table_d-1", _figure(runs[: len(INCLINOMETER_CALIBRATION)]))


@dataclasses.dataclass(frozen=True)
class FittedAxis:
    """The constants of one inclinometer axis by one fit, compared with the true ones.

    Attributes:
        seed: Random seed of the run.
        robot: Robot of Table D-1.
        axis: Axis of the inclinometer, pitch or roll.
        fit: Name of the fit.
        bits: Resolution of the converter [bit].
        zero_volts: Output at angle zero [V].
        mv_per_degree: Sensitivity [mV/deg].
        zero_error_percent: Error of the zero voltage [%].
        zero_error_degree: Signed error of the zero voltage, as an angle [deg].
        slope_error_percent: Error of the sensitivity [%].
        tilt_error_degree: Largest error of a tilt within the linear range [deg].
        zero_deviates: Error of the zero voltage in standard errors.
        slope_deviates: Error of the sensitivity in standard errors.
    """

    seed: int
    robot: str
    axis: str
    fit: str
    bits: int
    zero_volts: float
    mv_per_degree: float
    zero_error_percent: float
    zero_error_degree: float
    slope_error_percent: float
    tilt_error_degree: float
    zero_deviates: float
    slope_deviates: float


def misaligned(weighing: Weighing, rotation: np.ndarray) -> Weighing:
    """Return a weighing as measured by a force/torque sensor turned by ``rotation`` (3,) [rad]."""

    def turned(sample: Sample) -> Sample:
        force = sample.force + np.cross(rotation, sample.force)
        return dataclasses.replace(sample, force=force)

    return Weighing(turned(weighing.before), turned(weighing.after))


def _rows(run: WeighedRobot) -> list[FittedAxis]:
    """Return one row of constants and errors for each way to fit, converter and axis."""
    rows: list[FittedAxis] = []
    for bits, data in zip(BITS, run.weighings):
        for name, how in FITS.items():
            rows += _scored(run, name, bits, fit_tilt(data, ARM_WEIGHT, **how))
    rng = np.random.default_rng([run.seed, sorted(INCLINOMETER_CALIBRATION).index(run.key)])
    rotation = rng.normal(0.0, MISALIGNMENT, 3)
    data = [misaligned(weighing, rotation) for weighing in run.weighings[0]]
    return rows + _scored(run, "misaligned", BITS[0], fit_tilt(data, ARM_WEIGHT))


def _scored(run: WeighedRobot, name: str, bits: int, lines: Sequence[TiltLine]) -> list[FittedAxis]:
    """Return a row for each axis."""
    rows: list[FittedAxis] = []
    for axis, line, truth in zip(AXES, lines, true_sensors(run.key)):
        zero = line.zero_volts - truth.zero_volts
        slope = line.volts_per_radian - truth.volts_per_radian
        ends = np.array([-1.0, 1.0]) * INCLINOMETER.linear_range
        worst = np.max(np.abs(truth.angle(line.volts_per_radian * ends + line.zero_volts) - ends))
        rows.append(
            FittedAxis(
                seed=run.seed,
                robot=run.key,
                axis=axis,
                fit=name,
                bits=bits,
                zero_volts=line.zero_volts,
                mv_per_degree=1000.0 * line.volts_per_radian * DEGREE,
                zero_error_percent=100.0 * abs(zero) / truth.zero_volts,
                zero_error_degree=zero / truth.volts_per_radian / DEGREE,
                slope_error_percent=100.0 * abs(slope / truth.volts_per_radian),
                tilt_error_degree=worst / DEGREE,
                zero_deviates=abs(zero) / line.zero_error,
                slope_deviates=abs(slope) / line.slope_error,
            )
        )
    return rows


def _column(rows: Sequence[FittedAxis], name: str, **chosen: Any) -> list[float]:
    """Return one column of the rows that have the chosen values; 10 bits unless said."""
    chosen = {"bits": BITS[0], **chosen}
    return [
        getattr(row, name)
        for row in rows
        if all(getattr(row, key) == value for key, value in chosen.items())
    ]


def _measure_constants(rows: Sequence[FittedAxis], output: Output) -> None:
    """Store Table D-1 beside the thesis'."""
    for key, table in INCLINOMETER_CALIBRATION.items():
        for axis, truth in table.items():
            for column, thesis in (
                ("zero_volts", truth.zero_voltage),
                ("mv_per_degree", 1000.0 * truth.sensitivity),
            ):
                found = distribution(_column(rows, column, robot=key, axis=axis, fit=OURS))
                output.measure(f"{column}/{key}/{axis}", found, thesis=thesis)
            step = converter(key, BITS[0]).step
            output.measure(f"degree_per_count/{key}/{axis}", step / truth.sensitivity)


def _measure_errors(
    rows: Sequence[FittedAxis], runs: Sequence[WeighedRobot], output: Output
) -> None:
    """Store how far the constants are off, by fit, by converter, and what spoils them."""
    ours = distribution(_column(rows, "slope_error_percent", fit=OURS))
    output.measure("calibration_error_percent", ours)
    for name in (*FITS, "misaligned"):
        for metric, column in (
            ("calibration_error_percent", "slope_error_percent"),
            ("zero_error_percent", "zero_error_percent"),
            ("tilt_error_degree", "tilt_error_degree"),
        ):
            output.measure(f"{metric}/{name}", distribution(_column(rows, column, fit=name)))
        for axis in AXES:
            zeros = _column(rows, "zero_error_degree", fit=name, axis=axis)
            output.measure(f"zero_bias_degree/{name}/{axis}", distribution(zeros))
    for index, bits in enumerate(BITS):
        slopes = _column(rows, "slope_error_percent", fit=OURS, bits=bits)
        output.measure(f"calibration_error_percent/{bits}_bits", distribution(slopes))
        worst = _column(rows, "tilt_error_degree", fit=OURS, bits=bits)
        output.measure(f"tilt_error_degree/{bits}_bits", distribution(worst))
        single = np.concatenate([run.reading_rms[index].ravel() for run in runs]) / DEGREE
        output.measure(f"reading_rms_degree/{bits}_bits", distribution(single))
    sag = np.concatenate([run.sag for run in runs]) / DEGREE
    output.measure("sag_degree/pitch", distribution(sag[:, 0]))
    output.measure("sag_degree/roll_largest", float(np.max(np.abs(sag[:, 1]))))
    for what in ("zero", "slope"):
        deviates = np.array(_column(rows, f"{what}_deviates", fit=OURS))
        covered = fraction(int(np.sum(deviates <= 2.0)), deviates.size)
        output.measure(f"within_two_standard_errors/{what}", covered)


def _check(rows: Sequence[FittedAxis], output: Output) -> None:
    """Hold the constants against the bars."""
    for text, column, bound in (
        ("sensitivity's error, median [%]", "slope_error_percent", SLOPE_BOUND),
        ("zero angle voltage's error, median [%]", "zero_error_percent", ZERO_BOUND),
        ("tilt's error within +-20 degrees, median in degrees", "tilt_error_degree", TILT_BOUND),
    ):
        median = float(np.median(_column(rows, column, fit=OURS)))
        output.check(text, median, f"<= {bound:g}", median <= bound)
    ours = float(np.median(_column(rows, "tilt_error_degree", fit=OURS)))
    thesis = float(np.median(_column(rows, "tilt_error_degree", fit=THESIS)))
    output.check(
        "tilt's error, ours over the thesis' two points", ours / thesis, "< 1", ours < thesis
    )


def _table_d_1(rows: Sequence[FittedAxis]) -> tuple[list[str], list[list[Any]]]:
    """Return the medians of every way to fit beside Table D-1."""
    columns = ["robot", "axis", "zero_thesis_V", "mV_per_degree_thesis"]
    columns += [f"{what} {name}" for name in FITS for what in ("zero_V", "mV_per_degree")]
    body: list[list[Any]] = []
    for key, table in INCLINOMETER_CALIBRATION.items():
        for axis, truth in table.items():
            medians = [
                float(np.median(_column(rows, column, robot=key, axis=axis, fit=name)))
                for name in FITS
                for column in ("zero_volts", "mv_per_degree")
            ]
            body.append([key, axis, truth.zero_voltage, 1000.0 * truth.sensitivity, *medians])
    return columns, body


def _figure(runs: Sequence[WeighedRobot]) -> Figure:
    """Draw voltage over tilt, and how far the weighed tilts are from the true ones."""
    figure = Figure(figsize=(11, 8))
    grid = figure.subplots(2, 2, sharex="col")
    for column, (axis, upper, lower) in enumerate(zip(AXES, *grid)):
        for run, marker in zip(runs, "os"):
            _draw_axis(upper, lower, run, column, marker)
        upper.set(title=f"{axis} axis", ylabel="output of the inclinometer [V]")
        lower.set(xlabel=f"{axis} with the weight on [deg]", ylabel="weighed minus true [deg]")
        lower.axhline(0.0, color="k", linewidth=0.8)
        upper.legend()
        upper.grid(alpha=0.3)
        lower.grid(alpha=0.3)
    handles, labels = figure.axes[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False)
    figure.set_layout_engine("tight", rect=(0.0, 0.04, 1.0, 1.0))
    return figure


def _draw_axis(upper: Any, lower: Any, run: WeighedRobot, column: int, marker: str) -> None:
    """Draw one robot's axis: its line from weighings, and the residuals with and without sag."""
    data = run.weighings[0]
    lines = fit_tilt(data, ARM_WEIGHT)
    line, slopes = lines[column], [each.volts_per_radian for each in lines]
    volts = np.array([weighing.after.volts[column] for weighing in data])
    truth = run.truth[:, column] / DEGREE
    ends = np.array([-20.0, 20.0])
    found = upper.plot(ends, line.zero_volts + line.volts_per_radian * ends * DEGREE, linewidth=0.9)
    colour = found[0].get_color()
    tilts = weighed_tilts(data, slopes, ARM_WEIGHT)[:, column] / DEGREE
    sensitivity = 1000.0 * line.volts_per_radian * DEGREE
    label = f"{run.key}: {line.zero_volts:.3f} V, {sensitivity:.2f} mV/deg"
    upper.plot(tilts, volts, marker, color=colour, markersize=5, label=label)
    raw = weighed_tilts(data, None, ARM_WEIGHT)[:, column] / DEGREE
    lower.plot(
        truth,
        raw - truth,
        marker,
        color=colour,
        fillstyle="none",
        label=f"{run.key}, as the thesis",
    )
    lower.plot(truth, tilts - truth, marker, color=colour, label=f"{run.key}, sag taken out")
