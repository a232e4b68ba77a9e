"""``appe-placement``: a camera placement of chapter 4, carried out by BRAID on a rover.

Blocks hide a target from the head at rest. The placement is rated as in chapter 4 from blocks that
are known with an error; a camera position counts as occupied unless some word of the actuators
comes near it with the target in view. The best one that the inverse kinematics reaches, links clear
of the blocks, is
driven in physics by the muscle wires, and what the camera then sees is rendered.
"""

import numpy as np
from matplotlib.figure import Figure

from experiments.appe.mechanism.figures import gallery
from experiments.appe.placement.placement_options import Options
from experiments.appe.placement.record import record_placement
from experiments.appe.placement.trial import REST, PlacementTrial, prepare, run_placement
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray

SETTINGS, QUICK_SETTINGS = 24, 3
SEEN = 0.98
"""Bar of the target's visible part, as `ch4-stereo` has it."""
MEASURED = ("place_mm", "turn_deg", "off_mm", "off_deg", "tries", "pixels")
"""Fields of a `PlacedCamera` that are measured and listed for each setting."""


def run(options: Options, output: Output) -> None:
    """Place, drive and look, in settings drawn at random.

    Args:
        options: ``quick`` takes fewer settings.
        output: Receives ``placed_fraction``, ``possible_fraction`` (some word sees the target),
            ``visible_fraction/...``, ``wrong_bits``, ``place_mm`` and ``turn_deg`` of the camera in
            physics from its word's kinematics, ``off_mm`` and ``off_deg`` of that from the
            placement.

    Raises:
        ExperimentError: If no setting has a placement that BRAID can take.
    """
    seeds = options.job_seeds(SETTINGS, QUICK_SETTINGS)
    trials = [PlacementTrial(seed, options.stages) for seed in seeds]
    results = sweep(run_placement, trials, options, output, label="settings")
    placed = [(t, r.home, r.placed) for t, r in zip(trials, results) if r.placed is not None]
    possible = sum(r.seeing > 0 for r in results)
    output.measure("placed_fraction", fraction(len(placed), len(results)))
    output.measure("possible_fraction", fraction(possible, len(results)))
    if not placed:
        raise ExperimentError(f"BRAID can take a placement in none of {len(results)} settings")
    seen = np.array([r.seen for *_, r in placed])
    random = np.concatenate([r.random for *_, r in placed])
    home = np.array([r.home for r in results])
    for name, parts in (("placed", seen), ("random_words", random), ("home", home)):
        output.measure(f"visible_fraction/{name}", distribution(parts))
    for name, parts in (("placed", seen), ("random_words", random)):
        whole = fraction(int((parts >= SEEN).sum()), len(parts))
        output.measure(f"all_seen_fraction/{name}", whole)
    for key in MEASURED:
        output.measure(key, distribution([getattr(r, key) for *_, r in placed]))
    wrong = sum(r.wrong for *_, r in placed)
    output.measure("wrong_bits", wrong)
    output.check("wrong bits", wrong, "== 0", wrong == 0)
    least = float(seen.min())
    output.check("least part of the target seen", least, f">= {SEEN:g}", least >= SEEN)
    rows = [
        [t.seed, at_home, r.seen, float(np.mean(r.random)), r.wrong,
         "".join(str(int(s)) for s in r.word), *(getattr(r, key) for key in MEASURED)]
        for t, at_home, r in placed
    ]  # fmt: skip
    columns = ("seed", "seen from home", "seen", "mean seen by random words", "wrong bits", "word",
               *MEASURED)  # fmt: skip
    output.table("settings", columns, rows)
    output.figure("views", _draw_views(placed[0][0]))
    output.figure("seen", _draw_settings(home, seen, random))
    if options.record:
        record_placement(placed[0][0], output.file("run.rrd"))


def _draw_views(trial: PlacementTrial) -> Figure:
    """Show a setting from outside and by the camera, at home and in the word that is planned."""
    scene, plan, _ = prepare(trial)
    if plan is None:
        raise ValueError(f"seed {trial.seed}: BRAID can take no placement there")
    pictures = [
        ("at home: from outside", scene.from_outside()),
        ("at home: left camera", scene.picture()),
    ]
    scene.bench.put(plan.word)
    scene.bench.step(REST)
    word = "word " + "".join(map(str, plan.word))
    pictures += [
        (f"{word}: from outside", scene.from_outside()),
        (f"{word}: left camera", scene.picture()),
    ]
    return gallery(pictures, 2, (11, 8))


def _draw_settings(home: FloatArray, seen: FloatArray, random: FloatArray) -> Figure:
    """Show the visible parts of the target: at home, by random words, and as placed."""
    figure = Figure(figsize=(6, 3.6), layout="tight")
    axes = figure.add_subplot()
    groups = {"home": home, "random words": random, "placed": seen}
    rng = np.random.default_rng(0)
    for index, values in enumerate(groups.values()):
        axes.plot(index + rng.uniform(-0.2, 0.2, len(values)), values, "o", ms=4, alpha=0.6)
    axes.set_xticks(range(len(groups)), list(groups))
    axes.set(ylabel="visible part of the target", ylim=(-0.05, 1.05))
    axes.grid(alpha=0.3)
    return figure
