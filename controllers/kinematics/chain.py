"""Dynamics of a chain of hinges and slides on a moving base, compiled.

The equations of motion of thesis eq. A-2, H(q) q'' + h(q, q') - G = Q - J^T F, evaluated by the
recursion of Newton and Euler: the terms are those of the Lagrangian, without its derivatives of H.
Vectors of a joint are in the frame that it moves.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.kinematics.serial_arm import RigidBody, SerialArm
from perception.geometry.gravity import GRAVITY
from perception.geometry.se3 import cross_matrix

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Joint:
    """A hinge or slide and the body that it moves.

    Attributes:
        body: What it moves, in the frame that it moves.
        offset: (3,) that frame's origin in the frame before, at zero [m].
        rotation: (3, 3) its axes in the frame before, at zero.
        axis: (3,) unit vector of the hinge or slide.
        slides: Whether it slides; if not it turns.
        rotor: Inertia of its motor's rotor at the shaft [kg m^2, or kg for a slide].
    """

    body: RigidBody
    offset: FloatArray
    rotation: FloatArray
    axis: FloatArray
    slides: bool = False
    rotor: float = 0.0


@dataclasses.dataclass(frozen=True)
class FrameState:
    """How the frame before the first joint moves, in its own axes.

    Attributes:
        specific_force: (3,) acceleration of its origin minus that of free fall [m/s^2], as an
            accelerometer there would read.
        angular_velocity: (3,) [rad/s].
        angular_acceleration: (3,) [rad/s^2].
    """

    specific_force: FloatArray
    angular_velocity: FloatArray
    angular_acceleration: FloatArray

    def at(self, place: ArrayLike) -> FrameState:
        """Return the motion of another point of the same rigid body.

        Args:
            place: (3,) from this origin [m].
        """
        lever = np.asarray(place, dtype=float)
        # As a matrix: np.cross takes ten times as long, and this runs many times a tick.
        spin = cross_matrix(self.angular_velocity)
        turning = (cross_matrix(self.angular_acceleration) + spin @ spin) @ lever
        return FrameState(
            self.specific_force + turning, self.angular_velocity, self.angular_acceleration
        )


def at_rest(up: ArrayLike = (0.0, 0.0, 1.0)) -> FrameState:
    """Return a frame at rest.

    Args:
        up: (3,) unit vector that points up, in the frame's axes.
    """
    return FrameState(GRAVITY * np.asarray(up, dtype=float), np.zeros(3), np.zeros(3))


LEVEL = at_rest()
"""A level frame at rest."""


class Chain:
    """A chain of hinges and slides, ready for the compiled recursion."""

    def __init__(self, joints: Sequence[Joint]) -> None:
        """Gather the joints' numbers.

        Args:
            joints: From the base on.

        Raises:
            ValueError: If there is none, or one's axis is not a unit vector, naming it.
        """
        if not joints:
            raise ValueError("a chain without joints: needs one or more")
        for number, joint in enumerate(joints):
            length = np.linalg.norm(joint.axis)
            if not abs(length - 1.0) < 1e-9:
                raise ValueError(f"axis of joint {number}: length {length}, needs a unit vector")
        self.joints = tuple(joints)
        self.rotors = np.array([joint.rotor for joint in joints])
        self._slides = np.array([joint.slides for joint in joints])
        self._axes = np.array([joint.axis for joint in joints], dtype=float)
        self._offsets = np.array([joint.offset for joint in joints], dtype=float)
        self._rotations = np.array([joint.rotation for joint in joints], dtype=float)
        self._masses = np.array([joint.body.mass for joint in joints], dtype=float)
        self._centres = np.array([joint.body.centre for joint in joints], dtype=float)
        self._inertias = np.array([joint.body.inertia for joint in joints], dtype=float)

    @classmethod
    def of_arm(cls, arm: SerialArm, rotor: float = 0.0) -> Chain:
        """Return the chain of an arm's hinges.

        Args:
            arm: The arm; what it carries before its first joint plays no part.
            rotor: Inertia of each motor's rotor, at the joint [kg m^2].
        """
        return cls([Joint(k.body, k.offset, k.rotation, k.axis, rotor=rotor) for k in arm.links])

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    def inverse_dynamics(
        self,
        positions: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        base: FrameState = LEVEL,
        tip: ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return what moves the chain so: joint efforts and the wrench on it at its base.

        Args:
            positions: (n,) [rad or m].
            rates: (n,) [rad/s or m/s].
            accelerations: (n,) [rad/s^2 or m/s^2].
            base: Motion of the frame before the first joint.
            tip: (6,) force [N] and moment about the origin [N m] that the last body exerts on
                the world, in its frame; None for none.

        Returns:
            (n,) generalised efforts [N m or N], and (6,) force and moment about the origin on
            the chain, in the base frame [N, N m].

        Raises:
            ValueError: If a number is missing or not finite.
        """
        state = self._state(positions, rates, accelerations)
        pushed = np.zeros(6) if tip is None else np.asarray(tip, dtype=float)
        motion = np.stack([base.specific_force, base.angular_velocity, base.angular_acceleration])
        efforts, wrench = np.empty(len(self)), np.empty(6)
        _newton_euler(*self._numbers(), state, motion, pushed, efforts, wrench)
        return efforts + self.rotors * state[2], wrench

    def bias(self, positions: ArrayLike, rates: ArrayLike, base: FrameState = LEVEL) -> FloatArray:
        """Return (n,) the efforts of zero accelerations: h(q, q') - G [N m or N]."""
        return self.inverse_dynamics(positions, rates, np.zeros(len(self)), base)[0]

    def mass_matrix(self, positions: ArrayLike) -> FloatArray:
        """Return (n, n) H(q), rotors included.

        Args:
            positions: (n,) [rad or m].
        """
        state = self._state(positions, np.zeros(len(self)), np.zeros(len(self)))
        matrix = np.empty((len(self), len(self)))
        _mass_matrix(*self._numbers(), state, matrix)
        return matrix + np.diag(self.rotors)

    def carried(self, positions: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return what the last body's push on the world asks of the chain, by the push (eq. A-2).

        Args:
            positions: (n,) [rad or m].

        Returns:
            (n, 6) J^T, the efforts, and (6, 6) the wrench at the base, per force and moment about
            the origin of the last body's frame, in that frame.
        """
        state = self._state(positions)
        efforts, wrenches = np.empty((len(self), 6)), np.empty((6, 6))
        _carried(*self._numbers()[:4], state[0], efforts, wrenches)
        return efforts, wrenches

    def last_frame(self, positions: ArrayLike) -> FloatArray:
        """Return (4, 4) the transform from the last body's frame to the base frame.

        Args:
            positions: (n,) [rad or m].
        """
        state = self._state(positions)
        frame = np.eye(4)
        _last_frame(self._slides, self._axes, self._offsets, self._rotations, state[0], frame)
        return frame

    def _numbers(self) -> tuple[NDArray[np.bool_], FloatArray, FloatArray, FloatArray,
                                FloatArray, FloatArray, FloatArray]:  # fmt: skip
        return (
            self._slides,
            self._axes,
            self._offsets,
            self._rotations,
            self._masses,
            self._centres,
            self._inertias,
        )

    def _state(self, *rows: ArrayLike) -> FloatArray:
        state = np.empty((len(rows), len(self.joints)))
        for name, row, kept in zip(
            ("positions", "rates", "accelerations"), rows, state, strict=False
        ):
            if np.shape(row) != kept.shape:
                raise ValueError(f"joint {name} {row}: expected {len(self)} finite numbers")
            kept[:] = row
            # A sum of finite numbers is finite: cheaper than asking each, many times a tick.
            if not math.isfinite(kept.sum()):
                raise ValueError(f"joint {name} {row}: expected {len(self)} finite numbers")
        return state


@numba.njit(cache=True)
def _cross(a, b):
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@numba.njit(cache=True)
def _turn(axis, angle):
    """Return the rotation (3, 3) about a unit axis (Rodrigues)."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z = axis[0], axis[1], axis[2]
    v = 1.0 - c
    return np.array(
        [
            [c + v * x * x, v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, c + v * y * y, v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, c + v * z * z],
        ]
    )


@numba.njit(cache=True)
def _last_frame(slides, axes, offsets, rotations, positions, frame):
    """Write the last body's frame (4, 4) in that of the base."""
    turn, place = np.eye(3), np.zeros(3)
    for i in range(len(positions)):
        place = place + turn @ offsets[i]
        turn = turn @ rotations[i]
        if slides[i]:
            place = place + turn @ (axes[i] * positions[i])
        else:
            turn = turn @ _turn(axes[i], positions[i])
    frame[:3, :3] = turn
    frame[:3, 3] = place


@numba.njit(cache=True)
def _newton_euler(
    slides, axes, offsets, rotations, masses, centres, inertias, state, base, tip, efforts, wrench
):
    """Write the efforts (n,) and the wrench at the base (6,).

    State has positions, rates and accelerations, (3, n); base is specific force, angular velocity
    and angular acceleration, (3, 3).
    """
    count = len(masses)
    to_parent = np.empty((count, 3, 3))
    places = np.empty((count, 3))
    forces = np.empty((count, 3))
    moments = np.empty((count, 3))
    acceleration, omega, alpha = base[0].copy(), base[1].copy(), base[2].copy()
    for i in range(count):
        axis, rate = axes[i], state[1, i]
        place, rotation = offsets[i].copy(), rotations[i].copy()
        if slides[i]:
            place += rotation @ (axis * state[0, i])
        else:
            rotation = rotation @ _turn(axis, state[0, i])
        acceleration = acceleration + _cross(alpha, place) + _cross(omega, _cross(omega, place))
        back = np.ascontiguousarray(rotation.T)
        acceleration, omega, alpha = back @ acceleration, back @ omega, back @ alpha
        if slides[i]:
            acceleration += axis * state[2, i] + 2.0 * _cross(omega, axis * rate)
        else:
            alpha += axis * state[2, i] + _cross(omega, axis * rate)
            omega = omega + axis * rate
        to_parent[i], places[i] = rotation, place
        centre = centres[i]
        swung = acceleration + _cross(alpha, centre) + _cross(omega, _cross(omega, centre))
        forces[i] = masses[i] * swung
        spin = inertias[i] @ omega
        moments[i] = inertias[i] @ alpha + _cross(omega, spin) + _cross(centre, forces[i])
    force, moment = tip[:3].copy(), tip[3:].copy()
    for i in range(count - 1, -1, -1):
        force = force + forces[i]
        moment = moment + moments[i]
        carried = force if slides[i] else moment
        efforts[i] = axes[i] @ carried
        force = to_parent[i] @ force
        moment = to_parent[i] @ moment + _cross(places[i], force)
    wrench[:3], wrench[3:] = force, moment


@numba.njit(cache=True)
def _carried(slides, axes, offsets, rotations, positions, efforts, wrenches):
    """Write efforts (n, 6) and the wrench at the base (6, 6) per wrench at the last frame."""
    wrenches[:] = np.eye(6)
    force, moment = wrenches[:3], wrenches[3:]
    for i in range(len(positions) - 1, -1, -1):
        efforts[i] = axes[i] @ (force if slides[i] else moment)
        place, rotation = offsets[i].copy(), rotations[i].copy()
        if slides[i]:
            place += rotation @ (axes[i] * positions[i])
        else:
            rotation = rotation @ _turn(axes[i], positions[i])
        force[:] = rotation @ force
        moment[:] = rotation @ moment
        for k in range(6):
            moment[:, k] += _cross(place, force[:, k])


@numba.njit(cache=True)
def _mass_matrix(slides, axes, offsets, rotations, masses, centres, inertias, state, matrix):
    """Write (n, n) the efforts of unit accelerations, one column a joint, free of gravity."""
    count = len(masses)
    still, column, wrench = np.zeros((3, 3)), np.empty(count), np.empty(6)
    for i in range(count):
        state[2] = 0.0
        state[2, i] = 1.0
        _newton_euler(
            slides, axes, offsets, rotations, masses, centres, inertias, state, still,
            np.zeros(6), column, wrench,
        )  # fmt: skip
        matrix[:, i] = column
