"""Newton-Euler equations of an arm on a base on a compliance, compiled (Thesis appendix B.1).

Vectors are tuples of three numbers and matrices tuples of three rows: numba keeps them in
registers, where small arrays would cost an allocation each. `p` is always the parameter vector
(22,) in the order of `parameters.NAMES`; all vectors are in the base frame unless said.
"""

from __future__ import annotations

import numba
import numpy as np

from perception.geometry.gravity import GRAVITY


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


@numba.njit(cache=True)
def by_motion(p, arm_mass, kin, rest_wrench, q, v, a, columns, work):
    """Fill (12, 18): derivatives of equations and wrench (six each) by q, v and a.

    Shift and its rate act through their springs and dampers alone. The rest are differences of the
    exact equations, which are linear in a; elsewhere a step of 1e-6 leaves an error of 1e-6, where
    a linearisation about rest would leave 1e-3.
    """
    base, changed = np.empty(12), np.empty(12)
    _stack(p, arm_mass, kin, rest_wrench, q, v, a, base, work)
    columns[:, :] = 0.0
    for i in range(3):
        columns[i, i], columns[i, 6 + i] = p[16 + i], p[10 + i]
    for j in range(6):
        for k in range(2 if j < 3 else 0, 3):
            moving = (q, v, a)[k]
            step = 1.0 if k == 2 else 1e-6
            kept = moving[j]
            moving[j] = kept + step
            _stack(p, arm_mass, kin, rest_wrench, q, v, a, changed, work)
            moving[j] = kept
            for i in range(12):
                columns[i, 6 * k + j] = (changed[i] - base[i]) / step


@numba.njit(cache=True)
def by_parameters(p, arm_mass, kin, rest_wrench, q, v, a, columns, work):
    """Fill (12, 22): derivatives of equations and wrench by the parameters at fixed motion."""
    base, changed = np.empty(12), np.empty(12)
    _stack(p, arm_mass, kin, rest_wrench, q, v, a, base, work)
    columns[:, :] = 0.0
    _by_inertia(q, v, a, columns)
    for j in range(7, 10):
        kept = p[j]
        p[j] = kept + 1e-6
        _stack(p, arm_mass, kin, rest_wrench, q, v, a, changed, work)
        p[j] = kept
        for i in range(12):
            columns[i, j] = (changed[i] - base[i]) / 1e-6
    for i in range(3):
        columns[i, 0] = a[i]
    # The weight at rest turns with the lever: rest_wrench holds r2 x F0.
    columns[3, 8] -= arm_mass * GRAVITY
    columns[4, 7] += arm_mass * GRAVITY
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
def _stack(p, arm_mass, kin, rest_wrench, q, v, a, out, work):
    force, moment = residual(p, arm_mass, kin, rest_wrench, q, v, a, work)
    for i in range(3):
        out[i], out[3 + i] = work[i], work[3 + i]
        out[6 + i], out[9 + i] = force[i], moment[i]
