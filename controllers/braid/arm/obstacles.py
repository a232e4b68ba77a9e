"""Which words keep the arm clear of obstacles.

Obstacles are a function of places, which a stage is sampled for at points of its three legs and its
platform's disc, or voxels, which legs and disc are tested against whole: points sampled on the arm
slip between voxels that are smaller than their spacing. There the legs are line segments and the
platforms discs, and a voxel is the ball around it: nothing that touches is missed, and what is
called touching is nearer than a ball's radius, 0.87 of a side, and the margin.

A stage hangs on those before it only, so a beginning that touches rules out all words that begin
with it. Words that swap straight stages reach one pose with different bodies: here both count.
"""

import dataclasses
from collections.abc import Callable

import numba
import numpy as np

from controllers.braid.arm.chain import compose, forward
from controllers.braid.arm.stage import STATES, StageGeometry, rim_joints, state_poses
from perception.geometry.arrays import FloatArray, IntArray

Occupancy = Callable[[FloatArray], FloatArray]
"""Probability (n,) that places (n, 3) [m], arm's base frame, are occupied."""
FREE_BELOW = 0.5
"""Probability of occupancy below which the arm may be at a place."""
_ALONG, _RIM = 5, 12


@dataclasses.dataclass(frozen=True)
class VoxelObstacles:
    """Cubes that are occupied, of any orientation.

    Attributes:
        centres: (k, 3) middles of the cubes [m] in the arm's base frame; kept in order of z.
        side: Edge length of a cube [m].
        margin: That the arm's legs and discs keep besides, for instance half their thickness [m].
    """

    centres: FloatArray
    side: float
    margin: float = 0.0

    def __post_init__(self) -> None:
        """Sort the cubes.

        Raises:
            ValueError: Naming what is no cube or margin.
        """
        centres = np.asarray(self.centres, dtype=np.float64)
        centres = centres.reshape(-1, 3) if centres.size == 0 else centres
        if centres.ndim != 2 or centres.shape[1] != 3 or not np.all(np.isfinite(centres)):
            raise ValueError(f"centres {centres.shape}: expected (k, 3) finite numbers")
        if not (np.isfinite(self.side) and self.side > 0.0):
            raise ValueError(f"side {self.side}: expected a positive length")
        if not (np.isfinite(self.margin) and self.margin >= 0.0):
            raise ValueError(f"margin {self.margin}: expected a length of 0 or more")
        order = np.argsort(centres[:, 2], kind="stable")
        object.__setattr__(self, "centres", np.ascontiguousarray(centres[order]))

    @property
    def reach(self) -> float:
        """Distance from a centre within which the arm may touch [m]."""
        return 0.5 * float(np.sqrt(3.0)) * self.side + self.margin


def body_points(geometry: StageGeometry) -> FloatArray:
    """Return points (8, s, 3) [m] of a stage's body in its base frame, for each state."""
    joints = rim_joints(geometry.radius)
    bearing = 2.0 * np.pi * np.arange(_RIM) / _RIM
    rim = geometry.radius * np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(_RIM)])
    disc = np.vstack([np.zeros((1, 3)), 0.5 * rim[::2], rim])
    along = np.linspace(0.0, 1.0, _ALONG)[1:, None, None]  # the base joint is the disc's before
    points = []
    for pose in state_poses(geometry):
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
        self.stages = state_poses(geometry)
        self._joints = rim_joints(geometry.radius)
        self._body = body_points(geometry)
        self._obstacles = obstacles

    def free(self, words: IntArray) -> np.ndarray:
        """Return which words (m, n) keep every stage clear, (m,) bool.

        Beginnings that words share are checked once.
        """
        words = np.asarray(words, dtype=np.int64)
        clear, beginning = np.ones(len(words), dtype=bool), np.zeros(len(words), dtype=np.int64)
        for k in range(words.shape[1]):
            at = np.flatnonzero(clear)
            longer = beginning[at] * STATES + words[at, k]
            _, first, beginning[at] = np.unique(longer, return_index=True, return_inverse=True)
            clear[at] = self.last_stage_free(words[at[first], : k + 1])[beginning[at]]
        return clear

    def last_stage_free(self, beginnings: IntArray) -> np.ndarray:
        """Return whether the last stage of each word (m, k) is clear, whatever those before are.

        Args:
            beginnings: (m, k) states, base first.

        Raises:
            ValueError: If the occupancy does not answer for every place.
        """
        base = forward(self.stages, beginnings[:, :-1])
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


@numba.njit(cache=True)
def stages_clear(bases, states, stages, joints, centres, reach):
    """Return which stages (m,) are farther than a reach from all centres.

    Args:
        bases: (m, 12) pose of the disc below each stage.
        states: (m,) of each stage.
        stages: (8, 12) pose of a stage in each state.
        joints: (3, 3) joints on the rim of a disc, in its frame; the first at the disc's radius.
        centres: (k, 3) in order of z.
        reach: [m].
    """
    clear = np.ones(bases.shape[0], dtype=np.bool_)
    radius = np.sqrt((joints[0] ** 2).sum())
    top, legs, middle = np.empty(12), np.empty((2, 3, 3)), np.empty(3)
    for i in range(bases.shape[0]):
        compose(bases[i], stages[states[i]], top)
        middle[:] = 0.5 * (bases[i, :3] + top[:3])
        bound = np.sqrt(_squared(top, middle)) + radius + reach  # of the whole stage
        first = np.searchsorted(centres[:, 2], middle[2] - bound)
        end = np.searchsorted(centres[:, 2], middle[2] + bound)
        for k in range(3):
            _place(bases[i], joints[k], legs[0, k])
            _place(top, joints[k], legs[1, k])
        for v in range(first, end):
            if _squared(centres[v], middle) > bound * bound:
                continue
            near = _from_disc(top, radius, centres[v])
            for k in range(3):
                near = min(near, _from_segment(legs[0, k], legs[1, k], centres[v]))
            if near <= reach * reach:
                clear[i] = False
                break
    return clear


@numba.njit(cache=True)
def _squared(a, b):
    """Return the squared distance of two places; numbers only, for arrays would be allocated."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@numba.njit(cache=True)
def _place(pose, point, out):
    for d in range(3):
        row = 3 + 3 * d
        out[d] = pose[d] + pose[row] * point[0] + pose[row + 1] * point[1]
        out[d] += pose[row + 2] * point[2]


@numba.njit(cache=True)
def _from_segment(start, end, point):
    """Return the squared distance of a point from a segment."""
    length, along = _squared(start, end), 0.0
    for d in range(3):
        along += (end[d] - start[d]) * (point[d] - start[d])
    share = min(max(along / length, 0.0), 1.0)
    total = 0.0
    for d in range(3):
        total += (start[d] + share * (end[d] - start[d]) - point[d]) ** 2
    return total


@numba.njit(cache=True)
def _from_disc(pose, radius, point):
    """Return the squared distance of a point from a flat disc about the z axis of a pose."""
    height, whole = 0.0, _squared(point, pose)
    for d in range(3):
        height += pose[5 + 3 * d] * (point[d] - pose[d])
    out = np.sqrt(max(whole - height * height, 0.0)) - radius
    return height * height + max(out, 0.0) ** 2
