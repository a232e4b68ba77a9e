"""The combinatorial heuristic: from a random word, the best change of up to three legs, repeated.

It ends where no such change is better, and begins again from another random word.
"""

from __future__ import annotations

import numba
import numpy as np

from controllers.braid.arm.chain import compose, relative

_CHANGED = 3
"""Legs that are exchanged at once at most."""


@numba.njit(cache=True)
def squared_cost(a, b, turn):
    """Return |dp|^2 + turn |dR|_F^2 of two poses; turn is w^2 / 2."""
    total = 0.0
    for d in range(3):
        total += (a[d] - b[d]) ** 2
    turned = 0.0
    for d in range(3, 12):
        turned += (a[d] - b[d]) ** 2
    return total + turn * turned


@numba.njit(cache=True)
def exchange(stages, word, target, turn):
    """Descend from a word, which is changed, and return the squared cost where it ends.

    Args:
        stages: (8, 12) pose of a stage in each state.
        word: (n,) states, base first.
        target: (12,) pose that is wanted.
        turn: w^2 / 2 of the cost [m^2].
    """
    tips = np.empty((word.shape[0], 8, 12))
    move = np.empty((_CHANGED, 2), dtype=np.int64)
    bound = np.inf
    while True:
        _tips(stages, word, tips)
        bound = min(bound, squared_cost(tips[0, word[0]], target, turn))
        found = _best_move(stages, word, tips, target, turn, bound, move)
        if found >= bound:
            return bound
        bound = found
        for k in range(_CHANGED):
            if move[k, 0] >= 0:
                word[move[k, 0]] = move[k, 1]


@numba.njit(cache=True)
def _tips(stages, word, tips):
    """Write the tip in the frame before stage k, if k is in state s and the rest as in the word."""
    rest, after = np.zeros(12), np.empty(12)
    rest[3] = rest[7] = rest[11] = 1.0
    for k in range(word.shape[0] - 1, -1, -1):
        for state in range(8):
            compose(stages[state], rest, after)
            tips[k, state] = after
        rest[:] = tips[k, word[k]]


@numba.njit(cache=True)
def _best_move(stages, word, tips, target, turn, bound, move):
    """Write the best change into ``move`` (3, 2): stage and state, or -1; return its cost.

    Stages are changed from the base on, each level of the search one. The target is carried along
    in the frame before the stage at hand, so that a change costs one distance.
    """
    count = word.shape[0]
    stage, state = np.zeros(_CHANGED, dtype=np.int64), np.full(_CHANGED, -1, dtype=np.int64)
    legs, here, after = np.full(_CHANGED, _CHANGED), np.empty((_CHANGED, 12)), np.empty(12)
    here[0], level = target, 0
    move[:] = -1
    while level >= 0:
        state[level] += 1
        k, tried = stage[level], state[level]
        if tried == 8:
            relative(stages[word[k]], here[level], after)
            here[level] = after
            stage[level], state[level] = k + 1, -1
            if k + 1 == count:
                level -= 1
            continue
        flips = word[k] ^ tried
        changed = (flips & 1) + (flips >> 1 & 1) + (flips >> 2)
        if changed == 0 or changed > legs[level]:
            continue
        cost = squared_cost(tips[k, tried], here[level], turn)
        if cost < bound:
            bound = cost
            move[:] = -1
            for done in range(level + 1):
                move[done, 0], move[done, 1] = stage[done], state[done]
        if changed < legs[level] and k + 1 < count:
            relative(stages[tried], here[level], here[level + 1])
            stage[level + 1], state[level + 1] = k + 1, -1
            legs[level + 1] = legs[level] - changed
            level += 1
    return bound


@numba.njit(cache=True)
def exchange_from_random(stages, count, target, turn, restarts, rng):
    """Descend from several random words; return the best word (n,) and its squared cost."""
    best, bound = np.zeros(count, dtype=np.int64), np.inf
    word = np.empty(count, dtype=np.int64)
    for _ in range(restarts):
        for k in range(count):
            word[k] = rng.integers(0, 8)
        cost = exchange(stages, word, target, turn)
        if cost < bound:
            bound = cost
            best[:] = word
    return best, bound
