"""Forward model of a rigid arm on a rigid base on a 6-DOF compliance, with its sensitivities.

Newton-Euler equations (Thesis appendix B.1), compiled. Generalised coordinates q (6,) are the
displacement of the base's centre of gravity along the world's x, y, z [m], then hinge angles about
x, y, z [rad] (outermost first), all from static rest.

Integration is Radau IIA with three stages (order 5, L-stable): the compliance has time constants
below a millisecond, so an explicit step of 5 ms would be unstable.

In the kernels vectors are tuples of three numbers and matrices tuples of three rows: numba keeps
them in registers, where small arrays would cost an allocation each. `p` is always the parameter
vector (22,) in the order of `parameters.NAMES`; vectors are in the base frame unless stated.
"""

from typing import NamedTuple

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from controllers.identification.arm_motion import RigidArm, Trajectory, mode_axes
from controllers.identification.parameters import COUNT
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY


class _Plant(NamedTuple):
    """What the equations of motion hold constant.

    Attributes:
        p: (22,) physical parameters.
        arm_mass: Mass of the arm [kg].
        rest_wrench: (6,) force and moment of the springs at static rest [N, N m].
    """

    p: FloatArray
    arm_mass: float
    rest_wrench: FloatArray


class _Motion(NamedTuple):
    """Generalised coordinates q (6,) with their first and second derivatives."""

    q: FloatArray
    v: FloatArray
    a: FloatArray


@numba.njit(cache=True, inline="always")
def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@numba.njit(cache=True, inline="always")
def _add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@numba.njit(cache=True, inline="always")
def _scale(s, a):
    return (s * a[0], s * a[1], s * a[2])


@numba.njit(cache=True, inline="always")
def _times(m, a):
    return (
        m[0][0] * a[0] + m[0][1] * a[1] + m[0][2] * a[2],
        m[1][0] * a[0] + m[1][1] * a[1] + m[1][2] * a[2],
        m[2][0] * a[0] + m[2][1] * a[1] + m[2][2] * a[2],
    )


@numba.njit(cache=True, inline="always")
def _transposed_times(m, a):
    return (
        m[0][0] * a[0] + m[1][0] * a[1] + m[2][0] * a[2],
        m[0][1] * a[0] + m[1][1] * a[1] + m[2][1] * a[2],
        m[0][2] * a[0] + m[1][2] * a[1] + m[2][2] * a[2],
    )


@numba.njit(cache=True)
def _turned(turn, m):
    """Return turn m turn^T."""
    c0 = _times(turn, _times(m, turn[0]))
    c1 = _times(turn, _times(m, turn[1]))
    c2 = _times(turn, _times(m, turn[2]))
    return ((c0[0], c1[0], c2[0]), (c0[1], c1[1], c2[1]), (c0[2], c1[2], c2[2]))


@numba.njit(cache=True)
def _rotation(axis, angle):
    """Rotation matrix about a unit axis (Rodrigues)."""
    s, c = np.sin(angle), np.cos(angle)
    v = 1 - c
    x, y, z = axis
    return (
        (c + v * x * x, v * x * y - s * z, v * x * z + s * y),
        (v * x * y + s * z, c + v * y * y, v * y * z - s * x),
        (v * x * z - s * y, v * y * z + s * x, c + v * z * z),
    )


@numba.njit(cache=True)
def _arm_kinematics(inertia, centre, axis, angle, rate, acceleration):
    """Return arm inertia, centre, its rate and acceleration, spin and its rate."""
    turn = _rotation(axis, angle)
    spin, spin_rate = _scale(rate, axis), _scale(acceleration, axis)
    position = _times(turn, centre)
    position_rate = _cross(spin, position)
    position_acceleration = _add(_cross(spin_rate, position), _cross(spin, position_rate))
    arm_inertia = _turned(turn, inertia)
    return arm_inertia, position, position_rate, position_acceleration, spin, spin_rate


@numba.njit(cache=True)
def _hinges(x, y, z, rates):
    """Base rotation R, body-rate matrix E (omega = E phi_dot), and E_dot phi_dot."""
    cx, sx, cy, sy, cz, sz = np.cos(x), np.sin(x), np.cos(y), np.sin(y), np.cos(z), np.sin(z)
    rotation = (
        (cy * cz, -cy * sz, sy),
        (cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy),
        (sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy),
    )
    rate_matrix = ((cy * cz, sz, 0.0), (-cy * sz, cz, 0.0), (sy, 0.0, 1.0))
    px, py, pz = rates
    bias = (
        (-sy * cz * py - cy * sz * pz) * px + cz * pz * py,
        (sy * sz * py - cy * cz * pz) * px - sz * pz * py,
        cy * py * px,
    )
    return rotation, rate_matrix, bias


@numba.njit(cache=True)
def _residual(plant, kin, motion, out):
    """Fill `out` (6,) with the exact equations of motion; return force and moment at the mount.

    Force rows are in the world frame, moment rows along the hinge axes (Thesis eq. B-2, B-3 with
    the slides outermost). The springs hold all weight at rest.
    """
    p, arm_mass, rest_wrench = plant
    q, v, a = motion
    arm_inertia, centre, centre_rate, centre_acceleration, spin, spin_rate = kin
    rates = (v[3], v[4], v[5])
    rotation, rate_matrix, rate_bias = _hinges(q[3], q[4], q[5], rates)
    omega = _times(rate_matrix, rates)
    alpha = _add(_times(rate_matrix, (a[3], a[4], a[5])), rate_bias)
    lever = _add((p[7], p[8], p[9]), centre)
    specific = (a[0], a[1], a[2] + GRAVITY)
    acceleration = _add(_transposed_times(rotation, specific), _cross(alpha, lever))
    acceleration = _add(acceleration, _cross(omega, _cross(omega, lever)))
    acceleration = _add(acceleration, _scale(2.0, _cross(omega, centre_rate)))
    force = _scale(arm_mass, _add(acceleration, centre_acceleration))
    total_spin = _add(omega, spin)
    total_alpha = _add(_add(alpha, spin_rate), _cross(omega, spin))
    turning = _add(
        _times(arm_inertia, total_alpha), _cross(total_spin, _times(arm_inertia, total_spin))
    )
    moment = _add(turning, _cross(centre, force))
    base = ((p[1], p[6], p[4]), (p[6], p[2], p[5]), (p[4], p[5], p[3]))
    torque = _add(_times(base, alpha), _cross(omega, _times(base, omega)))
    torque = _add(torque, _add(turning, _cross(lever, force)))
    hinge_torque = _transposed_times(rate_matrix, torque)
    pushed = _times(rotation, force)
    for i in range(3):
        out[i] = p[0] * a[i] + pushed[i] - rest_wrench[i] + p[10 + i] * v[i] + p[16 + i] * q[i]
        out[3 + i] = hinge_torque[i] - rest_wrench[3 + i]
        out[3 + i] += p[13 + i] * v[3 + i] + p[19 + i] * q[3 + i]
    return force, moment


@numba.njit(cache=True)
def _by_motion(plant, kin, motion, columns, work):
    """Fill (12, 18): derivatives of equations and wrench (six each) by q, v and a.

    Shift and its rate act through their springs and dampers alone. The rest are differences of the
    exact equations, which are linear in a; elsewhere a step of 1e-6 leaves an error of 1e-6, where
    a linearisation about rest would leave 1e-3.
    """
    base, changed = np.empty(12), np.empty(12)
    _stack(plant, kin, motion, base, work)
    columns[:, :] = 0.0
    p = plant.p
    for i in range(3):
        columns[i, i], columns[i, 6 + i] = p[16 + i], p[10 + i]
    for j in range(6):
        for k in range(2 if j < 3 else 0, 3):
            moving = (motion.q, motion.v, motion.a)[k]
            step = 1.0 if k == 2 else 1e-6
            kept = moving[j]
            moving[j] = kept + step
            _stack(plant, kin, motion, changed, work)
            moving[j] = kept
            for i in range(12):
                columns[i, 6 * k + j] = (changed[i] - base[i]) / step


@numba.njit(cache=True)
def _by_parameters(plant, kin, motion, columns, work):
    """Fill (12, 22): derivatives of equations and wrench by the parameters at fixed motion."""
    base, changed = np.empty(12), np.empty(12)
    _stack(plant, kin, motion, base, work)
    columns[:, :] = 0.0
    p, (q, v, a) = plant.p, motion
    _by_inertia(q, v, a, columns)
    for j in range(7, 10):
        kept = p[j]
        p[j] = kept + 1e-6
        _stack(plant, kin, motion, changed, work)
        p[j] = kept
        for i in range(12):
            columns[i, j] = (changed[i] - base[i]) / 1e-6
    for i in range(3):
        columns[i, 0] = a[i]
    # The weight at rest turns with the lever: rest_wrench holds r2 x F0.
    columns[3, 8] -= plant.arm_mass * GRAVITY
    columns[4, 7] += plant.arm_mass * GRAVITY
    for i in range(6):
        columns[i, 10 + i] = v[i]
        columns[i, 16 + i] = q[i]


@numba.njit(cache=True)
def _by_inertia(q, v, a, columns):
    """Fill columns 1 to 6: the base's own torque is linear in the elements of its inertia."""
    rates = (v[3], v[4], v[5])
    _, rate_matrix, rate_bias = _hinges(q[3], q[4], q[5], rates)
    x, y, z = _times(rate_matrix, rates)
    alpha = _add(_times(rate_matrix, (a[3], a[4], a[5])), rate_bias)
    torques = (
        (alpha[0], x * z, -x * y),
        (-y * z, alpha[1], x * y),
        (y * z, -x * z, alpha[2]),
        (alpha[2] + x * y, z * z - x * x, alpha[0] - y * z),
        (y * y - z * z, alpha[2] - x * y, alpha[1] + x * z),
        (alpha[1] - x * z, alpha[0] + y * z, x * x - y * y),
    )
    for j in range(6):
        hinge_torque = _transposed_times(rate_matrix, torques[j])
        for i in range(3):
            columns[3 + i, 1 + j] = hinge_torque[i]


@numba.njit(cache=True)
def _stack(plant, kin, motion, out, work):
    force, moment = _residual(plant, kin, motion, work)
    for i in range(3):
        out[i], out[3 + i] = work[i], work[3 + i]
        out[6 + i], out[9 + i] = force[i], moment[i]


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


class BaseState(NamedTuple):
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
    def at_rest(cls) -> "BaseState":
        """Return the static rest."""
        return cls(np.zeros(6), np.zeros(6), np.zeros((6, COUNT)), np.zeros((6, COUNT)))


class ArmOnMount(NamedTuple):
    """One mode's arm: constants that the compiled model reads.

    Attributes:
        mass: Arm mass [kg].
        inertia: (3, 3) about its centre at angle zero, base frame [kg m^2], as rows.
        centre: (3,) centre from the mount at angle zero [m].
        axis: (3,) unit axis of rotation.
        rest_angle: Angle at which the springs were at rest [rad].
    """

    mass: float
    inertia: tuple[tuple[float, ...], ...]
    centre: tuple[float, ...]
    axis: tuple[float, ...]
    rest_angle: float

    @classmethod
    def of(cls, arm: RigidArm, mode: str, rest_angle: float = np.pi / 4) -> "ArmOnMount":
        """Hold `arm` in `mode` (see `mode_axes`)."""
        axis, rotation = mode_axes(mode)
        inertia = rotation @ np.diag(arm.inertia) @ rotation.T
        centre = rotation @ np.array([0.0, arm.centre, 0.0])
        rows = tuple(tuple(row) for row in inertia.tolist())
        return cls(arm.mass, rows, tuple(centre.tolist()), tuple(axis.tolist()), rest_angle)

    def rest_centre(self) -> FloatArray:
        """Return the arm's centre (3,) from the mount at rest, base frame [m]."""
        turn = Rotation.from_rotvec(self.rest_angle * np.array(self.axis))
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
    end = BaseState(*(part.copy() for part in state))
    _integrate(parameters, arm, trajectory, substeps, end, outputs, derivatives)
    return outputs, derivatives, end


@numba.njit(cache=True)
def _invert(matrix):
    """Return the inverse by Gaussian elimination; Radau's stage matrix has positive pivots.

    The matrix is overwritten.
    """
    n = matrix.shape[0]
    inverse = np.eye(n)
    for k in range(n):
        pivot = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            factor = matrix[i, k] * pivot
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                for j in range(n):
                    inverse[i, j] -= factor * inverse[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            factor = matrix[k, i]
            for j in range(n):
                inverse[k, j] -= factor * inverse[i, j]
        pivot = 1.0 / matrix[k, k]
        for j in range(n):
            inverse[k, j] *= pivot
    return inverse


STAGES = 3
_ROOT = np.sqrt(6.0)
_NODES = np.array([(4 - _ROOT) / 10, (4 + _ROOT) / 10, 1.0])
_A = np.array(
    [
        [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
        [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
        [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
    ]
)
_A2 = _A @ _A


@numba.njit(cache=True)
def _stage_matrix(h, motion_columns, matrix):
    """Fill the derivative of the stage equations by the stage accelerations."""
    for i in range(STAGES):
        for j in range(STAGES):
            for r in range(6):
                for c in range(6):
                    value = h * _A[i, j] * motion_columns[i, r, 6 + c]
                    value += h * h * _A2[i, j] * motion_columns[i, r, c]
                    if i == j:
                        value += motion_columns[i, r, 12 + c]
                    matrix[6 * i + r, 6 * j + c] = value


@numba.njit(cache=True)
def _stage_motion(h, i, q, v, stages, position, velocity):
    """Fill position and velocity at stage i from all stages' accelerations; all are flat."""
    for r in range(q.shape[0]):
        by_acceleration, rate = 0.0, v[r]
        for j in range(STAGES):
            by_acceleration += _A2[i, j] * stages[j, r]
            rate += h * _A[i, j] * stages[j, r]
        position[r] = q[r] + h * (_NODES[i] * v[r] + h * by_acceleration)
        velocity[r] = rate


@numba.njit(cache=True)
def _stage_kinematics(arm, path, n, t):
    """Return the arm's kinematics a time t [s] after the start of step n of its path."""
    acceleration, jerk = path.acceleration[n], path.jerk[n]
    f2 = acceleration + jerk * t
    f1 = path.rate[n] + t * (acceleration + jerk * t / 2)
    f0 = path.angle[n] + t * (path.rate[n] + t * (acceleration / 2 + jerk * t / 6))
    return _arm_kinematics(arm.inertia, arm.centre, arm.axis, f0, f1, f2)


@numba.njit(cache=True)
def _newton(h, plant, kins, inverse, state, stage, work):
    """Solve for the stage accelerations; the linearised matrix is close, so two steps do."""
    position, velocity = np.empty(6), np.empty(6)
    for _ in range(2):
        for i in range(STAGES):
            _stage_motion(h, i, state.position, state.velocity, stage, position, velocity)
            motion = _Motion(position, velocity, stage[i])
            _residual(plant, kins[i], motion, work[6 * i :])
        for r in range(6 * STAGES):
            change = 0.0
            for c in range(6 * STAGES):
                change += inverse[r, c] * work[c]
            stage[r // 6, r % 6] -= change


@numba.njit(cache=True)
def _sensitivity_step(h, inverse, motion_columns, parameter_columns, s_q, s_v):
    """Advance s_q, s_v (6, 22) by one step, and return the last stage's sensitivity (6, 22)."""
    rhs, shift = np.empty((6 * STAGES, 22)), np.empty(22)
    for i in range(STAGES):
        for r in range(6):
            row = rhs[6 * i + r]
            row[:] = parameter_columns[i, r]
            for k in range(6):
                by_position = motion_columns[i, r, k]
                by_rate = motion_columns[i, r, 6 + k] + h * _NODES[i] * by_position
                shift[:] = by_position * s_q[k] + by_rate * s_v[k]
                row += shift
    stages = -(inverse @ rhs).reshape(STAGES, 6 * 22)
    q, v = s_q.copy().reshape(6 * 22), s_v.copy().reshape(6 * 22)
    _stage_motion(h, STAGES - 1, q, v, stages, s_q.reshape(6 * 22), s_v.reshape(6 * 22))
    return stages[STAGES - 1].reshape(6, 22)


@numba.njit(cache=True)
def _store(motion, wrench, rest, row):
    q, v, a = motion
    for i in range(3):
        row[i], row[3 + i], row[6 + i] = q[i], v[i], a[i]
        row[9 + i], row[12 + i], row[15 + i] = q[3 + i], v[3 + i], a[3 + i]
        row[18 + i] = wrench[0][i] - rest[0][i]
        row[21 + i] = wrench[1][i] - rest[1][i]


@numba.njit(cache=True)
def _store_sensitivity(s_q, s_v, s_a, motion_columns, parameter_columns, rows):
    for i in range(2):
        part = slice(3 * i, 3 * i + 3)
        rows[9 * i : 9 * i + 3] = s_q[part]
        rows[9 * i + 3 : 9 * i + 6] = s_v[part]
        rows[9 * i + 6 : 9 * i + 9] = s_a[part]
    motion = np.empty((18, 22))
    motion[:6], motion[6:12], motion[12:] = s_q, s_v, s_a
    rows[18:] = parameter_columns[6:] + np.ascontiguousarray(motion_columns[6:]) @ motion


@numba.njit(cache=True)
def _integrate(p, arm, path, substeps, state, outputs, derivatives):
    """Step the base over the whole path; the state is updated in place."""
    h, q, v = path.time_step / substeps, state.position, state.velocity
    rest_wrench, work, still = np.zeros(6), np.zeros(6 * STAGES), np.zeros(6)
    plant = _Plant(p, arm.mass, rest_wrench)
    rest_kin = _arm_kinematics(arm.inertia, arm.centre, arm.axis, arm.rest_angle, 0.0, 0.0)
    rest = _residual(plant, rest_kin, _Motion(still, still, still), work)
    rest_wrench[:] = work[:6]
    with_sensitivities = derivatives.shape[0] > 0
    motion_columns, parameter_columns = np.zeros((STAGES, 12, 18)), np.zeros((STAGES, 12, 22))
    matrix, stage = np.empty((6 * STAGES, 6 * STAGES)), np.zeros((STAGES, 6))
    s_q, s_v, s_a = state.position_sensitivity, state.velocity_sensitivity, np.zeros((6, 22))
    position, velocity = np.empty(6), np.empty(6)
    kins = (rest_kin, rest_kin, rest_kin)
    for n in range(path.jerk.shape[0]):
        for sub in range(substeps):
            kins = (
                _stage_kinematics(arm, path, n, h * (sub + _NODES[0])),
                _stage_kinematics(arm, path, n, h * (sub + _NODES[1])),
                _stage_kinematics(arm, path, n, h * (sub + _NODES[2])),
            )
            for i in range(STAGES):
                _stage_motion(h, i, q, v, stage, position, velocity)
                motion = _Motion(position, velocity, stage[i])
                _by_motion(plant, kins[i], motion, motion_columns[i], work)
            _stage_matrix(h, motion_columns, matrix)
            inverse = _invert(matrix)
            _newton(h, plant, kins, inverse, state, stage, work)
            if with_sensitivities:
                for i in range(STAGES):
                    _stage_motion(h, i, q, v, stage, position, velocity)
                    motion = _Motion(position, velocity, stage[i])
                    _by_parameters(plant, kins[i], motion, parameter_columns[i], work)
                s_a = _sensitivity_step(h, inverse, motion_columns, parameter_columns, s_q, s_v)
            _stage_motion(h, STAGES - 1, q, v, stage, position, velocity)
            q[:], v[:] = position, velocity
        motion = _Motion(q, v, stage[-1])
        _store(motion, _residual(plant, kins[-1], motion, work), rest, outputs[n])
        if with_sensitivities:
            _store_sensitivity(
                s_q, s_v, s_a, motion_columns[-1], parameter_columns[-1], derivatives[n]
            )
