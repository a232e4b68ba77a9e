"""How far an arm leans its base on the springs by its weight: known before it is measured.

The suspension that chapter 2 identifies, fed forward: what stands still in the world moves in the
robot's frame when the arm reaches out, by what stiffness and levers say (Thesis eq. 2-1 at rest).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.sensing.surrogate_tilt import TiltAxis, tilting_moments

FloatArray = NDArray[np.float64]


class BaseTilt:
    """A base at rest on its springs, under an arm."""

    def __init__(self, pitch: TiltAxis, roll: TiltAxis, mount: ArrayLike) -> None:
        """Prepare.

        Args:
            pitch: How the base tilts about x, as identified.
            roll: About y. By eq. A-1 it is up to a half stiffer than a rover whose centre joint is
                free.
            mount: (3,) the arm's base in the robot frame [m].
        """
        stiffness = np.array([[pitch.stiffness], [roll.stiffness]])
        self._give = tilting_moments(pitch, roll) / stiffness
        x, y, z = np.asarray(mount, dtype=float)
        # A point of each line about which the base tilts.
        self._pitch_line = np.array([0.0, y - pitch.lever[0], z - pitch.lever[1]])
        self._roll_line = np.array([x + roll.lever[0], 0.0, z - roll.lever[1]])

    def tilt(self, change: ArrayLike) -> FloatArray:
        """Return (2,) by how much pitch and roll change in the end [rad].

        Args:
            change: (6,) of the wrench by the rover on its arm, in and about the arm's base
                [N, N m].
        """
        return self._give @ np.asarray(change, dtype=float)

    def motion(self, tilt: ArrayLike) -> RigidTransform:
        """Return the transform from the robot frame when it leans to the one before.

        Args:
            tilt: (2,) by how much pitch and roll have changed [rad].
        """
        pitch, roll = np.asarray(tilt, dtype=float)
        nod = _about(self._pitch_line, [pitch, 0.0, 0.0])
        return nod * _about(self._roll_line, [0.0, roll, 0.0])


def _about(point: FloatArray, turn: ArrayLike) -> RigidTransform:
    """Return a turn by a rotation vector (3,) [rad] about a point (3,) [m]."""
    rotation = Rotation.from_rotvec(turn)
    return RigidTransform.from_components(point - rotation.apply(point), rotation)
