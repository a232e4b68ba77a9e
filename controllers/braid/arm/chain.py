"""Chains of stages: forward kinematics (Thesis eq. E-3), all words, different poses.

A word is (n,) states of 0 to 7, base first. Poses are rows of 12 as in `stage`.
"""

import math

import numba
import numpy as np
from scipy.spatial import KDTree

from controllers.braid.arm.stage import STATES
from perception.geometry.arrays import FloatArray, IntArray

MAX_ENUMERATED = 7
"""Stages whose words are all listed at most (2 million)."""
STRAIGHT = (0, STATES - 1)
"""States that only lift: they commute, so words that swap them reach one pose."""


@numba.njit(cache=True)
def compose(a, b, out):
    """Write the product of poses a and b into ``out``, which may be a but not b."""
    for i in range(3):
        x, y, z = a[3 + 3 * i], a[4 + 3 * i], a[5 + 3 * i]
        out[i] = a[i] + x * b[0] + y * b[1] + z * b[2]
        for j in range(3):
            out[3 + 3 * i + j] = x * b[3 + j] + y * b[6 + j] + z * b[9 + j]


@numba.njit(cache=True)
def relative(a, b, out):
    """Write inverse(a) b, the pose of b in the frame of a, into ``out``: b perhaps, but not a."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    for i in range(3):
        out[i] = a[3 + i] * x + a[6 + i] * y + a[9 + i] * z
    for j in range(3, 6):
        x, y, z = b[j], b[3 + j], b[6 + j]
        for i in range(3):
            out[3 * i + j] = a[3 + i] * x + a[6 + i] * y + a[9 + i] * z


@numba.njit(cache=True)
def identity():
    """Return the pose (12,) of the base itself."""
    pose = np.zeros(12)
    pose[3] = pose[7] = pose[11] = 1.0
    return pose


def forward(stages: FloatArray, words: IntArray) -> FloatArray:
    """Return the tip's poses.

    Args:
        stages: (8, 12) pose of a stage in each state (`stage.state_poses`).
        words: (..., n) states, base first.

    Returns:
        (..., 12) pose of the last platform in the base frame.

    Raises:
        ValueError: If a state is not 0 to 7.
    """
    words = np.asarray(words, dtype=np.int64)
    if words.size and not (words.min() >= 0 and words.max() < STATES):
        raise ValueError(f"states {words.min()} to {words.max()}: expected 0 to 7")
    return chain_pose(stages[words])


def chain_pose(stage_poses: FloatArray) -> FloatArray:
    """Return the product (..., 12) of stages (..., n, 12) of any leg lengths."""
    chains = math.prod(stage_poses.shape[:-2])
    flat = np.ascontiguousarray(stage_poses).reshape(chains, *stage_poses.shape[-2:])
    return _forward(flat).reshape(*stage_poses.shape[:-2], 12)


@numba.njit(cache=True)
def _forward(stages):
    poses = np.empty((stages.shape[0], 12))
    for i in range(stages.shape[0]):
        poses[i] = identity()
        for k in range(stages.shape[1]):
            compose(poses[i], stages[i, k], poses[i])
    return poses


def all_words(count: int) -> IntArray:
    """Return every word (8^n, n) of a few stages; the last stage changes fastest.

    Raises:
        ValueError: If they are too many to list.
    """
    if not 1 <= count <= MAX_ENUMERATED:
        raise ValueError(f"{count} stages: expected 1 to {MAX_ENUMERATED} to list all words")
    index = np.arange(STATES**count)[:, None]
    return (index // STATES ** np.arange(count - 1, -1, -1)) % STATES


def reduced_words(count: int) -> IntArray:
    """Return one word (m, n) for each different pose: no long straight stage before a short one.

    Raises:
        ValueError: As `all_words`.
    """
    words = all_words(count)
    swapped = (words[:, :-1] == STRAIGHT[1]) & (words[:, 1:] == STRAIGHT[0])
    return words[~swapped.any(axis=1)]


def reduced_count(count: int) -> int:
    """Return how many words `reduced_words` has: a_n = 8 a_(n-1) - a_(n-2)."""
    before, here = 0, 1
    for _ in range(count):
        before, here = here, STATES * here - before
    return here


def count_poses(poses: FloatArray, tolerance: float = 1e-9) -> int:
    """Count poses (m, 12) that differ by more than rounding in any component."""
    pairs = KDTree(poses).query_pairs(tolerance, p=np.inf, output_type="ndarray")
    return len(poses) - len(np.unique(pairs[:, 1]))  # less those that equal one before
