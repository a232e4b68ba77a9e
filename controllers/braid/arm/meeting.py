"""Meet in the middle: all words of many stages searched exactly through those of two halves.

A word's tip is A B with A of the first stages and B of the last. Costs do not change when all is
seen from another frame, so for each A the best B is the pose nearest to inverse(A) target, found in
one tree that serves all targets. The best so far bounds every later look.
"""

from __future__ import annotations

import numba
import numpy as np

from controllers.braid.arm.chain import compose, relative
from controllers.braid.arm.pose_tree import gather, nearest

_SCOUTS = 64
"""One first half of so many is looked at first, to have a bound."""


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
    runs, start, after = np.empty((where.shape[0], 8, 12)), np.zeros(12), np.empty(12)
    start[3] = start[7] = start[11] = 1.0
    begun = -1
    for k in range(word.shape[0]):
        if free[k]:
            begun += 1
            runs[begun] = stages
        elif begun < 0:
            compose(start, stages[word[k]], after)
            start[:] = after
        else:
            for state in range(8):
                compose(runs[begun, state], stages[word[k]], after)
                runs[begun, state] = after
    return start, runs, where


@numba.njit(cache=True)
def pairs_below(tree, heads, target, bound, capacity):
    """Collect pairs of a first and a last half that cost less than a bound.

    Args:
        tree: `PoseTree` of the last halves.
        heads: (m, 12) poses of the first halves.
        target: (12,) pose that is wanted.
        bound: Squared cost to stay below.
        capacity: How many are kept at most.

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
