"""Which words keep the arm clear of obstacles.

Obstacles are a function of places, which a stage is sampled for at points of its three legs and its
platform's disc, or voxels, which legs and disc are tested against whole. A stage hangs on those
before it only, so a beginning that touches rules out all words that begin with it. Words that swap
straight stages reach one pose with different bodies: here both count.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from controllers.braid.arm.chain import MAX_ENUMERATED, forward, identity
from controllers.braid.arm.stage import STATES, FloatArray, IntArray, StageGeometry, rim_joints
from controllers.braid.arm.stage import state_poses as solve_states
from controllers.braid.arm.voxel_obstacles import VoxelObstacles, stages_clear

Occupancy = Callable[[FloatArray], FloatArray]
"""Chance (n,) that places (n, 3) [m] in the arm's base frame are occupied."""
FREE_BELOW = 0.5
_ALONG, _RIM = 5, 12


def body_points(geometry: StageGeometry) -> FloatArray:
    """Return points (8, s, 3) [m] of a stage's body in its base frame, for each state."""
    joints = rim_joints(geometry.radius)
    bearing = 2.0 * np.pi * np.arange(_RIM) / _RIM
    rim = geometry.radius * np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(_RIM)])
    disc = np.vstack([np.zeros((1, 3)), 0.5 * rim[::2], rim])
    along = np.linspace(0.0, 1.0, _ALONG)[1:, None, None]  # the base joint is the disc's before
    points = []
    for pose in solve_states(geometry):
        rotation = pose[3:].reshape(3, 3)
        tops = joints @ rotation.T + pose[:3]
        legs = (joints + along * (tops - joints)).reshape(-1, 3)
        points.append(np.vstack([legs, disc @ rotation.T + pose[:3]]))
    return np.array(points)


class LinkCheck:
    """Tells which words collide with what is occupied.

    Attributes:
        stages: (8, 12) pose of a stage in each state.
    """

    def __init__(self, geometry: StageGeometry, obstacles: Occupancy | VoxelObstacles) -> None:
        """Prepare the body.

        Args:
            geometry: Sizes of the stages.
            obstacles: Voxels; or the chance that a place is occupied, which counts where it is not
                below `FREE_BELOW`: NaN, as maps say of unknown places, does.
        """
        self.stages = solve_states(geometry)
        self._joints = rim_joints(geometry.radius)
        self._body = body_points(geometry)
        self._obstacles = obstacles

    def free(self, words: IntArray) -> np.ndarray:
        """Return which words (m, n) keep every stage clear, (m,) bool.

        Beginnings that words share are looked at once.
        """
        words = np.asarray(words, dtype=np.int64)
        clear = np.ones(len(words), dtype=bool)
        for k in range(words.shape[1]):
            at = np.flatnonzero(clear)
            if at.size == 0:
                break
            beginnings, which = np.unique(words[at, : k + 1], axis=0, return_inverse=True)
            clear[at] = self.last_stage_free(beginnings)[which.ravel()]
        return clear

    def last_stage_free(self, beginnings: IntArray) -> np.ndarray:
        """Return whether the last stage of each word (m, k) is clear, whatever those before are.

        Args:
            beginnings: (m, k) states, base first.

        Raises:
            ValueError: If the occupancy does not answer for every place.
        """
        if beginnings.shape[1] > 1:
            base = forward(self.stages, beginnings[:, :-1])
        else:
            base = np.tile(identity(), (len(beginnings), 1))
        if isinstance(self._obstacles, VoxelObstacles):
            centres, reach = self._obstacles.centres, self._obstacles.reach
            states = np.ascontiguousarray(beginnings[:, -1])
            return stages_clear(base, states, self.stages, self._joints, centres, reach)
        body = self._body[beginnings[:, -1]]
        rotation = base[:, 3:].reshape(-1, 3, 3)
        points = np.einsum("mij,msj->msi", rotation, body) + base[:, None, :3]
        chance = np.asarray(self._obstacles(points.reshape(-1, 3)))
        if chance.shape != (points.shape[0] * points.shape[1],):
            raise ValueError(f"occupancy returned {chance.shape}: expected one chance a place")
        return np.all(chance.reshape(points.shape[:2]) < FREE_BELOW, axis=1)


def free_words(check: LinkCheck, count: int) -> IntArray:
    """Return all words (m, n) of a few stages that keep clear, grown stage by stage.

    Raises:
        ValueError: If the stages are too many to list.
    """
    if not 1 <= count <= MAX_ENUMERATED:
        raise ValueError(f"{count} stages: expected 1 to {MAX_ENUMERATED} to list all words")
    words = np.empty((1, 0), dtype=np.int64)
    for _ in range(count):
        grown = np.repeat(words, STATES, axis=0)
        last = np.tile(np.arange(STATES), len(words))
        words = np.column_stack([grown, last])
        words = words[check.last_stage_free(words)]
        if len(words) == 0:
            return np.empty((0, count), dtype=np.int64)
    return words
