"""Meet in the middle: all words of many stages searched exactly through those of two halves.

A word's tip is A B with A of the first stages and B of the last. Costs do not change when all is
seen from another frame, so for each A the best B is the pose nearest to inverse(A) target, found in
one tree that serves all targets. The best so far bounds every later look. Among obstacles,
candidates are taken in the order of their cost until one is clear.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from controllers.braid.arm.chain import all_words, compose, forward, identity, relative
from controllers.braid.arm.obstacles import LinkCheck
from controllers.braid.arm.pose_tree import PoseTree, gather, nearest
from controllers.braid.arm.stage import STATES
from perception.geometry.arrays import FloatArray, IntArray

_SCOUTS = 64
"""Number of first halves of which one is tried before the others, for a bound."""
CAPACITY = 2**18
"""Candidates that are sorted at once: all words of six stages."""
_BATCH = 512
_WIDER = 4.0
_STARTS = 256


@numba.njit(cache=True)
def meet(tree, heads, target, bound):
    """Find the best pair of a first half and a last half.

    Args:
        tree: `PoseTree` of the last halves.
        heads: (m, 12) poses of the first halves.
        target: (12,) pose that is wanted.
        bound: Squared cost to stay below.

    Returns:
        Indices of first and last half (-1 where none is below the bound) and the squared cost.
    """
    first, last = -1, -1
    wanted = np.empty(12)
    for scout in range(2):
        for i in range(heads.shape[0]):
            if (i % _SCOUTS == 0) == (scout == 0):
                relative(heads[i], target, wanted)
                found, cost = nearest(tree, wanted, bound)
                if found >= 0:
                    first, last, bound = i, found, cost
    return first, last, bound


@numba.njit(cache=True)
def improve_free_stages(tree, stages, word, free, target, bound):
    """Try all states of chosen stages of the head, each with the best tail.

    Args:
        tree: `PoseTree` of the tails.
        stages: (8, 12) pose of a stage in each state.
        word: (h,) states of the head; changed to the best when one is found.
        free: (h,) stages whose states are tried.
        target: (12,) pose that is wanted.
        bound: Squared cost to stay below.

    Returns:
        Index of the tail (-1 where nothing is below the bound) and the squared cost.
    """
    start, runs, where = _runs(stages, word, free)
    count = where.shape[0]
    trial, last = np.zeros(count, dtype=np.int64), -1
    wanted = np.empty((count + 1, 12))
    relative(start, target, wanted[0])
    changed = 0
    while changed >= 0:
        for k in range(changed, count):
            relative(runs[k, trial[k]], wanted[k], wanted[k + 1])
        found, cost = nearest(tree, wanted[count], bound)
        if found >= 0:
            bound, last = cost, found
            for k in range(count):
                word[where[k]] = trial[k]
        changed = count - 1  # count on: the last free stage changes fastest
        while changed >= 0 and trial[changed] == 7:
            trial[changed] = 0
            changed -= 1
        if changed >= 0:
            trial[changed] += 1
    return last, bound


@numba.njit(cache=True)
def _runs(stages, word, free):
    """Join each free stage, in each state, with the fixed ones up to the next free stage.

    Returns:
        The pose (12,) of the fixed stages before the first free one, the runs (f, 8, 12), and which
        stages (f,) are free.
    """
    where = np.flatnonzero(free)
    runs, start, begun = np.empty((where.shape[0], 8, 12)), identity(), -1
    for k in range(word.shape[0]):
        if free[k]:
            begun += 1
            runs[begun] = stages
        elif begun < 0:
            compose(start, stages[word[k]], start)
        else:
            for state in range(8):
                compose(runs[begun, state], stages[word[k]], runs[begun, state])
    return start, runs, where


@numba.njit(cache=True)
def pairs_below(tree, heads, target, bound, capacity):
    """Collect pairs of a first and a last half that cost less than a bound.

    Args:
        tree: `PoseTree` of the last halves.
        heads: (m, 12) poses of the first halves.
        target: (12,) pose that is wanted.
        bound: Squared cost to stay below.
        capacity: Greatest number of pairs that are stored.

    Returns:
        (k, 2) indices of first and last halves, (k,) squared costs, and how many there are in all.
    """
    pairs, costs = np.empty((capacity, 2), dtype=np.int64), np.empty(capacity)
    wanted = np.empty(12)
    total = 0
    for i in range(heads.shape[0]):
        relative(heads[i], target, wanted)
        room = max(capacity - total, 0)
        kept = min(total, capacity)
        total += gather(tree, wanted, bound, pairs[kept:, 1], costs[kept:])
        pairs[kept : kept + min(room, total - kept), 0] = i
    kept = min(total, capacity)
    return pairs[:kept], costs[:kept], total


class WordTable(NamedTuple):
    """All words of a few stages, their poses and a tree of them.

    Attributes:
        words: (m, k) states.
        poses: (m, 12) poses.
        tree: KD-tree of the poses.
    """

    words: IntArray
    poses: FloatArray
    tree: PoseTree


def first_clear(
    tails: WordTable,
    heads: FloatArray,
    head_words: IntArray,
    target: FloatArray,
    check: LinkCheck,
    bound: float = np.inf,
) -> IntArray | None:
    """Return the clear word of least cost below a bound.

    Exact while fewer than `CAPACITY` words cost less than the answer; beyond, it gives up.

    Args:
        tails: Words of the last stages.
        heads: (m, 12) poses of the first stages.
        head_words: (m, h) their words.
        target: (12,) pose that is wanted.
        check: Tells which words are clear.
        bound: Squared cost to stay below.

    Returns:
        The word (h + k,), or None.
    """
    clear = check.free(head_words)
    heads, head_words = heads[clear], head_words[clear]
    if len(heads) == 0:
        return None
    first, _, least = meet(tails.tree, heads, target, bound)
    if first < 0:
        return None
    radius, seen, all_pairs = 1.5 * least + 1e-12, 0.0, len(heads) * len(tails.words)
    while True:
        radius = min(radius, bound)
        pairs, costs, total = pairs_below(tails.tree, heads, target, radius, CAPACITY)
        if total > CAPACITY:
            return None
        order = np.argsort(costs, kind="stable")
        order = order[costs[order] >= seen]
        for start in range(0, len(order), _BATCH):
            some = pairs[order[start : start + _BATCH]]
            words = np.column_stack([head_words[some[:, 0]], tails.words[some[:, 1]]])
            clear = check.free(words)
            if clear.any():
                return words[int(np.argmax(clear))]
        if total == all_pairs or radius >= bound:
            return None
        seen, radius = radius, _WIDER * radius


def search_clear(
    stages: FloatArray,
    tails: WordTable,
    ahead: int,
    choices: Sequence[IntArray],
    target: FloatArray,
    check: LinkCheck,
    rng: np.random.Generator,
) -> IntArray | None:
    """Large-neighbourhood search among clear words.

    Args:
        stages: (8, 12) pose of a stage in each state.
        tails: Words of the last stages.
        ahead: Stages before them.
        choices: Stages that each neighbourhood sets free.
        target: (12,) pose that is wanted.
        check: Tells which words are clear.
        rng: Source of the words that it begins from.

    Returns:
        The word, or None where none of the first random beginnings leads to a clear one.
    """
    starts = rng.integers(0, STATES, (_STARTS, ahead))
    word = first_clear(tails, forward(stages, starts), starts, target, check)
    if word is None:
        return None
    for chosen in choices:
        heads = np.tile(word[:ahead], (STATES ** len(chosen), 1))
        heads[:, chosen] = all_words(len(chosen))
        bound = _cost(tails, stages, word, target)
        better = first_clear(tails, forward(stages, heads), heads, target, check, bound)
        word = word if better is None else better
    return word


def _cost(tails: WordTable, stages: FloatArray, word: IntArray, target: FloatArray) -> float:
    """Return a word's squared cost in the coordinates of the tree."""
    off = (forward(stages, word) - target) @ tails.tree.basis
    return float(off @ off)
