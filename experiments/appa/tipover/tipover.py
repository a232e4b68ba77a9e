"""``appa-tipover``: swings of a loaded arm that tip the rover, and three guards (Thesis A.3).

Each motion goes from the folded arm to a drawn reach, on flat ground and on slopes: as asked for,
as guards plan it that slow it as a whole before it begins, by the zero-moment point or by looking
ahead, and as a guard lets it pass online.
The zero-moment point of eq. A-5 is compared with MuJoCo's centre of pressure all the while.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from controllers.motion.tipping.guarded_swing import GUARDS
from experiments.appa.tipover.tipover_options import Options
from experiments.appa.tipover.trial import TipRun, TipTrial, run_tip
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.datasheets import ROVER

LOADS = (0.5, 1.0, 1.3)
"""Masses in the gripper [kg]: from a tenth to a third of the rover's own weight."""
SLOPES = (0.0, 5.0, 10.0)
"""Slopes of the ground [deg]."""
GUARDED = GUARDS[1:]
ZMP_BOUND = 1.0
"""Largest distance of the zero-moment point from the centre of pressure [mm]."""
Shown = Mapping[str, TipRun]
NAMES = {"unguarded": "as requested", "planned": "planned ahead",
         "ahead": "looked ahead", "online": "slowed online"}  # fmt: skip
Pairs = list[tuple[TipTrial, TipRun]]


def run(options: Options, output: Output) -> None:
    """Run every motion under every guard on every slope.

    Args:
        options: ``quick`` takes 1 motion a load and slope instead of 8.
        output: Receives ``zmp_error_mm``, ``motions``, ``tip_overs_<guard>``, and by guard and
            slope ``tip_overs/...``, ``stretch/...``, ``part/...`` and ``margin_mm/...``.
    """
    seeds = options.job_seeds(8, 1)
    trials = [
        trial
        for slope in SLOPES
        for load in LOADS
        for seed in seeds
        for trial in motions(load, seed, slope)
    ]
    pairs = list(zip(trials, sweep(run_tip, trials, options, output, label="runs")))
    _check_point(pairs, output)
    _measure(pairs, output)
    rows = [
        [np.degrees(trial.slope), np.degrees(trial.downhill), trial.load, trial.duration,
         np.degrees(trial.yaw), trial.guard, result.tipped, result.tilt_deg,
         1e3 * result.margin.min(), result.stretch, result.part, result.report]
        for trial, result in pairs
    ]  # fmt: skip
    columns = ["slope [deg]", "downhill [deg]", "load [kg]", "asked duration [s]", "yaw [deg]",
               "guard", "tipped", "largest tilt [deg]", "least margin [mm]", "stretch",
               "share of the path", "guard's report"]  # fmt: skip
    output.table("tip_over_runs", columns, rows)
    shown = _telling(pairs)
    output.figure("figure_A-4", draw_footprints(shown))
    output.figure("guards", draw_progress(shown))


def motions(load: float, seed: int, slope: float) -> list[TipTrial]:
    """Return a drawn motion under every guard.

    Args:
        load: Mass in the gripper [kg].
        seed: Random seed of direction, reach and duration, and of where the slope falls to.
        slope: Slope of the ground [deg].
    """
    rng = np.random.default_rng([seed, round(1e3 * load)])
    yaw = float(rng.uniform(-1.6, 1.6))
    shoulder, elbow = float(rng.uniform(0.2, 0.7)), float(rng.uniform(-0.7, -0.1))
    target = (yaw, shoulder, elbow, float(rng.uniform(-0.3, 0.3)))
    duration = float(rng.uniform(0.5, 1.0))
    downhill = float(rng.uniform(-np.pi, np.pi))
    return [
        TipTrial(load, yaw, target, duration, name, seed, float(np.radians(slope)), downhill)
        for name in GUARDS
    ]


def _check_point(pairs: Pairs, output: Output) -> None:
    """Compare eq. A-5 with MuJoCo's contacts."""
    errors = [
        1e3 * float(np.max(np.linalg.norm(result.point - result.pressure, axis=1)))
        for _, result in pairs
    ]
    output.measure("zmp_error_mm", distribution(errors))
    worst = max(errors)
    output.check(
        "zero-moment point against the centre of pressure, worst, in mm", worst,
        f"<= {ZMP_BOUND:g}", worst <= ZMP_BOUND,
    )  # fmt: skip


def _measure(pairs: Pairs, output: Output) -> None:
    """Count who tips, and what the guards cost."""
    output.measure("motions", len(pairs) // len(GUARDS))
    tips: dict[str, int] = {}
    for name in GUARDS:
        tips[name] = sum(result.tipped for trial, result in pairs if trial.guard == name)
        output.measure(f"tip_overs_{name}", tips[name])
        for slope in SLOPES:
            chosen = [
                result
                for trial, result in pairs
                if trial.guard == name and np.isclose(np.degrees(trial.slope), slope)
            ]
            cell = f"{name}/{slope:g}_deg"
            output.measure(f"tip_overs/{cell}", sum(result.tipped for result in chosen))
            margins = [1e3 * float(result.margin.min()) for result in chosen]
            output.measure(f"margin_mm/{cell}", distribution(margins))
            if name in GUARDED:
                for key in ("stretch", "part"):
                    output.measure(
                        f"{key}/{cell}", distribution([getattr(run, key) for run in chosen])
                    )
    output.check("tip-overs without guard", tips["unguarded"], "> 0", tips["unguarded"] > 0)
    for name in GUARDED:
        output.check(f"tip-overs, guard {name}", tips[name], "= 0", tips[name] == 0)


def _telling(pairs: Pairs) -> dict[str, TipRun]:
    """Return the results by guard of the motion that tips unguarded and online goes furthest."""
    sets = [pairs[i : i + len(GUARDS)] for i in range(0, len(pairs), len(GUARDS))]
    tipped = [motion for motion in sets if motion[0][1].tipped] or sets
    best = max(tipped, key=lambda motion: motion[-1][1].part)
    return {trial.guard: result for trial, result in best}


def draw_footprints(shown: Shown) -> Figure:
    """Draw the paths of both points over the footprint, a column for each guard.

    Args:
        shown: Results of `run_tip` by guard.
    """
    figure = Figure(figsize=(3.4 * len(shown), 3.9))
    x, y = 1e3 * ROVER.half_track, 1e3 * ROVER.half_wheelbase
    for column, (guard, result) in enumerate(shown.items()):
        axes = figure.add_subplot(1, len(shown), 1 + column)
        axes.plot([x, -x, -x, x, x], [y, y, -y, -y, y], "k-", linewidth=1, label="footprint")
        point, pressure = 1e3 * result.point, 1e3 * result.pressure
        axes.plot(*point.T, ".-", linewidth=0.6, label="zero-moment point (A-5)")
        axes.plot(*pressure.T, "x", markersize=4, label="centre of pressure")
        end = "tipped" if result.tipped else f"tilted {result.tilt_deg:.1f} deg"
        axes.set_title(f"{NAMES[guard]}: {end}")
        axes.set(aspect="equal", xlim=(-180, 180), ylim=(-180, 180), xlabel="to the right [mm]")
        axes.grid(alpha=0.3)
        if column == 0:
            axes.set(ylabel="forward [mm]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=3)
    figure.subplots_adjust(bottom=0.2)
    return figure


def draw_progress(shown: Shown) -> Figure:
    """Draw how far the reference has gone over time, and the pressure's margin.

    Args:
        shown: Results of `run_tip` by guard.
    """
    figure = Figure(figsize=(11, 4))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for guard, result in shown.items():
        time, part = result.gone.T
        left.plot(time, 100.0 * part, label=NAMES[guard])
        right.plot(time, 1e3 * result.margin, linewidth=1, label=NAMES[guard])
    left.set(ylabel="reference, share of the path [%]")
    right.set(ylabel="centre of pressure inside the footprint [mm]", ylim=(0, None))
    for axes in (left, right):
        axes.set(xlabel="time since the motion's beginning [s]")
        axes.grid(alpha=0.3)
    left.legend()
    figure.subplots_adjust(wspace=0.25)
    return figure
