"""A random walk among the first stages, towards what the last ones can reach: for long arms.

A leg that lengthens tilts the tip by one fixed angle in one of three directions, so that the tilts
of short chains lie on a hexagonal lattice (spacing 0.2 rad for legs of 1 and 1.3 radii). A target
lies between its points, and a search by cost alone ends at that distance. Turns do not commute
quite: the twist that one part of a chain gathers turns the lattice of the next. Where the first
stages leave the last ones a pose whose tilt is on their lattice, and which is otherwise typical of
them, the best last stages come much nearer. The walk looks for such first stages.
"""

from typing import NamedTuple

import numba
import numpy as np

from controllers.braid.arm.chain import compose, identity, relative
from controllers.braid.arm.pose_tree import nearest
from controllers.braid.arm.stage import STATES
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import write_near_log

LATTICE_SHARE = 1.0 / 14.0
"""Deviation of tilts from the lattice that the walk aims at, in its spacing."""
WARMTH = 0.5
"""Temperature of the walk."""
WORTH_A_LOOK = 7.0
"""Misfit below which the last stages are searched."""
_PAIRS = STATES * STATES
_SMALL = 1e-9


class TailShape(NamedTuple):
    """Poses that the last stages reach, as exponential coordinates (rotation 3, translation 3).

    Chains that bend evenly are lines there, so that a normal distribution describes them.

    Attributes:
        mean: (6,) of the coordinates [rad, m].
        whiten: (6, 6) lower triangle; coordinates less the mean times it have unit covariance.
        lattice: (2, 2) tilts [rad] of two legs in columns.
        inverse: (2, 2) lattice coordinates of a tilt.
        sharpness: 1 / variance [1/rad^2] of tilts about the lattice.
    """

    mean: FloatArray
    whiten: FloatArray
    lattice: FloatArray
    inverse: FloatArray
    sharpness: float


class WalkEffort(NamedTuple):
    """Effort of the walk.

    Attributes:
        looks: Number of searches of the tree after which the walk ends.
        steps: Number of steps after which the walk ends anyway.
    """

    looks: int
    steps: int


def describe_tails(poses: FloatArray, stages: FloatArray) -> TailShape:
    """Return the shape of what chains reach.

    Args:
        poses: (m, 12) of all words of the last stages.
        stages: (8, 12) pose of a stage in each state.
    """
    coordinates = logarithms(poses)
    covariance = np.cov(coordinates.T)
    covariance += 1e-9 * max(float(np.trace(covariance)), _SMALL) * np.eye(6)
    legs = np.ascontiguousarray(logarithms(stages[[1, 2]])[:, :2].T)
    deviation = LATTICE_SHARE * float(np.linalg.norm(legs[:, 0]))
    return TailShape(
        coordinates.mean(axis=0),
        np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64),
        legs,
        np.ascontiguousarray(np.linalg.pinv(legs), dtype=np.float64),
        1.0 / max(deviation, _SMALL) ** 2,
    )


@numba.njit(cache=True)
def logarithms(poses):
    """Return the exponential coordinates (m, 6), rotation first, of poses (m, 12)."""
    coordinates = np.empty((poses.shape[0], 6))
    for i in range(poses.shape[0]):
        write_near_log(poses[i], coordinates[i])
    return coordinates


@numba.njit(cache=True)
def misfit(shape, pose, work):
    """Return how untypical a pose is of the last stages: half a squared number of deviations.

    Args:
        shape: `TailShape`.
        pose: (12,).
        work: (6,) is written over.
    """
    write_near_log(pose, work)
    total = shape.sharpness * _off_lattice(shape, work[0], work[1])
    for i in range(6):
        along = 0.0
        for j in range(i + 1):
            along += shape.whiten[i, j] * (work[j] - shape.mean[j])
        total += along * along
    return 0.5 * total


@numba.njit(cache=True)
def _off_lattice(shape, x, y):
    """Return the squared distance [rad^2] of a tilt from the nearest point of the lattice."""
    first = np.floor(shape.inverse[0, 0] * x + shape.inverse[0, 1] * y)
    second = np.floor(shape.inverse[1, 0] * x + shape.inverse[1, 1] * y)
    least = np.inf
    for i in range(2):
        for j in range(2):
            u = x - shape.lattice[0, 0] * (first + i) - shape.lattice[0, 1] * (second + j)
            v = y - shape.lattice[1, 0] * (first + i) - shape.lattice[1, 1] * (second + j)
            least = min(least, u * u + v * v)
    return least


@numba.njit(cache=True)
def walk(tree, shape, goal, word, bound, effort, rng):
    """Walk among the first stages by pairs of states, and look for last stages where it pays.

    A step draws two stages, rates all 64 pairs of their states, and takes one with a chance that
    falls with its misfit (Gibbs sampling at the temperature `WARMTH`).

    Args:
        tree: `PoseTree` of the last stages.
        shape: `TailShape` of the last stages.
        goal: `TipGoal`.
        word: (h,) first stages to begin with, two at least; changed to the best.
        bound: Squared cost to stay below [m^2].
        effort: `WalkEffort`.
        rng: Random generator for all choices.

    Returns:
        Index of the last stages (-1 where nothing is below the bound, and the word then is as it
        was) and the squared cost [m^2].
    """
    stages, target = goal.stages, goal.target
    here, last = word.copy(), -1
    before, after = np.empty((STATES, 12)), np.empty((STATES, 12))
    wanted, work, misfits = np.empty(12), np.empty(6), np.empty(_PAIRS)
    least, looked = np.inf, 0
    for _ in range(effort.steps):
        if looked >= effort.looks:
            break
        i, j = _two_of(here.shape[0], rng)
        _frames(stages, here, target, i, j, before, after)
        now = STATES * here[i] + here[j]
        for pair in range(_PAIRS):
            relative(after[pair % STATES], before[pair // STATES], wanted)
            misfits[pair] = misfit(shape, wanted, work)
            if pair == now or misfits[pair] >= max(WORTH_A_LOOK, least):
                continue
            least, looked = min(least, misfits[pair]), looked + 1
            found, cost = nearest(tree, wanted, bound)
            if found >= 0:
                bound, last = cost, found
                word[:] = here
                word[i], word[j] = pair // STATES, pair % STATES
        pair = _drawn(misfits, rng)
        here[i], here[j] = pair // STATES, pair % STATES
    return last, bound


@numba.njit(cache=True)
def _two_of(count, rng):
    """Draw two different numbers below the count, the smaller first."""
    i, j = rng.integers(0, count), rng.integers(0, count - 1)
    return (i, j + 1) if j >= i else (j, i)


@numba.njit(cache=True)
def _frames(stages, word, target, i, j, before, after):
    """Write what is wanted behind the stages up to j, and the stages from j on.

    Args:
        stages: (8, 12) pose of a stage in each state.
        word: (h,) states.
        target: (12,) pose that is wanted.
        i: Stage whose states are tried,
        j: and another, farther on.
        before: (8, 12) receives the target in the frame before stage j, for each state of i.
        after: (8, 12) receives the pose from there to the last stage, for each state of j.
    """
    wanted, rest = target.copy(), identity()
    for k in range(i):
        relative(stages[word[k]], wanted, wanted)
    for k in range(word.shape[0] - 1, j, -1):
        compose(stages[word[k]], rest, after[0])
        rest[:] = after[0]
    for state in range(STATES):
        relative(stages[state], wanted, before[state])
        for k in range(i + 1, j):
            relative(stages[word[k]], before[state], before[state])
        compose(stages[state], rest, after[state])


@numba.njit(cache=True)
def _drawn(misfits, rng):
    """Draw an index with the chance exp(-misfit / warmth)."""
    least = misfits.min()
    left = rng.random() * np.exp((least - misfits) / WARMTH).sum()
    for k in range(misfits.shape[0]):
        left -= np.exp((least - misfits[k]) / WARMTH)
        if left < 0.0:
            return k
    return np.argmin(misfits)
