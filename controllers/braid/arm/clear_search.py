"""Words that keep clear of obstacles: candidates in order of cost, the first clear one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from controllers.braid.arm.chain import all_words, forward
from controllers.braid.arm.meeting import meet, pairs_below
from controllers.braid.arm.obstacles import LinkCheck
from controllers.braid.arm.pose_tree import PoseTree
from controllers.braid.arm.stage import STATES, FloatArray, IntArray

CAPACITY = 2**18
"""Candidates that are sorted at once: all words of six stages."""
_BATCH = 512
_WIDER = 4.0
_STARTS = 256


class Tails(Protocol):
    """All words of the last stages, those of like pose included."""

    @property
    def words(self) -> IntArray:
        """Return the words (m, k)."""
        ...

    @property
    def tree(self) -> PoseTree:
        """Return the tree of their poses."""
        ...


def first_clear(
    tails: Tails,
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
    if head_words.shape[1] > 0:
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
    tails: Tails,
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


def _cost(tails: Tails, stages: FloatArray, word: IntArray, target: FloatArray) -> float:
    """Return a word's squared cost in the coordinates of the tree."""
    off = (forward(stages, word) - target) @ tails.tree.basis
    return float(off @ off)
