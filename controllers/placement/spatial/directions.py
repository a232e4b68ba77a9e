"""Directions of the half sphere before a target, in a tree of triangles.

The upper half of an octahedron, each triangle cut into four level by level. The triangles of the
last level stand for their centres: those are the directions that a search tries.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DEEPEST = 8


@dataclasses.dataclass(frozen=True)
class DirectionTree:
    """All triangles of all levels; those within triangle k are 4 k + 4 to 4 k + 7.

    Attributes:
        centres: (N, 3) unit vectors, z along the target's normal.
        radii: (N,) largest angle from the centre to a point of the triangle [rad].
        level: Of the last triangles; the first four have level 0.
        first_leaf: Number of the first triangle of the last level.
    """

    centres: FloatArray
    radii: FloatArray
    level: int
    first_leaf: int

    @property
    def leaves(self) -> FloatArray:
        """(4^(level + 1), 3) directions that a search tries."""
        return self.centres[self.first_leaf :]

    def least(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return (N,) the least of the leaves' values (leaves,) within each triangle."""
        parts = [values]
        while len(parts[0]) > 4:  # noqa: PLR2004
            parts.insert(0, parts[0].reshape(-1, 4).min(axis=1))
        return np.concatenate(parts)


@functools.cache
def direction_tree(level: int) -> DirectionTree:
    """Return the tree down to a level: 4^(level + 1) directions.

    Args:
        level: 0 to `DEEPEST`; at 5 neighbours are about 2 deg apart, at 6 about 1 deg.

    Raises:
        ValueError: If it is another.
    """
    if not 0 <= level <= DEEPEST:
        raise ValueError(f"level {level}: expected 0 to {DEEPEST}")
    x, y, top = np.eye(3)
    corners = np.array([[x, y, top], [y, -x, top], [-x, -y, top], [-y, x, top]])
    centres: list[FloatArray] = []
    radii: list[FloatArray] = []
    for step in range(level + 1):
        if step:
            corners = _quartered(corners)
        middle = corners.sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        centres.append(middle)
        # Half chords keep small angles exact.
        chord = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        radii.append(2.0 * np.arcsin(chord / 2.0))
    first = sum(len(part) for part in centres[:-1])
    tree = DirectionTree(np.concatenate(centres), np.concatenate(radii), level, first)
    tree.centres.setflags(write=False)
    tree.radii.setflags(write=False)
    return tree


def _quartered(corners: FloatArray) -> FloatArray:
    """Return (4 N, 3, 3) corners of the four parts of each of N triangles, in order."""
    middles = corners + np.roll(corners, -1, axis=1)
    middles /= np.linalg.norm(middles, axis=2, keepdims=True)
    a, b, c = (corners[:, i] for i in range(3))
    ab, bc, ca = (middles[:, i] for i in range(3))
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)
