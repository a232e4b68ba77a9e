"""Table 2-2: the complete rover identifies how it pitches, by inclinometer and arm wrench alone.

With ``--axis roll`` its roll in the same way, with its arm turned aside, which the thesis does not.
"""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun.blueprint as rrb
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.pitch import NAMES, UNITS
from controllers.identification.rover_identifier import RoverIdentifier
from controllers.identification.swing_plane import SwingPlane
from experiments.ch2.rover.confidence import RobotIdentification, measure_confidence
from experiments.ch2.rover.laboratory import laboratory_roll, laboratory_values
from experiments.ch2.rover.roll import measure_roll, tabulate_roll
from experiments.ch2.rover.rover_options import Options
from experiments.ch2.rover.trial import (
    ROBOT,
    RoverIdentification,
    RoverTrial,
    error_percent,
    rover_config,
    run_rover_trial,
)
from experiments.harness.figure_style import COLOURS
from experiments.harness.intervals import distribution, success_fraction
from experiments.harness.output import Output
from experiments.harness.recording import RunFiles
from experiments.harness.robot_option import check_calibrations
from experiments.harness.sweep import sweep
from models.compose import LABORATORY, RobotPlacement
from models.datasheets import (
    TABLE_2_2_AVERAGE_ERROR,
    TABLE_2_2_CONSTANT,
    TABLE_2_2_TRUTH,
    TABLE_2_2_VARIABLE,
)
from perception.geometry.arrays import FloatArray
from twin import loop
from twin.camera import StereoConfig
from twin.connect import connect
from twin.loop import LoopRecorder, Tick
from twin.recording.layout import default_blueprint
from twin.recording.record import Recorder

Results = dict[str, list[RoverIdentification]]
Truths = Sequence[Mapping[str, float]]
"""Laboratory values of each seed's robot, in the order of every excitation's trials."""

THESIS_COLUMN = {"constant": 0, "information": 1}


def run(options: Options, output: Output) -> None:
    """Run every excitation over the seeds and compare with each robot's laboratory values."""
    check_calibrations(options.robot)
    seeds = options.job_seeds(full=20, quick=3)
    trials = [
        RoverTrial(
            options.robot,
            excitation,
            seed,
            options.duration,
            realism=options.realism,
            axis=options.axis,
        )
        for excitation in options.chosen()
        for seed in seeds
    ]
    # A real robot does one thing at a time.
    real = options.robot.startswith("serial:")
    alone = dataclasses.replace(options, jobs=1) if real else options
    found = sweep(run_rover_trial, trials, alone, output, label="rover runs")
    results: Results = {name: [] for name in options.chosen()}
    for trial, result in zip(trials, found):
        results[trial.excitation].append(result)
    robots = [trial.placement for trial in trials[: len(seeds)]]
    measure = laboratory_roll if options.axis == "roll" else laboratory_values
    truths = sweep(measure, robots, options, output, label="robots in the laboratory")
    if options.axis == "roll":
        _report_roll(results, truths, output)
    else:
        _measure(results, truths, output)
        _figures(results, truths, output)
        _table(results, truths, output)
    if files := RunFiles.of(options, output):
        record_run(options, files)
        written = " and ".join(filter(None, (files.recording, files.log)))
        Console().print(f"recorded: {written}")


def _measure_laboratory(truths: Truths, thesis: Mapping[str, float], output: Output) -> None:
    for name in truths[0]:
        values = [truth[name] for truth in truths]
        alike = len(set(values)) == 1
        value = values[0] if alike else distribution(values)
        output.measure(f"laboratory/{name}", value, thesis=thesis.get(name))


def _report_roll(results: Results, truths: Truths, output: Output) -> None:
    _measure_laboratory(truths, {}, output)
    for excitation, trials in results.items():
        fronts = [t.front_alone for t in trials if t.front_alone is not None]
        measure_roll(excitation, [t.estimate for t in trials], fronts, truths, output)
        nrmse = distribution([t.tilt_nrmse for t in trials])
        output.measure(f"roll_prediction_nrmse/{excitation}", nrmse)
        used = success_fraction(not t.doubts for t in trials)
        output.measure(f"roll_identified_fraction/{excitation}", used)
        lost = {name for t in trials for name in t.unidentifiable}
        output.measure(f"roll_unidentifiable/{excitation}", sorted(lost))
    tabulate_roll({n: [t.estimate for t in ts] for n, ts in results.items()}, truths, output)
    output.figure("roll", draw_tilt(results))


def _measure(results: Results, truths: Truths, output: Output) -> None:
    _measure_laboratory(truths, TABLE_2_2_TRUTH, output)
    medians = {}
    for excitation, trials in results.items():
        errors = _errors(trials, truths)
        column = THESIS_COLUMN.get(excitation)
        thesis = None if column is None else TABLE_2_2_AVERAGE_ERROR[column]
        average = distribution(errors.mean(axis=1))
        medians[excitation] = average["median"]
        output.measure(f"avg_error_percent/{excitation}", average, thesis)
        nrmse = distribution([t.tilt_nrmse for t in trials])
        output.measure(f"tilt_prediction_nrmse/{excitation}", nrmse)
        output.measure(
            f"chi_square/{excitation}", distribution([t.estimate.chi_square for t in trials])
        )
        lost = {name for t in trials for name in t.unidentifiable}
        output.measure(f"unidentifiable/{excitation}", sorted(lost))
        gains = np.transpose([t.acceleration_gain for t in trials])
        for name, column_errors, gain in zip(NAMES, errors.T, gains, strict=True):
            output.measure(f"error_percent/{excitation}/{name}", distribution(column_errors))
            output.measure(f"acceleration_gain/{excitation}/{name}", distribution(gain))
        steps = 1e3 * np.concatenate([np.ravel(t.step_seconds) for t in trials])
        output.measure(f"step_ms/{excitation}", distribution(steps))
    if "information" in medians:
        measure_confidence(
            [
                RobotIdentification.of(ROBOT, t.estimate, t.doubts, truth)
                for t, truth in zip(results["information"], truths, strict=True)
            ],
            output,
        )
        nrmse = distribution([t.tilt_nrmse for t in results["information"]])
        output.measure("tilt_prediction_nrmse", nrmse)
        value = medians["information"]
        output.check("average error, information [%]", value, "<= 10", value <= 10)
        value = nrmse["median"]
        output.check("tilt of an unseen motion, NRMSE [%]", value, "<= 10", value <= 10)
    if {"information", "constant"} <= set(medians):
        ratio = medians["information"] / medians["constant"]
        output.measure("error_ratio_to_constant/information", ratio)
        output.check("average error, information over constant", ratio, "<= 0.2", ratio <= 0.2)


def _errors(trials: Sequence[RoverIdentification], truths: Truths) -> FloatArray:
    """Return each trial's errors (trials, 5) against its own robot's laboratory values [%]."""
    pairs = zip(trials, truths, strict=True)
    return np.array([error_percent(t.estimate.parameters, truth) for t, truth in pairs])


def _figures(results: Results, truths: Truths, output: Output) -> None:
    names = {"constant": "figure_2-9", "information": "figure_2-10"}
    for excitation, name in names.items():
        if excitation in results:
            output.figure(name, draw_arm_motion(results[excitation][0], excitation))
    output.figure("figure_2-11", draw_tilt(results))
    output.figure("figure_2-12", draw_convergence(results, truths))
    output.figure("errors_by_excitation", draw_errors(results, truths))


def _table(results: Results, truths: Truths, output: Output) -> None:
    """Write Table 2-2 beside the medians of our robots, to a file and to the terminal."""
    columns = ["parameter", "unit", "thesis true", "thesis constant", "thesis variable"]
    columns += ["laboratory (ours)"] + [f"{name}, median" for name in results]
    rows: list[Sequence[Any]] = []
    medians = {
        n: np.median([t.estimate.parameters for t in ts], axis=0) for n, ts in results.items()
    }
    for index, (name, unit) in enumerate(zip(NAMES, UNITS)):
        thesis = [t[name] for t in (TABLE_2_2_TRUTH, TABLE_2_2_CONSTANT, TABLE_2_2_VARIABLE)]
        ours = [float(np.median([truth[name] for truth in truths]))] + [
            float(m[index]) for m in medians.values()
        ]
        rows.append([name, unit, *thesis, *(f"{value:.4g}" for value in ours)])
    errors = [np.median(_errors(trials, truths).mean(axis=1)) for trials in results.values()]
    averages = [f"{value:.1f}" for value in TABLE_2_2_AVERAGE_ERROR]
    rows.append(["average error", "%", "", *averages, "", *(f"{value:.1f}" for value in errors)])
    output.table("table_2-2", columns, rows)
    table = Table(*columns, title="Table 2-2, thesis and ours")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    Console().print(table)


def record_run(options: Options, files: RunFiles) -> None:
    """Record or log one identification, under information if it was chosen."""
    chosen = options.chosen()
    excitation = "information" if "information" in chosen else chosen[0]
    config = rover_config(excitation, options.duration, options.axis)
    controller = RoverIdentifier(config, np.random.default_rng(options.seed))
    with (
        connect(
            options.robot,
            robots=[RobotPlacement(ROBOT)],
            field=LABORATORY,
            realism=options.realism,
            stereo=StereoConfig(),
            seed=options.seed,
        ) as connection,
        files.logged(connection.settings) as recorders,
        contextlib.ExitStack() as stack,
    ):
        if files.recording:
            layout = _blueprint(config.plane)
            recorder = stack.enter_context(
                Recorder(files.recording, connection.robots, connection.simulation, layout)
            )
            recorders += [recorder, EstimateRecorder(recorder, controller)]
        loop.run(connection.robots, [controller], connection.clock, recorders, config.total)


def _blueprint(plane: SwingPlane) -> rrb.Blueprint:
    """Return the usual layout with one view for each parameter: their sizes differ widely."""
    views = [
        rrb.TimeSeriesView(origin=f"estimates/{name}", name=f"{name} [{unit}]")
        for name, unit in zip(plane.parameters, UNITS)
    ]
    excitation = rrb.TimeSeriesView(origin="excitation", name="Excitation")
    return default_blueprint([ROBOT], [rrb.Grid(excitation, *views, grid_columns=3)])


class EstimateRecorder(LoopRecorder):
    """Adds the controller's estimates and excitations to a recording."""

    def __init__(self, recorder: Recorder, controller: RoverIdentifier) -> None:
        """Watch a controller."""
        self._recorder, self._controller, self._recorded = recorder, controller, 0

    def record(self, tick: Tick) -> None:
        """Record new estimates and excitations with their bands."""
        log = self._controller.log
        if len(log.estimates) == self._recorded:
            return
        self._recorded = len(log.estimates)
        estimate = log.estimates[-1]
        sigma = np.sqrt(np.diag(estimate.covariance))
        for name, value, band in zip(estimate.names, estimate.parameters, 2 * sigma):
            self._recorder.log_band(f"estimates/{name}", value, value - band, value + band, [name])
        names = ("offset [rad]", "amplitude [rad]", "frequency [rad/s]")
        self._recorder.log_scalars("excitation", np.array(log.excitations[-1]), names)


def draw_arm_motion(trial: RoverIdentification, excitation: str) -> Figure:
    """Draw the shoulder angle over time (Thesis figures 2-9 and 2-10)."""
    figure = Figure(figsize=(7, 3))
    axes = figure.subplots()
    angle = np.asarray(trial.shoulder)
    axes.plot(np.arange(len(angle)) * 0.01, np.rad2deg(angle), color=COLOURS.get(excitation))
    axes.set(xlabel="time [s]", ylabel="shoulder angle [deg]", title=f"{excitation} excitation")
    axes.grid(alpha=0.3)
    return figure


def draw_tilt(results: Results) -> Figure:
    """Draw the tilt read under each excitation (Thesis figure 2-11)."""
    figure = Figure(figsize=(7, 1.8 * len(results)))
    rows = figure.subplots(len(results), 1, sharex=True, squeeze=False)
    for axes, (excitation, trials) in zip(rows[:, 0], results.items()):
        trial = trials[0]
        axes.plot(trial.tilt_times, trial.tilt, color=COLOURS.get(excitation, "grey"), lw=1)
        axes.set(ylabel="tilt [rad]", title=excitation)
        axes.grid(alpha=0.3)
    rows[-1, 0].set_xlabel("time [s]")
    figure.tight_layout()
    return figure


def draw_convergence(results: Results, truths: Truths) -> Figure:
    """Draw the estimates over time with the band of the seeds (Thesis figure 2-12).

    Each is drawn over its own robot's laboratory value, in units of the robots' median.
    """
    figure = Figure(figsize=(12, 6))
    grid = figure.subplots(2, 3)
    shown = [name for name in ("constant", "information") if name in results] or list(results)
    for index, (name, unit) in enumerate(zip(NAMES, UNITS)):
        axes = grid.flat[index]
        own = np.array([truth[name] for truth in truths])
        true = float(np.median(own))
        for excitation in shown:
            histories = np.array([trial.history for trial in results[excitation]])[:, :, index]
            histories *= (true / own)[:, None]
            times = REPLAN_PERIOD * np.arange(1, histories.shape[1] + 1)
            low, median, high = np.percentile(histories, [10, 50, 90], axis=0)
            colour = COLOURS.get(excitation, "grey")
            axes.plot(times, median, color=colour, label=excitation)
            axes.fill_between(times, low, high, color=colour, alpha=0.2, lw=0)
        axes.axhline(true, color="black", ls="--", lw=1, label="laboratory")
        axes.set_ylim(min(-true, 0) if name in ("ry", "rz") else 0, 3 * true)
        axes.set(title=name, ylabel=unit, xlabel="time [s]")
        axes.grid(alpha=0.3)
    grid.flat[0].legend()
    grid.flat[-1].axis("off")
    figure.suptitle("Convergence: median of the seeds and the band of 80 % of them")
    figure.tight_layout()
    return figure


def draw_errors(results: Results, truths: Truths) -> Figure:
    """Draw the average error of every run by excitation, on a logarithmic scale."""
    figure = Figure(figsize=(7, 3.5))
    axes = figure.subplots()
    errors = [_errors(trials, truths).mean(axis=1) for trials in results.values()]
    axes.boxplot(errors, tick_labels=list(results))
    axes.set_title("box: middle half of the runs, whiskers: 1.5 times as far", fontsize="small")
    axes.axhline(10, color="grey", ls=":", label="10 %")
    axes.set(yscale="log", ylabel="average error of five parameters [%]")
    axes.grid(alpha=0.3, axis="y", which="both")
    axes.legend()
    return figure
