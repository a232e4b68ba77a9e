"""Forward model of the rigid arm on a rigid base on a 6-DOF compliance, with its sensitivities.

Generalised coordinates q (6,): displacement of the base's centre of gravity along the world's
x, y, z [m], then hinge angles about x, y, z [rad] (outermost first), all from static rest. The
model is exact in the displacements; the sensitivities are those of its linearisation about rest
(gyroscopic and gravity terms kept), good to the size of the angles, about 1e-3.

Integration is Radau IIA with two stages (order 3, L-stable): the compliance has time constants
below a millisecond, so an explicit step of 5 ms would be unstable.
"""

from __future__ import annotations

import dataclasses

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from controllers.identification.arm_motion import RigidArm, Trajectory, mode_axes
from controllers.identification.equations import (
    arm_kinematics,
    linear_matrices,
    output_sensitivity,
    parameter_force,
    residual,
)
from controllers.identification.parameters import COUNT

FloatArray = NDArray[np.float64]

CHANNELS = 24
SIGNALS = {
    "displacement": slice(0, 3),
    "velocity": slice(3, 6),
    "acceleration": slice(6, 9),
    "angles": slice(9, 12),
    "angle_rates": slice(12, 15),
    "angle_accelerations": slice(15, 18),
    "force": slice(18, 21),
    "moment": slice(21, 24),
}
"""Rows of an output sample: deviations from static rest (Thesis eq. 2-1, 'measured')."""


@dataclasses.dataclass(frozen=True)
class BaseState:
    """State of the base and its sensitivities between two windows.

    Attributes:
        position: q (6,).
        velocity: (6,).
        position_sensitivity: dq/dparameters (6, 22).
        velocity_sensitivity: (6, 22).
    """

    position: FloatArray
    velocity: FloatArray
    position_sensitivity: FloatArray
    velocity_sensitivity: FloatArray

    @classmethod
    def at_rest(cls) -> BaseState:
        """Return the static rest."""
        return cls(np.zeros(6), np.zeros(6), np.zeros((6, COUNT)), np.zeros((6, COUNT)))


@dataclasses.dataclass(frozen=True)
class ArmOnMount:
    """One mode's arm: constants that the compiled model reads.

    Attributes:
        mass: Arm mass [kg].
        inertia: (3, 3) about its centre at angle zero, base frame [kg m^2].
        centre: (3,) centre from the mount at angle zero [m].
        axis: (3,) unit axis of rotation.
        rest_angle: Angle at which the springs were at rest [rad].
    """

    mass: float
    inertia: FloatArray
    centre: FloatArray
    axis: FloatArray
    rest_angle: float

    @classmethod
    def of(cls, arm: RigidArm, mode: str, rest_angle: float = np.pi / 4) -> ArmOnMount:
        """Hold `arm` in `mode` (see `mode_axes`)."""
        axis, rotation = mode_axes(mode)
        inertia = rotation @ np.diag(arm.inertia) @ rotation.T
        centre = rotation @ np.array([0.0, arm.centre, 0.0])
        return cls(arm.mass, inertia, centre, axis, rest_angle)

    def rest_centre(self) -> FloatArray:
        """Return the arm's centre (3,) from the mount at rest, base frame [m]."""
        turn = Rotation.from_rotvec(self.rest_angle * self.axis)
        return turn.apply(self.centre)


def simulate(
    parameters: FloatArray,
    arm: ArmOnMount,
    trajectory: Trajectory,
    state: BaseState,
    sensitivities: bool = True,
    substeps: int = 1,
) -> tuple[FloatArray, FloatArray, BaseState]:
    """Move the base under a swinging arm.

    Args:
        parameters: (22,) physical parameters.
        arm: The arm, held in one mode.
        trajectory: Arm motion over n steps.
        state: Start.
        sensitivities: Whether to integrate the sensitivities as well.
        substeps: Integration steps per trajectory step.

    Returns:
        Outputs (n, 24) at the steps' ends, their derivatives (n, 24, 22) by the parameters (empty
        if not asked for), and the state at the end.
    """
    count = len(trajectory.jerk)
    outputs = np.empty((count, CHANNELS))
    derivatives = np.zeros((count if sensitivities else 0, CHANNELS, COUNT))
    position, velocity = state.position.copy(), state.velocity.copy()
    sens_q = state.position_sensitivity.copy()
    sens_v = state.velocity_sensitivity.copy()
    _integrate(
        parameters,
        arm.mass,
        _rows(arm.inertia),
        tuple(arm.centre.tolist()),
        tuple(arm.axis.tolist()),
        arm.rest_angle,
        trajectory.time_step,
        substeps,
        trajectory.angle,
        trajectory.rate,
        trajectory.acceleration,
        trajectory.jerk,
        position,
        velocity,
        sens_q,
        sens_v,
        outputs,
        derivatives,
    )
    return outputs, derivatives, BaseState(position, velocity, sens_q, sens_v)


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


@numba.njit(cache=True)
def _solve_in_place(matrix, rhs):
    """Gaussian elimination without pivoting: Radau's stage matrix has positive pivots."""
    n, m = matrix.shape[0], rhs.shape[1]
    for k in range(n):
        inverse = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            factor = matrix[i, k] * inverse
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                for j in range(m):
                    rhs[i, j] -= factor * rhs[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            factor = matrix[k, i]
            for j in range(m):
                rhs[k, j] -= factor * rhs[i, j]
        inverse = 1.0 / matrix[k, k]
        for j in range(m):
            rhs[k, j] *= inverse


# Radau IIA, two stages: nodes 1/3 and 1, coefficients A and A^2.
_A = np.array([[5.0 / 12, -1.0 / 12], [3.0 / 4, 1.0 / 4]])
_A2 = _A @ _A
_NODES = np.array([1.0 / 3, 1.0])


@numba.njit(cache=True)
def _stage_matrix(h, mass, damping, stiffness, matrix):
    for i in range(2):
        for j in range(2):
            for r in range(6):
                for c in range(6):
                    value = h * _A[i, j] * damping[i, r, c] + h * h * _A2[i, j] * stiffness[i, r, c]
                    if i == j:
                        value += mass[i, r, c]
                    matrix[6 * i + r, 6 * j + c] = value


@numba.njit(cache=True)
def _invert(matrix):
    inverse = np.eye(matrix.shape[0])
    _solve_in_place(matrix, inverse)
    return inverse


@numba.njit(cache=True)
def _stage_motion(h, i, q, v, stages):
    """Position and velocity at stage i from the stage accelerations (2, ...)."""
    position = q + h * _NODES[i] * v + h * h * (_A2[i, 0] * stages[0] + _A2[i, 1] * stages[1])
    velocity = v + h * (_A[i, 0] * stages[0] + _A[i, 1] * stages[1])
    return position, velocity


@numba.njit(cache=True)
def _stage_kinematics(inertia, centre, axis, angle, rate, acceleration, jerk, t):
    f2 = acceleration + jerk * t
    f1 = rate + t * (acceleration + jerk * t / 2)
    f0 = angle + t * (rate + t * (acceleration / 2 + jerk * t / 6))
    return arm_kinematics(inertia, centre, axis, f0, f1, f2)


@numba.njit(cache=True)
def _newton(h, p, arm_mass, kins, rest_wrench, inverse, q, v, stage, work):
    """Solve for the stage accelerations; the linearised matrix is close, so two steps do."""
    for _ in range(2):
        for i in range(2):
            position, velocity = _stage_motion(h, i, q, v, stage)
            residual(
                p, arm_mass, kins[i], rest_wrench, position, velocity, stage[i], work[6 * i :]
            )
        for r in range(12):
            change = 0.0
            for c in range(12):
                change += inverse[r, c] * work[c]
            stage[r // 6, r % 6] -= change


@numba.njit(cache=True)
def _sensitivity_step(
    h, p, arm_mass, kins, rest_wrench, inverse, damping, stiffness, q, v, stage, s_q, s_v, work
):
    """Advance s_q, s_v (6, 22) by one step, and return the stage sensitivities (2, 6, 22)."""
    columns, rhs = np.empty((6, 22)), np.empty((12, 22))
    for i in range(2):
        position, velocity = _stage_motion(h, i, q, v, stage)
        force, _ = residual(p, arm_mass, kins[i], rest_wrench, position, velocity, stage[i], work)
        parameter_force(p, arm_mass, kins[i], force, position, velocity, stage[i], columns)
        drift = s_q + h * _NODES[i] * s_v
        rhs[6 * i : 6 * i + 6] = -(columns + damping[i] @ s_v + stiffness[i] @ drift)
    s_stage = (inverse @ rhs).reshape(2, 6, 22)
    position, velocity = _stage_motion(h, 1, s_q, s_v, s_stage)
    s_q[:], s_v[:] = position, velocity
    return s_stage


@numba.njit(cache=True)
def _integrate(
    p, arm_mass, inertia, centre, axis, rest_angle, time_step, substeps,
    angle, rate, acceleration, jerk, q, v, s_q, s_v, outputs, derivatives,
):  # fmt: skip
    """Step the base over the whole trajectory; q, v, s_q, s_v are updated in place."""
    rest_wrench, work, still = np.zeros(6), np.zeros(12), np.zeros(6)
    rest = arm_kinematics(inertia, centre, axis, rest_angle, 0.0, 0.0)
    rest_force, rest_moment = residual(p, arm_mass, rest, rest_wrench, still, still, still, work)
    rest_wrench[:] = work[:6]
    h = time_step / substeps
    mass, damping, stiffness = np.empty((2, 6, 6)), np.empty((2, 6, 6)), np.empty((2, 6, 6))
    matrix, stage, s_stage = np.empty((12, 12)), np.zeros((2, 6)), np.empty((2, 6, 22))
    for n in range(jerk.shape[0]):
        polynomial = (angle[n], rate[n], acceleration[n], jerk[n])
        for sub in range(substeps):
            first = _stage_kinematics(inertia, centre, axis, *polynomial, h * (sub + _NODES[0]))
            last = _stage_kinematics(inertia, centre, axis, *polynomial, h * (sub + _NODES[1]))
            kins = (first, last)
            for i in range(2):
                linear_matrices(p, arm_mass, kins[i], mass[i], damping[i], stiffness[i])
            _stage_matrix(h, mass, damping, stiffness, matrix)
            inverse = _invert(matrix)
            _newton(h, p, arm_mass, kins, rest_wrench, inverse, q, v, stage, work)
            if derivatives.shape[0] > 0:
                s_stage = _sensitivity_step(
                    h, p, arm_mass, kins, rest_wrench, inverse, damping, stiffness,
                    q, v, stage, s_q, s_v, work,
                )  # fmt: skip
            position, velocity = _stage_motion(h, 1, q, v, stage)
            q[:], v[:] = position, velocity
        force, moment = residual(p, arm_mass, last, rest_wrench, q, v, stage[1], work)
        for i in range(3):
            outputs[n, i], outputs[n, 3 + i], outputs[n, 6 + i] = q[i], v[i], stage[1, i]
            outputs[n, 9 + i], outputs[n, 12 + i] = q[3 + i], v[3 + i]
            outputs[n, 15 + i] = stage[1, 3 + i]
            outputs[n, 18 + i] = force[i] - rest_force[i]
            outputs[n, 21 + i] = moment[i] - rest_moment[i]
        if derivatives.shape[0] > 0:
            output_sensitivity(p, arm_mass, last, s_q, s_v, s_stage[1], stage[1], derivatives[n])
