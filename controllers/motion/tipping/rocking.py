"""A rover that may leave the ground with some of its wheels: a reduced model, for many copies.

The arm moves and the wheels turn as planned. What moves by itself is the base, on its springs and
on its tyres: it drives, slides, turns, heaves, pitches and rolls about the lines where its tyres
meet the ground, and the rear half turns about the centre joint. A spring pushes and never pulls:
where it would, the wheel is off the ground. Each tyre holds its place, or gives way in any
direction once it has to hold more than its load times its friction. So loads and friction say how
far a rover turns whose wheels scrub, and whether a half that leans rolls about the joint above the
ground: it takes tyres to the side with it, or turns the whole rover.

Left out are tyres that sink, ground that is not plane, and squares of the base's own rates but for
those of a curve.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false

from typing import Any, NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY

STEP = 0.0025
"""Time step [s]: a thirtieth of the fastest swing's period."""
_SETTLING = 400  # Steps at first in which it comes to rest, with critical damping.
_STOP = 300.0  # Stiffness of the centre joint's stops [N m/rad].
_TYRE = 6e4  # Stiffness of a tyre along the ground [N/m].
_GIVING = 60.0  # Damping of a tyre along the ground [N s/m].
_OVER = 1.0  # Pitch or roll from which on a copy lies on its side, and stays so [rad].
_SIZE = 7  # Degrees of freedom: aside, ahead, up, pitch, roll, heading and centre joint.


class Chassis(NamedTuple):
    """What all copies share.

    Attributes:
        wheels: (4, 2) x and y of the wheels [m], front left, front right, rear left, rear right.
        pressed: (4,) how far their springs are pressed in at the drawn height [m].
        height: Height of the centre joint above the ground [m].
        range: How far that turns to either side [rad]; 0 for one that is locked.
    """

    wheels: FloatArray
    pressed: FloatArray
    height: float
    range: float


class Copies(NamedTuple):
    """Rovers that differ.

    Attributes:
        ups: (n, 3) against gravity, in the frame of the front half at rest at the beginning.
        masses: (n,) of the rover without its arm [kg].
        moments: (n, 3) its first moment of mass about the point of the ground under its origin
            [kg m].
        inertias: (n, 3) its moments of inertia about that point's axes [kg m^2].
        arms: (n,) share of the arm's mass that is there.
        loads: (n,) masses in the gripper [kg].
        springs: (n, 4) stiffness of the wheels' springs [N/m].
        dampers: (n, 4) their damping [N s/m].
        grips: (n,) Coulomb coefficient of the tyres.
    """

    ups: FloatArray
    masses: FloatArray
    moments: FloatArray
    inertias: FloatArray
    arms: FloatArray
    loads: FloatArray
    springs: FloatArray
    dampers: FloatArray
    grips: FloatArray


class Moving(NamedTuple):
    """What is planned, at equal times; about the point of the ground under the rover's origin.

    Attributes:
        arm: (times, 34) of the arm: mass, first moment (3), inertia xx, yy, zz, xy, xz, yz, the
            wrench (6) that its motion asks for without gravity, and how that grows with the rates
            of pitch (6), roll (6) and heading (6).
        load: (times, 34) likewise of 1 kg in the gripper.
        rims: (times, 2) speed of the rims of the left and of the right tyres [m/s].
        speed: Forward speed of the rover at the beginning [m/s].
        turn: Its turning rate to the left [rad/s].
        period: Time between two of them [s].
    """

    arm: FloatArray
    load: FloatArray
    rims: FloatArray
    speed: float
    turn: float
    period: float


def rock(chassis: Chassis, copies: Copies, moving: Moving) -> tuple[FloatArray, FloatArray]:
    """Let all copies do what is planned.

    Args:
        chassis: What they share.
        copies: In what they differ.
        moving: The plan.

    Returns:
        (n, times, 5) heave [m], pitch, roll, heading and the centre joint's angle [rad], from a
        body that stands straight on the ground, and (n, times, 3) the ground's force on all tyres,
        aside, ahead and up [N].
    """
    count, times = len(copies.masses), len(moving.rims)
    places, forces = np.empty((count, times, 5)), np.empty((count, times, 3))
    _rock(chassis, copies, moving, places, forces)
    return places, forces


@numba.njit(cache=True, parallel=True)
def _rock(chassis: Any, copies: Any, moving: Any, places: Any, forces: Any) -> None:
    steps = round(moving.period / STEP)
    for row in numba.prange(len(copies.masses)):
        # Numba compiles `_advance` anew for each type: an unsigned index, a constant -1.
        k, settle = np.int64(row), np.int64(-1)
        # The first two places are not kept: the ground is alike everywhere.
        state, rates, given = np.zeros(_SIZE), np.zeros(_SIZE), np.zeros((4, 2))
        for _ in range(_SETTLING):
            ground = _turned(state, copies.ups[k], 1.0)
            _advance(chassis, copies, k, moving, settle, ground, state, rates, given)
        # Gravity was known in the front half's frame: now it is in the ground's.
        ground = _turned(state, copies.ups[k], 1.0)
        state[5], rates[1], rates[5] = 0.0, moving.speed, moving.turn
        for i in range(len(moving.rims)):
            if max(abs(state[3]), abs(state[4])) > _OVER:
                places[k, i:], forces[k, i:] = state[2:], 0.0
                break
            c, s = np.cos(state[5]), np.sin(state[5])
            force = np.zeros(3)
            up = np.array([c * ground[0] + s * ground[1], c * ground[1] - s * ground[0], ground[2]])
            for _ in range(steps):
                force = _advance(chassis, copies, k, moving, i, up, state, rates, given)
            places[k, i], forces[k, i] = state[2:], force


@numba.njit(cache=True)
def _turned(state: Any, vector: Any, sense: float) -> Any:
    """Return a vector turned from the front half's frame to the ground's, or back."""
    a, b = state[3] * sense, state[4] * sense
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    x, y, z = vector
    if sense > 0.0:
        x, z = cb * x + sb * z, cb * z - sb * x
        return np.array([x, ca * y - sa * z, sa * y + ca * z])
    y, z = ca * y - sa * z, sa * y + ca * z
    return np.array([cb * x + sb * z, y, cb * z - sb * x])


@numba.njit(cache=True)
def _advance(
    chassis: Any, copies: Any, k: Any, moving: Any, i: Any, up: Any, state: Any, rates: Any,
    given: Any,
) -> Any:  # fmt: skip
    """Advance copy k by a step at time i of the plan, -1 to settle; return the ground's force."""
    settling, i = i < 0, max(i, 0)
    arm = copies.arms[k] * moving.arm[i] + copies.loads[k] * moving.load[i]
    base, height = copies.masses[k], chassis.height
    moved = np.zeros(6)
    if not settling:
        moved = arm[10:16] + rates[3] * arm[16:22] + rates[4] * arm[22:28] + rates[5] * arm[28:34]
    curve = np.array([-rates[5] * rates[1], rates[5] * rates[0], 0.0])
    pull = GRAVITY * up + curve
    moment = copies.moments[k] + arm[1:4]
    # The rear half is half of the base; it turns about the joint beside what all do.
    rear_x, rear_z = 0.5 * copies.moments[k, 0], 0.5 * copies.moments[k, 2] - 0.5 * base * height
    matrix = _inertia(copies, k, arm, height)
    push = np.empty(_SIZE)
    push[:3] = -(base + arm[0]) * pull - moved[:3]
    push[5] = moment[1] * pull[0] - moment[0] * pull[1] - moved[5]
    pull = _turned(state, pull, -1.0)
    push[3] = moment[2] * pull[1] - moment[1] * pull[2] - moved[3]
    push[4] = moment[0] * pull[2] - moment[2] * pull[0] - moved[4]
    push[6] = rear_x * pull[2] - rear_z * pull[0]
    total = np.zeros(3)
    for wheel in range(4):
        x, y = chassis.wheels[wheel]
        rear = wheel // 2
        # As a half turns about the joint, its tyres go aside and down below it.
        across = x - rear * height * state[6]
        about = -rear * (x - height * (state[4] + state[6]))
        spring, damper = copies.springs[k, wheel], copies.dampers[k, wheel]
        if settling:
            damper = 2.0 * np.sqrt(0.25 * spring * matrix[0, 0])
        pressed = chassis.pressed[wheel] - state[2] - state[3] * y + state[4] * x
        pressed += rear * state[6] * (x - height * (state[4] + 0.5 * state[6]))
        rising = rates[2] + rates[3] * y - rates[4] * across + rates[6] * about
        normal = max(0.0, spring * pressed - damper * rising) if pressed > 0.0 else 0.0
        push[2] += normal
        push[3] += normal * y
        push[4] -= normal * across
        push[6] += normal * about
        aside = rates[0] - rates[5] * y - rear * height * rates[6]
        ahead = rates[1] + rates[5] * x - (0.0 if settling else moving.rims[i, wheel % 2])
        fx, fy = _hold(given[wheel], aside, ahead, copies.grips[k] * normal)
        push[0] += fx
        push[1] += fy
        push[5] += x * fy - y * fx
        push[6] -= rear * height * fx
        total += np.array([fx, fy, normal])
    push[6] -= _STOP * np.sign(state[6]) * max(0.0, abs(state[6]) - chassis.range)
    _solve(matrix, push)
    for row in range(_SIZE):
        rates[row] += STEP * push[row]
        state[row] += STEP * rates[row]
    return total


@numba.njit(cache=True)
def _hold(given: Any, aside: float, ahead: float, most: float) -> Any:
    """Return the force of a tyre (2,) against its slip, and write how far it has given way."""
    given[0] += STEP * aside
    given[1] += STEP * ahead
    fx, fy = -_TYRE * given[0] - _GIVING * aside, -_TYRE * given[1] - _GIVING * ahead
    asked = np.hypot(fx, fy)
    if asked > most:
        fx, fy = fx * most / asked, fy * most / asked
        given[0], given[1] = -fx / _TYRE, -fy / _TYRE
    return fx, fy


@numba.njit(cache=True)
def _inertia(copies: Any, k: int, arm: Any, height: float) -> Any:
    """Return the mass matrix (7, 7)."""
    base, moment, spin = copies.masses[k], copies.moments[k], copies.inertias[k]
    x, y, z = moment + arm[1:4]
    matrix = np.zeros((_SIZE, _SIZE))
    matrix[0, 0] = matrix[1, 1] = matrix[2, 2] = base + arm[0]
    matrix[0, 4], matrix[0, 5], matrix[1, 3] = z, -y, -z
    matrix[1, 5], matrix[2, 3], matrix[2, 4] = x, y, -x
    matrix[3, 3], matrix[4, 4], matrix[5, 5] = spin[0] + arm[4], spin[1] + arm[5], spin[2] + arm[6]
    matrix[3, 4], matrix[3, 5], matrix[4, 5] = arm[7], arm[8], arm[9]
    matrix[0, 6] = 0.5 * (moment[2] - base * height)
    matrix[2, 6] = -0.5 * moment[0]
    matrix[4, 6] = 0.5 * (spin[1] - height * moment[2])
    matrix[6, 6] = 0.5 * (spin[1] - 2.0 * height * moment[2] + base * height**2)
    for row in range(_SIZE):
        for column in range(row):
            matrix[row, column] = matrix[column, row]
    return matrix


@numba.njit(cache=True)
def _solve(matrix: Any, right: Any) -> None:
    """Write the solution over the right side (n,); the matrix is symmetric and positive definite.

    By hand: a call of LAPACK takes ten times as long.
    """
    size = len(right)
    for pivot in range(size):
        for row in range(pivot + 1, size):
            share = matrix[row, pivot] / matrix[pivot, pivot]
            for column in range(pivot, size):
                matrix[row, column] -= share * matrix[pivot, column]
            right[row] -= share * right[pivot]
    for row in range(size - 1, -1, -1):
        for column in range(row + 1, size):
            right[row] -= matrix[row, column] * right[column]
        right[row] /= matrix[row, row]
