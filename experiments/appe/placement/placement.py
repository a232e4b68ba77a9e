"""``appe-placement``: a camera placement of chapter 4, carried out by BRAID on a rover.

Blocks hide a target from the head at rest. The placement is rated as in chapter 4 from blocks that
are known with an error; a place counts as taken unless some word comes near it with the target in
its picture. The best one that the inverse kinematics stands for, links clear of the blocks, is
driven in physics by the muscle wires, and what the camera then sees is rendered.
"""

import dataclasses

import numpy as np

from experiments.appe.placement.figures import draw_settings, draw_views
from experiments.appe.placement.record import record_placement
from experiments.appe.placement.trial import PlacementTrial, run_placement
from experiments.harness import contract
from experiments.harness.contract import ExperimentError, OptionError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep

SETTINGS, QUICK_SETTINGS = 24, 3
MOST_STAGES = 5
SEEN = 0.98
"""Bar of the target's visible part, as `ch4-stereo` has it."""
MEASURED = ("place_mm", "turn_deg", "off_mm", "off_deg", "tries", "pixels")
"""Fields of a `PlacedCamera` that are measured and listed for each setting."""


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of appe-placement.

    Attributes:
        stages: Of BRAID. --seeds sets the number of settings.
    """

    stages: int = MOST_STAGES

    def __post_init__(self) -> None:
        """Refuse what cannot be listed.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        if not 1 <= self.stages <= MOST_STAGES:
            raise OptionError(f"--stages {self.stages}: expected 1 to {MOST_STAGES}")


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
    output.measure("visible_fraction/placed", distribution(seen))
    output.measure("visible_fraction/random_words", distribution(random))
    output.measure("visible_fraction/home", distribution(home))
    output.measure("all_seen_fraction/placed", fraction(int((seen >= SEEN).sum()), len(seen)))
    output.measure(
        "all_seen_fraction/random_words", fraction(int((random >= SEEN).sum()), len(random))
    )
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
    output.figure("views", draw_views(placed[0][0]))
    output.figure("seen", draw_settings(home, seen, random))
    if options.record:
        record_placement(placed[0][0], output.file("run.rrd"))
