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


_UNITS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class _Turning(NamedTuple):
    """Base's rotation in the world and its rates, all vectors in the base frame.

    Attributes:
        rotation: (3, 3) rotation from base to world.
        axes: (3, 3) axes of the hinges, in columns: omega = axes phi_dot.
        omega: (3,) angular rate [rad/s].
        alpha: (3,) angular acceleration [rad/s^2].
        specific: (3,) acceleration of the base's centre less that of gravity [m/s^2].
    """

    rotation: tuple[tuple[float, ...], ...]
    axes: tuple[tuple[float, ...], ...]
    omega: tuple[float, ...]
    alpha: tuple[float, ...]
    specific: tuple[float, ...]


@numba.njit(cache=True)
def _turning(motion):
    q, v, a = motion
    rates = (v[3], v[4], v[5])
    rotation, axes, bias = _hinges(q[3], q[4], q[5], rates)
    alpha = _add(_times(axes, (a[3], a[4], a[5])), bias)
    specific = _transposed_times(rotation, (a[0], a[1], a[2] + GRAVITY))
    return _Turning(rotation, axes, _times(axes, rates), alpha, specific)


@numba.njit(cache=True)
def _base_inertia(p):
    return ((p[1], p[6], p[4]), (p[6], p[2], p[5]), (p[4], p[5], p[3]))


@numba.njit(cache=True)
def _lever(plant, kin):
    """Return the arm's centre from the base's centre of gravity (3,) [m]."""
    return _add((plant.p[7], plant.p[8], plant.p[9]), kin[1])


@numba.njit(cache=True)
def _torque(inertia, omega, alpha):
    """Return the torque that turns a body about its centre."""
    return _add(_times(inertia, alpha), _cross(omega, _times(inertia, omega)))


@numba.njit(cache=True)
def _torque_change(inertia, omega, change, alpha_change):
    """Return how `_torque` changes with these changes of omega and alpha (its differential)."""
    gyroscopic = _add(
        _cross(change, _times(inertia, omega)), _cross(omega, _times(inertia, change))
    )
    return _add(_times(inertia, alpha_change), gyroscopic)


@numba.njit(cache=True)
def _wrench(plant, kin, turning):
    """Return force and moment at the mount, and the torque that turns base and arm."""
    arm_inertia, centre, centre_rate, centre_acceleration, spin, spin_rate = kin
    _, _, omega, alpha, specific = turning
    lever, base = _lever(plant, kin), _base_inertia(plant.p)
    acceleration = _add(specific, _cross(alpha, lever))
    acceleration = _add(acceleration, _cross(omega, _cross(omega, lever)))
    acceleration = _add(acceleration, _scale(2.0, _cross(omega, centre_rate)))
    force = _scale(plant.arm_mass, _add(acceleration, centre_acceleration))
    total_alpha = _add(_add(alpha, spin_rate), _cross(omega, spin))
    arm_torque = _torque(arm_inertia, _add(omega, spin), total_alpha)
    torque = _add(_torque(base, omega, alpha), _add(arm_torque, _cross(lever, force)))
    return force, _add(arm_torque, _cross(centre, force)), torque


@numba.njit(cache=True)
def _wrench_change(plant, kin, turning, omega, alpha, specific):
    """Return how `_wrench` changes with these changes of the base's rates (its differential)."""
    arm_inertia, centre, centre_rate, _, spin, _ = kin
    lever, base = _lever(plant, kin), _base_inertia(plant.p)
    acceleration = _add(specific, _cross(alpha, lever))
    acceleration = _add(acceleration, _cross(omega, _cross(turning.omega, lever)))
    acceleration = _add(acceleration, _cross(turning.omega, _cross(omega, lever)))
    acceleration = _add(acceleration, _scale(2.0, _cross(omega, centre_rate)))
    force = _scale(plant.arm_mass, acceleration)
    total_alpha = _add(alpha, _cross(omega, spin))
    arm_torque = _torque_change(arm_inertia, _add(turning.omega, spin), omega, total_alpha)
    torque = _torque_change(base, turning.omega, omega, alpha)
    torque = _add(torque, _add(arm_torque, _cross(lever, force)))
    return force, _add(arm_torque, _cross(centre, force)), torque


@numba.njit(cache=True)
def _residual(plant, kin, motion, out):
    """Fill `out` (6,) with the exact equations of motion; return force and moment at the mount.

    Force rows are in the world frame, moment rows along the hinge axes (Thesis eq. B-2, B-3 with
    the slides outermost). The springs hold all weight at rest.
    """
    p, _, rest_wrench = plant
    q, v, a = motion
    turning = _turning(motion)
    force, moment, torque = _wrench(plant, kin, turning)
    hinge_torque = _transposed_times(turning.axes, torque)
    pushed = _times(turning.rotation, force)
    for i in range(3):
        out[i] = p[0] * a[i] + pushed[i] - rest_wrench[i] + p[10 + i] * v[i] + p[16 + i] * q[i]
        out[3 + i] = hinge_torque[i] - rest_wrench[3 + i]
        out[3 + i] += p[13 + i] * v[3 + i] + p[19 + i] * q[3 + i]
    return force, moment


@numba.njit(cache=True)
def _store_column(turning, changes, columns, j):
    """Fill column j (12,): equations, then force and moment, by changes of the wrench."""
    force, moment, torque = changes
    pushed = _times(turning.rotation, force)
    hinge_torque = _transposed_times(turning.axes, torque)
    for i in range(3):
        columns[i, j], columns[3 + i, j] = pushed[i], hinge_torque[i]
        columns[6 + i, j], columns[9 + i, j] = force[i], moment[i]


@numba.njit(cache=True)
def _by_motion(plant, kin, motion, columns):
    """Fill (12, 18): derivatives of equations and wrench (six each) by q, v and a."""
    p, still = plant.p, (0.0, 0.0, 0.0)
    turning = _turning(motion)
    columns[:, :6] = 0.0
    columns[:, 6:9] = 0.0
    for i in range(3):
        change = _wrench_change(plant, kin, turning, still, still, turning.rotation[i])
        _store_column(turning, change, columns, 12 + i)
        columns[i, 12 + i] += p[0]
    _by_hinges(plant, kin, motion, turning, columns)
    for i in range(6):
        columns[i, i] += p[16 + i]
        columns[i, 6 + i] += p[10 + i]


@numba.njit(cache=True)
def _by_hinges(plant, kin, motion, turning, columns):
    """Fill the columns by the hinges' angles, rates and accelerations, but for their springs.

    In the base frame all that lies outside of hinge k turns against it, by x axis_k: the world,
    and the shares of omega and alpha of the hinges before k, here called outer.
    """
    still = (0.0, 0.0, 0.0)
    force, _, torque = _wrench(plant, kin, turning)
    outer_omega, outer_alpha = still, still
    for k in range(3):
        rate, acceleration = motion.v[3 + k], motion.a[3 + k]
        axis = (turning.axes[0][k], turning.axes[1][k], turning.axes[2][k])
        axis_rate = _cross(axis, _add(turning.omega, _scale(-1.0, outer_omega)))
        omega = _cross(outer_omega, axis)
        alpha = _add(_cross(outer_alpha, axis), _cross(outer_omega, axis_rate))
        specific = _cross(turning.specific, axis)
        by_angle = _wrench_change(plant, kin, turning, omega, alpha, specific)
        by_rate = _wrench_change(plant, kin, turning, axis, _add(axis_rate, omega), still)
        by_acceleration = _wrench_change(plant, kin, turning, still, axis, still)
        _store_column(turning, by_angle, columns, 3 + k)
        _store_column(turning, by_rate, columns, 9 + k)
        _store_column(turning, by_acceleration, columns, 15 + k)
        # The rows are turned by angle k too: the force's all, the torque's those of outer hinges.
        pushed = _times(turning.rotation, _cross(axis, force))
        hinge_torque = _transposed_times(turning.axes, _cross(axis, torque))
        for i in range(3):
            columns[i, 3 + k] += pushed[i]
        for i in range(k):
            columns[3 + i, 3 + k] += hinge_torque[i]
        outer_omega = _add(outer_omega, _scale(rate, axis))
        outer_alpha = _add(outer_alpha, _scale(acceleration, axis))
        outer_alpha = _add(outer_alpha, _scale(rate, axis_rate))


@numba.njit(cache=True)
def _by_parameters(plant, kin, motion, columns):
    """Fill (12, 22): derivatives of equations and wrench by the parameters at fixed motion."""
    q, v, a = motion
    turning = _turning(motion)
    columns[:, :] = 0.0
    _by_inertia(turning, columns)
    _by_lever(plant, kin, turning, columns)
    for i in range(3):
        columns[i, 0] = a[i]
    for i in range(6):
        columns[i, 10 + i] = v[i]
        columns[i, 16 + i] = q[i]


@numba.njit(cache=True)
def _by_lever(plant, kin, turning, columns):
    """Fill columns 7 to 9: the arm moves with its mount."""
    _, _, omega, alpha, _ = turning
    force, _, _ = _wrench(plant, kin, turning)
    lever = _lever(plant, kin)
    for j in range(3):
        shift = _UNITS[j]
        acceleration = _add(_cross(alpha, shift), _cross(omega, _cross(omega, shift)))
        pull = _scale(plant.arm_mass, acceleration)
        torque = _add(_cross(shift, force), _cross(lever, pull))
        _store_column(turning, (pull, _cross(kin[1], pull), torque), columns, 7 + j)
    # The weight at rest turns with the lever: rest_wrench holds r2 x F0.
    columns[3, 8] -= plant.arm_mass * GRAVITY
    columns[4, 7] += plant.arm_mass * GRAVITY


@numba.njit(cache=True)
def _by_inertia(turning, columns):
    """Fill columns 1 to 6: the base's own torque is linear in the elements of its inertia."""
    (x, y, z), alpha = turning.omega, turning.alpha
    torques = (
        (alpha[0], x * z, -x * y),
        (-y * z, alpha[1], x * y),
        (y * z, -x * z, alpha[2]),
        (alpha[2] + x * y, z * z - x * x, alpha[0] - y * z),
        (y * y - z * z, alpha[2] - x * y, alpha[1] + x * z),
        (alpha[1] - x * z, alpha[0] + y * z, x * x - y * y),
    )
    for j in range(6):
        hinge_torque = _transposed_times(turning.axes, torques[j])
        for i in range(3):
            columns[3 + i, 1 + j] = hinge_torque[i]


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
def _factorise(matrix):
    """Overwrite the matrix with its factors L U; Radau's stage matrix has positive pivots.

    L's diagonal of ones is left out, U's holds the reciprocals.
    """
    n = matrix.shape[0]
    for k in range(n):
        matrix[k, k] = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            if matrix[i, k] != 0.0:
                factor = matrix[i, k] * matrix[k, k]
                matrix[i, k] = factor
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]


@numba.njit(cache=True)
def _solve(factors, right):
    """Overwrite right (n, m) with the solution of L U x = right."""
    n, m = right.shape
    for k in range(n):
        for i in range(k + 1, n):
            for j in range(m):
                right[i, j] -= factors[i, k] * right[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(m):
            right[k, j] *= factors[k, k]
        for i in range(k):
            for j in range(m):
                right[i, j] -= factors[i, k] * right[k, j]


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
def _newton(h, plant, kins, factors, state, stage, work):
    """Solve for the stage accelerations; the linearised matrix is close, so two steps do."""
    position, velocity = np.empty(6), np.empty(6)
    for _ in range(2):
        for i in range(STAGES):
            _stage_motion(h, i, state.position, state.velocity, stage, position, velocity)
            motion = _Motion(position, velocity, stage[i])
            _residual(plant, kins[i], motion, work[6 * i :])
        _solve(factors, work.reshape(6 * STAGES, 1))
        stage -= work.reshape(STAGES, 6)


@numba.njit(cache=True)
def _sensitivity_step(h, factors, motion_columns, parameter_columns, s_q, s_v):
    """Advance s_q, s_v (6, 22) by one step, and return the last stage's sensitivity (6, 22)."""
    right = np.empty((6 * STAGES, 22))
    for i in range(STAGES):
        for r in range(6):
            row = right[6 * i + r]
            for j in range(22):
                row[j] = -parameter_columns[i, r, j]
            for k in range(6):
                by_position = motion_columns[i, r, k]
                by_rate = motion_columns[i, r, 6 + k] + h * _NODES[i] * by_position
                if by_rate != 0.0:
                    for j in range(22):
                        row[j] -= by_position * s_q[k, j] + by_rate * s_v[k, j]
    _solve(factors, right)
    stages = right.reshape(STAGES, 6 * 22)
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
                _by_motion(plant, kins[i], motion, motion_columns[i])
            _stage_matrix(h, motion_columns, matrix)
            _factorise(matrix)
            _newton(h, plant, kins, matrix, state, stage, work)
            if with_sensitivities:
                for i in range(STAGES):
                    _stage_motion(h, i, q, v, stage, position, velocity)
                    motion = _Motion(position, velocity, stage[i])
                    _by_parameters(plant, kins[i], motion, parameter_columns[i])
                s_a = _sensitivity_step(h, matrix, motion_columns, parameter_columns, s_q, s_v)
            _stage_motion(h, STAGES - 1, q, v, stage, position, velocity)
            q[:], v[:] = position, velocity
        motion = _Motion(q, v, stage[-1])
        _store(motion, _residual(plant, kins[-1], motion, work), rest, outputs[n])
        if with_sensitivities:
            _store_sensitivity(
                s_q, s_v, s_a, motion_columns[-1], parameter_columns[-1], derivatives[n]
            )
