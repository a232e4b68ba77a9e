"""A rover that may leave the ground with some of its wheels: a reduced model, for many copies.

The arm moves and the wheels drive and turn as planned. What moves by itself is the base on its
springs: it heaves, pitches and rolls about the lines where its tyres meet the ground, and the rear
half turns about the centre joint. A spring pushes and never pulls: where it would, the wheel is off
the ground. The tyres' friction to the side holds the halves against each other, as the joint lies
above the ground; while the rover turns it pushes them apart.

Left out are tyres that sink, ground that is not plane, and squares of the base's own rates.
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
_STUCK = 300.0  # Stiffness of the halves against each other, while their tyres hold [N m/rad].
_TURN_SHARE = 0.5  # Turns over those of rolling wheels; as drawn 0.56, and less on slopes.


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
        turns: (n,) share of a planned turn that comes about where friction allows it.
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
    turns: FloatArray


class Moving(NamedTuple):
    """What is planned, at equal times; about the point of the ground under the rover's origin.

    Attributes:
        arm: (times, 28) of the arm: mass, first moment (3), inertia xx, yy, zz, xy, xz, yz, the
            wrench (6) that its motion asks for without gravity, and how that grows with the rates
            of pitch (6) and roll (6).
        load: (times, 28) likewise of 1 kg in the gripper.
        ahead: (times,) acceleration of the rover [m/s^2].
        headings: (times,) how far it has turned to the left [rad].
        scrubs: (times,) 1 where tyres slide as it turns to the left, -1 to the right, else 0.
        period: Time between two of them [s].
    """

    arm: FloatArray
    load: FloatArray
    ahead: FloatArray
    headings: FloatArray
    scrubs: FloatArray
    period: float


def rock(chassis: Chassis, copies: Copies, moving: Moving) -> tuple[FloatArray, FloatArray]:
    """Let all copies do what is planned.

    Args:
        chassis: What they share.
        copies: In what they differ.
        moving: The plan.

    Returns:
        (n, times, 4) heave [m], pitch, roll and the centre joint's angle [rad], from a body that
        stands straight on the ground, and (n, times, 3) the ground's force [N] in the front half's
        frame.
    """
    count, times = len(copies.masses), len(moving.ahead)
    places, forces = np.empty((count, times, 4)), np.empty((count, times, 3))
    _rock(chassis, copies, moving, places, forces)
    return places, forces


@numba.njit(cache=True, parallel=True)
def _rock(chassis: Any, copies: Any, moving: Any, places: Any, forces: Any) -> None:
    steps = round(moving.period / STEP)
    for row in numba.prange(len(copies.masses)):
        # Numba compiles `_advance` anew for each type: an unsigned index, a constant -1.
        k, settle = np.int64(row), np.int64(-1)
        # Heave, pitch, roll and centre joint, and where the halves are held against each other.
        state, rates, held = np.zeros(4), np.zeros(4), np.zeros(1)
        for _ in range(_SETTLING):
            _advance(chassis, copies, k, moving, settle, copies.ups[k], 0.0, state, rates, held)
        # Gravity was known in the front half's frame: now it is in the ground's.
        ground = _turned(state, copies.ups[k], 1.0)
        turning, aside = _scrubbing(ground, copies.grips[k], copies.turns[k], chassis.wheels)
        for i in range(len(moving.ahead)):
            heading = turning * moving.headings[i]
            c, s = np.cos(heading), np.sin(heading)
            force = np.zeros(3)
            up = np.array([c * ground[0] + s * ground[1], c * ground[1] - s * ground[0], ground[2]])
            for _ in range(steps):
                here = _turned(state, up, -1.0)
                force = _advance(chassis, copies, k, moving, i, here, aside, state, rates, held)
            places[k, i], forces[k, i] = state, force


@numba.njit(cache=True)
def _scrubbing(ground: Any, grip: float, share: float, wheels: Any) -> Any:
    """Return how much of a planned turn comes about, and the share of friction to the side then.

    What a slope takes of the friction is missing to turn. Tyres slide to the side as the rover
    turns, and ahead or back as its wheels turn faster than that needs.
    """
    needed = np.hypot(ground[0], ground[1]) / ground[2] / (_TURN_SHARE * grip)
    turning = share * np.sqrt(max(0.0, 1.0 - needed**2))
    x, y = abs(wheels[0, 0]), abs(wheels[0, 1])
    return turning, y * turning / np.hypot(y * turning, x * (1.0 / _TURN_SHARE - turning))


@numba.njit(cache=True)
def _turned(state: Any, vector: Any, sense: float) -> Any:
    """Return a vector turned from the front half's frame to the ground's, or back."""
    a, b = state[1] * sense, state[2] * sense
    ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
    x, y, z = vector
    if sense > 0.0:
        x, z = cb * x + sb * z, cb * z - sb * x
        return np.array([x, ca * y - sa * z, sa * y + ca * z])
    y, z = ca * y - sa * z, sa * y + ca * z
    return np.array([cb * x + sb * z, y, cb * z - sb * x])


@numba.njit(cache=True)
def _advance(
    chassis: Any, copies: Any, k: Any, moving: Any, i: Any, up: Any, aside: float,
    state: Any, rates: Any, held: Any,
) -> Any:  # fmt: skip
    """Advance copy k by a step at time i of the plan, -1 to settle; return the ground's force."""
    settling, i = i < 0, max(i, 0)
    arm = copies.arms[k] * moving.arm[i] + copies.loads[k] * moving.load[i]
    base, height = copies.masses[k], chassis.height
    pull, moved = GRAVITY * up, np.zeros(6)
    if not settling:
        pull = pull + np.array([0.0, moving.ahead[i], 0.0])
        moved = arm[10:16] + rates[1] * arm[16:22] + rates[2] * arm[22:28]
    force = (base + arm[0]) * pull + moved[:3]
    moment = copies.moments[k] + arm[1:4]
    # The rear half is half of the base; it turns about the joint beside what all do.
    rear_x, rear_z = 0.5 * copies.moments[k, 0], 0.5 * copies.moments[k, 2]
    matrix = _inertia(copies, k, arm, height)
    push = np.empty(4)
    push[0] = -force[2]
    push[1] = moment[2] * pull[1] - moment[1] * pull[2] - moved[3]
    push[2] = moment[0] * pull[2] - moment[2] * pull[0] - moved[4]
    push[3] = rear_x * pull[2] - (rear_z - 0.5 * base * height) * pull[0]
    borne = np.zeros(2)
    for wheel in range(4):
        x, y = chassis.wheels[wheel]
        rear = wheel // 2
        spring, damper = copies.springs[k, wheel], copies.dampers[k, wheel]
        if settling:
            damper = 2.0 * np.sqrt(0.25 * spring * matrix[0, 0])
        pressed = chassis.pressed[wheel]
        pressed -= state[0] + state[1] * y - (state[2] + rear * state[3]) * x
        rising = rates[0] + rates[1] * y - (rates[2] + rear * rates[3]) * x
        if pressed <= 0.0:
            continue
        normal = max(0.0, spring * pressed - damper * rising)
        push[0] += normal
        push[1] += normal * y
        push[2] -= normal * x
        push[3] -= normal * x * rear
        borne[rear] += normal
    # The joint moves to the side where only one half rolls, and tyres with it.
    most, apart = copies.grips[k] * min(borne[0], borne[1]) * height, state[3]
    # What else takes of their friction, weight on a slope and the arm's swing, holds nothing.
    radius = np.hypot(chassis.wheels[0, 0], chassis.wheels[0, 1])
    taken = np.hypot(np.hypot(force[0], force[1]), moved[5] / radius)
    taken /= copies.grips[k] * max(borne[0] + borne[1], 1e-9)
    most *= np.sqrt(max(0.0, 1.0 - taken**2))
    if not settling and moving.scrubs[i] != 0.0:
        held[0] = apart + aside * moving.scrubs[i] * most / _STUCK
    held[0] = min(max(held[0], apart - most / _STUCK), apart + most / _STUCK)
    push[3] -= _STUCK * (apart - held[0])
    push[3] -= _STUCK * np.sign(apart) * max(0.0, abs(apart) - chassis.range)
    _solve(matrix, push)
    for row in range(4):
        rates[row] += STEP * push[row]
        state[row] += STEP * rates[row]
    return force


@numba.njit(cache=True)
def _inertia(copies: Any, k: int, arm: Any, height: float) -> Any:
    """Return the mass matrix (4, 4)."""
    base, moment, spin = copies.masses[k], copies.moments[k], copies.inertias[k]
    matrix = np.zeros((4, 4))
    matrix[0, 0] = base + arm[0]
    matrix[0, 1], matrix[0, 2] = moment[1] + arm[2], -moment[0] - arm[1]
    matrix[0, 3] = -0.5 * moment[0]
    matrix[1, 1], matrix[1, 2] = spin[0] + arm[4], arm[7]
    matrix[2, 2] = spin[1] + arm[5]
    matrix[2, 3] = 0.5 * (spin[1] - height * moment[2])
    matrix[3, 3] = 0.5 * (spin[1] - 2.0 * height * moment[2] + base * height**2)
    for row in range(4):
        for column in range(row):
            matrix[row, column] = matrix[column, row]
    return matrix


@numba.njit(cache=True)
def _solve(matrix: Any, right: Any) -> None:
    """Write the solution over the right side (4,); the matrix is symmetric and positive definite.

    By hand: a call of LAPACK takes ten times as long.
    """
    for pivot in range(4):
        for row in range(pivot + 1, 4):
            share = matrix[row, pivot] / matrix[pivot, pivot]
            for column in range(pivot, 4):
                matrix[row, column] -= share * matrix[pivot, column]
            right[row] -= share * right[pivot]
    for row in range(3, -1, -1):
        for column in range(row + 1, 4):
            right[row] -= matrix[row, column] * right[column]
        right[row] /= matrix[row, row]
