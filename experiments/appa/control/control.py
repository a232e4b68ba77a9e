"""``appa-control``: the arm's control laws on soft, middle and stiff bases (Thesis A.1, A.2).

PD, PD with gravity, and these with the base's motion fed forward (eq. A-4) hold the arm to a moving
reference while the base is pushed; the feed-forward also as measured and with a longer lag. The
nine-coordinate model (eqs A-2, A-3) is compared with MuJoCo, and its ranks are computed.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from controllers.motion.arm_control import Law
from controllers.motion.base_motion import LAG
from controllers.motion.lagrange import controllability_rank, observability_rank
from experiments.appa.control.control_options import Options
from experiments.appa.control.plant import PlanarPlant, model_errors, planar_plant
from experiments.appa.control.trial import (
    HOME,
    PERIOD,
    START,
    ControlRun,
    ControlTrial,
    run_control,
)
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.datasheets import TABLE_2_1_TRUTH, TABLE_2_2_TRUTH

BASES = {"soft": 60.0, "middle": TABLE_2_2_TRUTH["k_pitch"], "stiff": TABLE_2_1_TRUTH["k_pitch"]}
"""Pitch stiffness [N m/rad]: a fifth of the rover's, the rover's, the simulation study's."""
LAWS: dict[str, tuple[Law, float]] = {
    "pd": ("pd", 0.0),
    "pd_gravity": ("pd_gravity", 0.0),
    "feed_forward": ("feed_forward", LAG),
    "feed_forward_50ms": ("feed_forward", 0.05),
    "feed_forward_raw": ("feed_forward", 0.0),
}
"""Law and lag of the feed-forward [s] by name."""
NAMES = {
    "pd": "PD",
    "pd_gravity": "PD + gravity",
    "feed_forward": f"base fed forward, {1e3 * LAG:g} ms lag",
    "feed_forward_50ms": "base fed forward, 50 ms lag",
    "feed_forward_raw": "base fed forward as measured",
}
"""What figures call them."""
COUPLE = 2.0
"""Of the pushes [N m]: held, they pitch the soft base by 2 degrees."""
STATES = 100
MODEL_BOUND, HALF, NO_WORSE = 1e-8, 0.5, 1.05


def run(options: Options, output: Output) -> None:
    """Check the model, then run every law on every base, pushed and left alone.

    Args:
        options: ``quick`` takes 1 seed instead of 6.
        output: Receives ``model_error``, ``rank/...`` and ``joint_rms_deg/<base>/<law>``, with
            ``/undisturbed`` where nothing pushes.
    """
    _check_model(options, output)
    seeds = options.job_seeds(6, 1)
    cases = [(base, law, COUPLE) for base in BASES for law in LAWS]
    cases += [(base, law, 0.0) for base in BASES for law in ("pd_gravity", "feed_forward")]
    trials = [
        ControlTrial(BASES[base], *LAWS[law], couple, seed, seed == seeds[0] and couple > 0.0)
        for base, law, couple in cases
        for seed in seeds
    ]
    results = sweep(run_control, trials, options, output, label="runs")
    medians: dict[tuple[str, str, float], float] = {}
    rows: list[list[Any]] = []
    traces: dict[tuple[str, str], ControlRun] = {}
    for index, case in enumerate(cases):
        base, law, couple = case
        chosen = results[index * len(seeds) : (index + 1) * len(seeds)]
        errors = distribution([result.all_deg for result in chosen])
        ending = "" if couple else "/undisturbed"
        output.measure(f"joint_rms_deg/{base}/{law}{ending}", errors)
        medians[case] = float(errors["median"])
        for seed, result in zip(seeds, chosen, strict=True):
            joints = [float(value) for value in result.rms_deg]
            rows.append([base, law, couple, seed, *joints, result.all_deg, result.pitch_deg])
        if couple:
            traces[base, law] = chosen[0]
    columns = ["base", "law", "pushes [N m]", "seed", "yaw [deg]", "shoulder [deg]", "elbow [deg]",
               "wrist [deg]", "all joints r.m.s. [deg]", "base pitch r.m.s. [deg]"]  # fmt: skip
    output.table("control_runs", columns, rows)
    _check_laws(medians, output)
    output.figure("figure_A-1", _responses(traces))
    output.figure("control_laws", _bars(medians))


def _check_model(options: Options, output: Output) -> None:
    """Compare the nine-coordinate model with MuJoCo, and compute the ranks of step 4."""
    plant = planar_plant()
    errors = model_errors(plant, STATES, np.random.default_rng(options.seed))
    worst = float(errors.max())
    output.measure("model_error", worst)
    output.check(
        f"nine-coordinate model against MuJoCo, {STATES} states", worst, f"<= {MODEL_BOUND:g}",
        worst <= MODEL_BOUND,
    )  # fmt: skip
    output.table("model_errors", ["mass matrix", "bias", "efforts"], errors.tolist())
    for name, rank in ranks(plant).items():
        # The thesis prints 6 for its twelve-state form.
        output.measure(f"rank/{name}", rank, thesis=6 if name.endswith("/printed") else None)


def ranks(plant: PlanarPlant) -> dict[str, int]:
    """Return the ranks of step 4 for the twelve states, by what drives and what is seen.

    Args:
        plant: The nine-coordinate model.
    """
    pose = np.concatenate([np.zeros(6), HOME[1:]])
    a, b, c = plant.coordinates.state_space(pose)
    pitch, heave = BASES["middle"], TABLE_2_2_TRUTH["k_pitch"] / 0.15**2
    stiffness = np.array([pitch, heave, heave])
    springs, drives, sees = plant.coordinates.state_space(pose, stiffness, 0.005 * stiffness)
    return {
        "controllability/printed": controllability_rank(a, b),
        "observability/printed": observability_rank(a, c),
        "controllability/arm_motors_only": controllability_rank(springs, drives[:, 3:]),
        "observability/arm_angles_only": observability_rank(springs, sees[3:]),
        "controllability/arm_motors_only_no_springs": controllability_rank(a, b[:, 3:]),
        "observability/arm_angles_only_no_springs": observability_rank(a, c[3:]),
    }


def _check_laws(medians: Mapping[tuple[str, str, float], float], output: Output) -> None:
    ratios = {
        (base, couple): medians[base, "feed_forward", couple] / medians[base, "pd_gravity", couple]
        for base in BASES
        for couple in (COUPLE, 0.0)
    }
    for (base, couple), ratio in ratios.items():
        bound = HALF if base == "soft" and couple else NO_WORSE
        what = "pushed" if couple else "undisturbed"
        output.measure(f"error_ratio/{base}/{what}", ratio)
        name = f"feed-forward over PD + gravity, {base} base, {what}"
        output.check(name, ratio, f"<= {bound:g}", ratio <= bound)


def _responses(traces: Mapping[tuple[str, str], ControlRun]) -> Figure:
    """Draw the shoulder's error over time by law, and the base's pitch, for each base."""
    figure = Figure(figsize=(11, 7))
    for column, base in enumerate(BASES):
        error = figure.add_subplot(2, 3, 1 + column)
        pitch = figure.add_subplot(2, 3, 4 + column)
        for law in ("pd_gravity", "feed_forward"):
            trace = traces[base, law]
            assert trace.error_deg is not None and trace.base_deg is not None
            times = START + PERIOD * np.arange(1, len(trace.base_deg) + 1)
            error.plot(times, trace.error_deg[:, 1], linewidth=0.8, label=NAMES[law])
            pitch.plot(times, trace.base_deg, linewidth=0.8)
        error.set(title=f"{base} base, {BASES[base]:g} N m/rad")
        pitch.set(xlabel="time [s]")
        for axes in (error, pitch):
            axes.grid(alpha=0.3)
        if column == 0:
            error.set(ylabel="shoulder error [deg]")
            pitch.set(ylabel="base pitch [deg]")
    # One scale for all bases, so that they can be compared.
    for row in (0, 1):
        panels = figure.axes[row::2]
        most = 1.1 * max(float(np.abs(axes.get_ylim()).max()) for axes in panels)
        for axes in panels:
            axes.set(ylim=(-most, most))
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="lower center", ncols=2)
    figure.subplots_adjust(wspace=0.25, bottom=0.12)
    return figure


def _bars(medians: Mapping[tuple[str, str, float], float]) -> Figure:
    """Draw the r.m.s. error of every law on every base."""
    figure = Figure(figsize=(8, 4))
    axes = figure.add_subplot()
    laws: Sequence[str] = list(LAWS)
    for index, law in enumerate(laws):
        places = np.arange(len(BASES)) + (index - (len(laws) - 1) / 2) * 0.16
        axes.bar(places, [medians[base, law, COUPLE] for base in BASES], 0.15,
                 label=NAMES[law])  # fmt: skip
    axes.set(yscale="log", ylabel="joint error, r.m.s. [deg]")
    axes.set_xticks(range(len(BASES)), [f"{base}\n{BASES[base]:g} N m/rad" for base in BASES])
    axes.grid(axis="y", alpha=0.3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure
