"""Exact inverse kinematics of a binary arm beside brute force over all of its words."""

import functools
from collections.abc import Iterable

import numpy as np

from controllers.braid.arm.inverse import BinaryArm, solve
from controllers.braid.arm.stage import STATES
from experiments.appe.arm.inverse_trial import draw_targets
from experiments.bench.bench_options import Options
from experiments.harness.output import Output
from experiments.harness.timing import compare, repeat

STAGES, QUICK_STAGES = (4, 5, 6), (4, 5)
MET = 10
"""Stages that brute force cannot list: its time is extrapolated by the number of words."""
TARGETS, QUICK_TARGETS = 20, 5
ROUNDS, QUICK_ROUNDS = 5, 2
SAME = 1e-9


def bench_braid(options: Options, output: Output) -> None:
    """Solve the same targets by the tree, by meeting in the middle and by trying every word.

    Brute force searches poses that were listed before, each different pose once, in NumPy; only
    the search is timed, for both.

    Args:
        options: ``quick`` takes fewer stages, targets and rounds.
        output: Receives ``braid_speedup/<stages>``, ``braid_ms/<stages>/<method>``,
            ``braid_same_cost`` and ``braid_speedup/10_extrapolated``.
    """
    rng = np.random.default_rng(options.job_seeds(1, 1)[0])
    count, rounds = (QUICK_TARGETS, QUICK_ROUNDS) if options.quick else (TARGETS, ROUNDS)
    same, brute_ms, largest = 0, 0.0, 0
    stages = QUICK_STAGES if options.quick else STAGES
    for largest in stages:
        arm = BinaryArm(largest)
        targets = draw_targets("reachable", largest, count, arm.geometry, rng)
        tree = functools.partial(_costs, arm, targets, "kd-tree")
        brute = functools.partial(_costs, arm, targets, "exhaustive")
        times = compare(tree, brute, rounds)
        same += int(np.sum(np.abs(np.subtract(tree(), brute())) < SAME))
        output.measure(f"braid_speedup/{largest}", 1.0 / times["ratio"]["median"])
        brute_ms = 1e3 * times["peer_s"]["median"] / count
        output.measure(f"braid_ms/{largest}/exhaustive", brute_ms)
        output.measure(f"braid_ms/{largest}/kd-tree", 1e3 * times["ours_s"]["median"] / count)
    share = same / (count * len(stages))
    output.measure("braid_same_cost", share)
    output.check("braid, targets with brute force's own cost", share, "== 1", share == 1.0)

    arm = BinaryArm(MET)
    targets = draw_targets("reachable", MET, count, arm.geometry, rng)
    seconds = repeat(functools.partial(_costs, arm, targets, "meet"), rounds)
    ms = 1e3 * seconds["median"] / count
    output.measure(f"braid_ms/{MET}/meet", ms)
    output.measure(f"braid_speedup/{MET}_extrapolated", brute_ms * STATES ** (MET - largest) / ms)


def _costs(arm: BinaryArm, targets: Iterable[np.ndarray], method: str) -> list[float]:
    """Return the costs of an exact method's words; none of them uses randomness."""
    found = [solve(arm, target, method, np.random.default_rng(0)) for target in targets]
    return [solution.cost for solution in found if solution is not None]  # there are no obstacles
