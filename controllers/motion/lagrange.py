"""The nine coordinates of a rover with its arm in the plane of its pitch (Thesis eqs A-2, A-3).

q = (x_v, y_v, theta_v, theta_s, x_s, y_s, theta_1, theta_2, theta_3): the vehicle, the deflection
of its suspension, and the arm. The thesis' x is forward and its y up: here y and z, and the angles
are pitches about x. The printed inputs repeat Q8; they are Q4 to Q9.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from controllers.kinematics.rigid_motion import LEVEL, WEIGHTLESS
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from twin.description import JointDescription, RigidBody

COUNT = 9
_YAW = 6
_HERE = RigidTransform.identity()


class NineCoordinates:
    """H(q) q'' + h(q, q') - G = Q - J^T F for the nine coordinates.

    Args:
        vehicle: Unsprung body, in the vehicle's frame.
        base: Sprung body, in the same axes and about the same origin at rest.
        arm: Arm on the base, whose frame is the chain's robot frame: a yaw, then three hinges
            about x.
        yaw: Angle at which the arm's yaw is held [rad].

    Raises:
        ValueError: If the arm has not four joints.
    """

    def __init__(
        self,
        vehicle: RigidBody,
        base: RigidBody,
        arm: SerialChain,
        yaw: float = 0.0,
    ) -> None:
        if len(arm) != 4:
            raise ValueError(f"arm of {len(arm)} joints: expected a yaw and three more")
        pitch, forward, up = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        joints = (
            _free(forward, True, WEIGHTLESS),
            _free(up, True, WEIGHTLESS),
            _free(pitch, False, vehicle),
            _free(pitch, False, WEIGHTLESS),
            _free(forward, True, WEIGHTLESS),
            _free(up, True, base),
            _free(forward, True, arm.base, arm.transform_base_to_robot),
            *arm.joints,
        )
        self._chain = SerialChain(joints)
        # The flange does not slide and the yaw does not turn: their coordinates are left out.
        self._kept = np.array([0, 1, 2, 3, 4, 5, 8, 9, 10])
        self._held = np.zeros(len(joints))
        self._held[_YAW + 1] = yaw

    def mass_matrix(self, positions: ArrayLike) -> FloatArray:
        """Return (9, 9) H(q).

        Args:
            positions: (9,) [m, rad].
        """
        return self._chain.mass_matrix(self._full(positions))[np.ix_(self._kept, self._kept)]

    def efforts(
        self,
        positions: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        tip: ArrayLike | None = None,
    ) -> FloatArray:
        """Return (9,) the generalised efforts Q that move it so [N, N m].

        Args:
            positions: (9,) [m, rad].
            rates: (9,).
            accelerations: (9,).
            tip: (6,) force and moment that the last link exerts on the world, in its frame.
        """
        pose, speeds = self._full(positions), self._moving(rates)
        moved = self._chain.inverse_dynamics(pose, speeds, self._moving(accelerations), LEVEL, tip)
        return moved[0][self._kept]

    def bias(self, positions: ArrayLike, rates: ArrayLike) -> FloatArray:
        """Return (9,) h(q, q') - G: the efforts of zero accelerations [N, N m].

        Args:
            positions: (9,) [m, rad].
            rates: (9,).
        """
        return self.efforts(positions, rates, np.zeros(COUNT))

    def state_space(
        self, positions: ArrayLike, stiffness: ArrayLike | None = None,
        damping: ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Return A (12, 12), B (12, 6) and C (6, 12) of eq. A-3, the vehicle held.

        The state is (theta_s, x_s, y_s, theta_1..3) and its rates. As printed the inputs take all
        forces, also those of the suspension. With its stiffness and damping they are part of A.

        Args:
            positions: (9,) about which it is linearised [m, rad].
            stiffness: (3,) of theta_s, x_s, y_s [N m/rad, N/m, N/m]; None as printed.
            damping: (3,) of the same; None for none.
        """
        inertia = self.mass_matrix(positions)[3:, 3:]
        inverse = np.linalg.inv(inertia)
        a, b, c = np.zeros((12, 12)), np.zeros((12, 6)), np.zeros((6, 12))
        a[:6, 6:], b[6:], c[:, :6] = np.eye(6), inverse, np.eye(6)
        for columns, values in ((slice(0, 3), stiffness), (slice(6, 9), damping)):
            if values is not None:
                a[6:, columns] = -inverse[:, :3] @ np.diag(np.asarray(values, dtype=float))
        return a, b, c

    def _full(self, positions: ArrayLike) -> FloatArray:
        full = self._held.copy()
        full[self._kept] = positions
        return full

    def _moving(self, values: ArrayLike) -> FloatArray:
        full = np.zeros(len(self._chain))
        full[self._kept] = values
        return full


def controllability_rank(a: FloatArray, b: FloatArray) -> int:
    """Return the rank of [B, AB, ..., A^(n-1) B].

    The time is scaled to the fastest eigenvalue and each block to its norm, which leaves the rank
    and keeps the numbers within reach of double precision.

    Args:
        a: (n, n) state matrix.
        b: (n, m) input matrix.
    """
    pace = float(np.max(np.abs(np.linalg.eigvals(a)), initial=0.0))
    scaled = a / pace if pace > 1.0 else a
    blocks, block = [b / np.linalg.norm(b)], b
    for _ in range(len(a) - 1):
        block = scaled @ block
        norm = float(np.linalg.norm(block))
        blocks.append(block / norm if norm > 0.0 else block)
    return int(np.linalg.matrix_rank(np.hstack(blocks)))


def observability_rank(a: FloatArray, c: FloatArray) -> int:
    """Return the rank of [C', A'C', ..., (A')^(n-1) C'], as `controllability_rank`.

    Args:
        a: (n, n) state matrix.
        c: (m, n) output matrix.
    """
    return controllability_rank(a.T, c.T)


def _free(
    axis: tuple[float, float, float],
    slides: bool,
    body: RigidBody,
    place: RigidTransform = _HERE,
) -> JointDescription:
    return JointDescription("", place, axis, body, slides=slides)
