"""Newton-Euler equations of an arm on a base on a compliance, compiled (Thesis appendix B.1).

Vectors are tuples of three numbers and matrices tuples of three rows: numba keeps them in
registers, where small arrays would cost an allocation each. `p` is always the parameter vector
(22,) in the order of `parameters.NAMES`; all vectors are in the base frame unless said.
"""

from __future__ import annotations

import numba
import numpy as np

GRAVITY = 9.81
WEIGHT_DIRECTION = (0.0, 0.0, -GRAVITY)


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


@numba.njit(cache=True, inline="always")
def _column(m, j):
    return (m[0][j], m[1][j], m[2][j])


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
def arm_kinematics(inertia, centre, axis, angle, rate, acceleration):
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


@numba.njit(cache=True, inline="always")
def _base_inertia(p):
    return ((p[1], p[6], p[4]), (p[6], p[2], p[5]), (p[4], p[5], p[3]))


@numba.njit(cache=True, inline="always")
def _lever(p, kin):
    return (p[7] + kin[1][0], p[8] + kin[1][1], p[9] + kin[1][2])


@numba.njit(cache=True)
def residual(p, arm_mass, kin, rest_wrench, q, v, a, out):
    """Fill `out` (6,) with the exact equations of motion; return force and moment at the mount.

    Force rows are in the world frame, moment rows along the hinge axes (Thesis eq. B-2, B-3 with
    the slides outermost). The springs hold all weight at rest.
    """
    arm_inertia, centre, centre_rate, centre_acceleration, spin, spin_rate = kin
    rates = (v[3], v[4], v[5])
    rotation, rate_matrix, rate_bias = _hinges(q[3], q[4], q[5], rates)
    omega = _times(rate_matrix, rates)
    alpha = _add(_times(rate_matrix, (a[3], a[4], a[5])), rate_bias)
    lever = _lever(p, kin)
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
    base = _base_inertia(p)
    torque = _add(_times(base, alpha), _cross(omega, _times(base, omega)))
    torque = _add(torque, _add(turning, _cross(lever, force)))
    hinge_torque = _transposed_times(rate_matrix, torque)
    pushed = _times(rotation, force)
    for i in range(3):
        out[i] = p[0] * a[i] + pushed[i] - rest_wrench[i] + p[10 + i] * v[i] + p[16 + i] * q[i]
        out[3 + i] = hinge_torque[i] - rest_wrench[3 + i]
        out[3 + i] += p[13 + i] * v[3 + i] + p[19 + i] * q[3 + i]
    return force, moment


@numba.njit(cache=True, inline="always")
def _linear_wrench(arm_mass, kin, lever, tilt, rate, alpha, acceleration):
    """First-order force, and moment about the mount, of small base motions."""
    arm_inertia, centre, centre_rate, _, spin, _ = kin
    force = _add(acceleration, _cross(alpha, lever))
    force = _add(force, _scale(2.0, _cross(rate, centre_rate)))
    force = _scale(arm_mass, _add(force, _cross(tilt, WEIGHT_DIRECTION)))
    turning = _add(_times(arm_inertia, _add(alpha, _cross(rate, spin))), (0.0, 0.0, 0.0))
    turning = _add(turning, _cross(rate, _times(arm_inertia, spin)))
    turning = _add(turning, _cross(spin, _times(arm_inertia, rate)))
    return force, _add(turning, _cross(centre, force))


@numba.njit(cache=True)
def linear_matrices(p, arm_mass, kin, mass, damping, stiffness):
    """Fill the mass, damping (gyroscopic too) and stiffness (gravity too) matrices about rest."""
    lever, zero = _lever(p, kin), (0.0, 0.0, 0.0)
    mount = (p[7], p[8], p[9])
    base = _base_inertia(p)
    for j in range(3):
        unit = (1.0 * (j == 0), 1.0 * (j == 1), 1.0 * (j == 2))
        pushed, turned = _linear_wrench(arm_mass, kin, lever, zero, zero, zero, unit)
        _store(mass, j, pushed, turned, mount)
        pushed, turned = _linear_wrench(arm_mass, kin, lever, zero, zero, unit, zero)
        _store(mass, 3 + j, pushed, _add(turned, _column(base, j)), mount)
        pushed, turned = _linear_wrench(arm_mass, kin, lever, zero, unit, zero, zero)
        _store(damping, 3 + j, pushed, turned, mount)
        pushed, turned = _linear_wrench(arm_mass, kin, lever, unit, zero, zero, zero)
        _store(stiffness, 3 + j, zero, _add(turned, _cross(mount, pushed)), zero)
        _store(damping, j, zero, zero, zero)
        _store(stiffness, j, zero, zero, zero)
    for i in range(3):
        mass[i, i] += p[0]
    for i in range(6):
        damping[i, i] += p[10 + i]
        stiffness[i, i] += p[16 + i]


@numba.njit(cache=True, inline="always")
def _store(matrix, column, force, moment, mount):
    """Write a wrench at the mount as a column of generalised forces at the base's c.g."""
    torque = _add(moment, _cross(mount, force))
    for i in range(3):
        matrix[i, column] = force[i]
        matrix[3 + i, column] = torque[i]


@numba.njit(cache=True)
def parameter_force(p, arm_mass, kin, force, q, v, a, columns):
    """Fill (6, 22): the equations' derivative by the parameters at fixed motion."""
    columns[:, :] = 0.0
    lever = _lever(p, kin)
    ax, ay, az = a[3], a[4], a[5]
    columns[3, 1], columns[4, 2], columns[5, 3] = ax, ay, az
    columns[3, 4], columns[5, 4] = az, ax
    columns[4, 5], columns[5, 5] = az, ay
    columns[3, 6], columns[4, 6] = ay, ax
    deviation = (force[0], force[1], force[2] - arm_mass * GRAVITY)
    for j in range(3):
        unit = (1.0 * (j == 0), 1.0 * (j == 1), 1.0 * (j == 2))
        push = _scale(arm_mass, _cross((ax, ay, az), unit))
        torque = _add(_cross(unit, deviation), _cross(lever, push))
        columns[j, 0] = a[j]
        for i in range(3):
            columns[i, 7 + j] = push[i]
            columns[3 + i, 7 + j] = torque[i]
    for i in range(6):
        columns[i, 10 + i] = v[i]
        columns[i, 16 + i] = q[i]


@numba.njit(cache=True)
def output_sensitivity(p, arm_mass, kin, s_q, s_v, s_a, a, rows):
    """Fill (24, 22): derivatives of one output sample by the parameters."""
    lever = _lever(p, kin)
    for k in range(22):
        for i in range(3):
            rows[i, k], rows[3 + i, k], rows[6 + i, k] = s_q[i, k], s_v[i, k], s_a[i, k]
            rows[9 + i, k], rows[12 + i, k] = s_q[3 + i, k], s_v[3 + i, k]
            rows[15 + i, k] = s_a[3 + i, k]
        acceleration = (s_a[0, k], s_a[1, k], s_a[2, k])
        if 7 <= k < 10:
            unit = (1.0 * (k == 7), 1.0 * (k == 8), 1.0 * (k == 9))
            acceleration = _add(acceleration, _cross((a[3], a[4], a[5]), unit))
        force, moment = _linear_wrench(
            arm_mass,
            kin,
            lever,
            (s_q[3, k], s_q[4, k], s_q[5, k]),
            (s_v[3, k], s_v[4, k], s_v[5, k]),
            (s_a[3, k], s_a[4, k], s_a[5, k]),
            acceleration,
        )
        for i in range(3):
            rows[18 + i, k], rows[21 + i, k] = force[i], moment[i]
