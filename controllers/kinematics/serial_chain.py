"""A serial chain of hinges and slides on a moving base: poses, Jacobian and dynamics, compiled.

The equations of motion of thesis eq. A-2, H(q) q'' + h(q, q') - G = Q - J^T F, are evaluated by
the recursion of Newton and Euler: the terms are those of the Lagrangian, without its derivatives
of H. Vectors of a joint are in the frame of the link that it moves. What takes one configuration
(n,) takes many (N, n) as well, and then answers with one more axis in front.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false

import dataclasses
import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.rigid_motion import LEVEL, WEIGHTLESS, FrameMotion, LinkMotion
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import adjoint
from twin.description import ArmDescription, JointDescription, RigidBody, RobotDescription


class ChainArrays(NamedTuple):
    """Numbers of a chain of n joints for the kernels; body 0 is what its base carries.

    Attributes:
        slides: (n,) whether a joint slides; if not it turns.
        axes: (n, 3) unit vectors of the joints, link frames.
        offsets: (n, 3) origins of the links in their parents' frames, at zero [m].
        rotations: (n, 3, 3) from the links to their parents, at zero.
        masses: (n + 1,) [kg].
        centres: (n + 1, 3) centres of mass [m], link frames.
        inertias: (n + 1, 3, 3) about the centres of mass [kg m^2], link frames.
    """

    slides: NDArray[np.bool_]
    axes: FloatArray
    offsets: FloatArray
    rotations: FloatArray
    masses: FloatArray
    centres: FloatArray
    inertias: FloatArray


@dataclasses.dataclass(frozen=True, eq=False)
class SerialChain:
    """A chain of hinges and slides with a tool on its last link.

    Attributes:
        joints: Joints from the base on.
        base: Body that the base carries before the first joint, base frame.
        transform_base_to_robot: Transform from the base to the robot frame.
        transform_tool_to_link: Transform from the tool, such as a camera, to the last link.
        cover_radius: Radius of the spheres about the joints' cover points [m].
        mount_covariance: (6, 6) covariance of xi of the tool's mounting, rotation [rad] then
            translation [m], in its own frame.

    Raises:
        ValueError: If there is no joint, or one's axis is not a unit vector, naming it.
    """

    joints: tuple[JointDescription, ...]
    base: RigidBody = WEIGHTLESS
    transform_base_to_robot: RigidTransform = dataclasses.field(
        default_factory=RigidTransform.identity
    )
    transform_tool_to_link: RigidTransform = dataclasses.field(
        default_factory=RigidTransform.identity
    )
    cover_radius: float = 0.0
    mount_covariance: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((6, 6)))
    limits: FloatArray = dataclasses.field(init=False, repr=False)
    """(n, 2) lowest and highest joint positions [rad or m]."""
    rotor_inertia: FloatArray = dataclasses.field(init=False, repr=False)
    """(n,) inertia of the motors' rotors at the joints [kg m^2, or kg for a slide]."""
    _arrays: ChainArrays = dataclasses.field(init=False, repr=False)
    _root: FloatArray = dataclasses.field(init=False, repr=False)
    _tool: FloatArray = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Gather the joints' numbers for the kernels."""
        if not self.joints:
            raise ValueError("a chain without joints: needs one or more")
        for joint in self.joints:
            length = np.linalg.norm(joint.axis)
            if not abs(length - 1.0) < 1e-9:
                raise ValueError(
                    f"axis of joint {joint.name}: length {length}, needs a unit vector"
                )
        placed = [joint.transform_link_to_parent for joint in self.joints]
        bodies = [self.base, *(joint.body for joint in self.joints)]
        arrays = ChainArrays(
            np.array([joint.slides for joint in self.joints]),
            np.array([joint.axis for joint in self.joints], dtype=float),
            np.array([place.translation for place in placed]),
            np.array([place.rotation.as_matrix() for place in placed]),
            np.array([body.mass for body in bodies], dtype=float),
            np.array([body.centre for body in bodies], dtype=float),
            np.array([body.inertia for body in bodies], dtype=float),
        )
        object.__setattr__(self, "_arrays", arrays)
        object.__setattr__(self, "_root", self.transform_base_to_robot.as_matrix())
        object.__setattr__(self, "_tool", self.transform_tool_to_link.as_matrix())
        object.__setattr__(self, "limits", np.array([joint.limits for joint in self.joints]))
        rotors = np.array([joint.rotor_inertia for joint in self.joints])
        object.__setattr__(self, "rotor_inertia", rotors)

    @classmethod
    def from_description(
        cls, arm: ArmDescription, transform_tool_to_link: RigidTransform | None = None
    ) -> "SerialChain":
        """Return the chain of an arm as drawn.

        Args:
            arm: The arm.
            transform_tool_to_link: Transform from the tool to the last link, as a stereo head's
                `transform_camera_to_wrist`; None for the last link itself.
        """
        tool = transform_tool_to_link
        return cls(
            arm.joints,
            arm.base,
            arm.transform_base_to_robot,
            RigidTransform.identity() if tool is None else tool,
            arm.cover_radius,
        )

    @classmethod
    def of_robot(cls, robot: RobotDescription) -> "SerialChain":
        """Return the chain of a robot's arm, with the left camera of its stereo head as the tool.

        Args:
            robot: The robot; without a head the tool is the last link itself.

        Raises:
            ValueError: If the robot has no arm.
        """
        if robot.arm is None:
            raise ValueError(f"robot {robot.name} has no arm: there is no chain to build")
        head = robot.head
        if head is None:
            return cls.from_description(robot.arm)
        chain = cls.from_description(robot.arm, head.transform_camera_to_wrist)
        return dataclasses.replace(chain, mount_covariance=head.calibration.mount_covariance())

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    def link_frames(self, positions: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return rotations (N, n, 3, 3) and origins (N, n, 3) [m] of all links, robot frame.

        Thousands at once: rigid transforms as objects would take ten times as long.

        Args:
            positions: (n,) for one configuration, or (N, n) [rad or m].

        Raises:
            ValueError: If the number of positions is wrong or one is not finite.
        """
        rows = np.atleast_2d(self._checked("positions", positions))
        rotations = np.empty((*rows.shape, 3, 3))
        origins = np.empty((*rows.shape, 3))
        _link_frames(self._arrays, rows, self._root, rotations, origins)
        return rotations, origins

    def tool_in_robot(self, positions: ArrayLike) -> RigidTransform:
        """Return the transform from the tool to the robot frame.

        Args:
            positions: (n,) for one transform, or (N, n) for N [rad or m].

        Raises:
            ValueError: As `link_frames`.
        """
        rotations, origins = self.link_frames(positions)
        last = 0 if np.ndim(positions) == 1 else slice(None)
        turn = Rotation.from_matrix(rotations[last, -1])
        return RigidTransform.from_components(origins[last, -1], turn) * self.transform_tool_to_link

    def tool_frame(self, positions: ArrayLike) -> FloatArray:
        """Return `tool_in_robot` of one configuration as a matrix (4, 4).

        A fiftieth of the time of the object: for what runs many times a tick.

        Args:
            positions: (n,) [rad or m].

        Raises:
            ValueError: As `link_frames`.
        """
        rotations, origins = self.link_frames(positions)
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = rotations[0, -1], origins[0, -1]
        return frame @ self._tool

    def cover_points(self, positions: ArrayLike) -> FloatArray:
        """Return (N, K, 3) points [m], robot frame; spheres about them cover the chain.

        Args:
            positions: (N, n) [rad or m].

        Raises:
            ValueError: As `link_frames`.
        """
        rotations, origins = self.link_frames(positions)
        placed = [
            joint.cover_points @ np.swapaxes(rotations[:, link], 1, 2) + origins[:, link, None]
            for link, joint in enumerate(self.joints)
        ]
        return np.concatenate(placed, axis=1)

    def jacobian(self, positions: ArrayLike) -> FloatArray:
        """Return (6, n): linear [m] and angular [rad] motion of the tool per joint position.

        Args:
            positions: (n,) [rad or m].

        Raises:
            ValueError: As `link_frames`.
        """
        rotations, origins = (part[0] for part in self.link_frames(positions))
        tool = origins[-1] + rotations[-1] @ self._tool[:3, 3]
        axes = np.einsum("nij,nj->ni", rotations, self._arrays.axes)
        slides = self._arrays.slides[:, None]
        linear = np.where(slides, axes, np.cross(axes, tool - origins))
        return np.concatenate([linear, np.where(slides, 0.0, axes)], axis=1).T

    def error_jacobian(self, positions: ArrayLike) -> FloatArray:
        """Return (6, 6 + n): xi of the tool in the robot frame by errors that last.

        These are xi of the tool's mounting, in its own frame, and the positions' zeros [rad or m];
        xi is a rotation [rad], then a translation [m].

        Args:
            positions: (n,) [rad or m].

        Raises:
            ValueError: As `link_frames`.
        """
        linear, angular = np.vsplit(self.jacobian(positions), 2)
        tool = self.tool_in_robot(positions)
        at_origin = linear - np.cross(angular, tool.translation, axis=0)
        return np.hstack([adjoint(tool), np.vstack([angular, at_origin])])

    def error_covariance(self) -> FloatArray:
        """Return the covariance (6 + n, 6 + n) of the errors of `error_jacobian`.

        Joints out of place move the tool; their part counts as the mounting's. What an arm bears
        rests on the lower side of each gear's play, so that these errors add up.
        """
        zeros = np.diag([joint.zero_sigma**2 for joint in self.joints])
        rests = np.array([joint.rest for joint in self.joints])
        places = sum(joint.place_sigma**2 for joint in self.joints)
        mounting = np.diag([0.0] * 3 + [places] * 3) + self.mount_covariance
        return np.asarray(block_diag(mounting, zeros + np.outer(rests, rests)))

    def inverse_dynamics(
        self,
        positions: ArrayLike,
        rates: ArrayLike,
        accelerations: ArrayLike,
        base: FrameMotion = LEVEL,
        tip: ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the joint efforts of a motion, and the wrench on the chain at its base.

        Args:
            positions: (n,) or (N, n) [rad or m].
            rates: (n,) or (N, n) [rad/s or m/s].
            accelerations: (n,) or (N, n) [rad/s^2 or m/s^2].
            base: Motion of the base frame, one for all or one for each configuration.
            tip: (6,) force [N] and moment about the origin [N m] that the last link exerts on
                the world, in its frame; None for none.

        Returns:
            (n,) or (N, n) generalised efforts [N m or N], and (6,) or (N, 6) force [N] and moment
            about the origin [N m] on the chain, with what its base carries, base frame.

        Raises:
            ValueError: If a number is missing or not finite.
        """
        state, motion = self._state(positions, rates, accelerations), _stacked(base)
        pushed = np.zeros(6) if tip is None else np.asarray(tip, dtype=float)
        efforts, wrenches = np.empty((len(state), len(self))), np.empty((len(state), 6))
        _inverse_dynamics(self._arrays, state, motion, pushed, efforts, wrenches)
        efforts += self.rotor_inertia * state[:, 2]
        if np.ndim(positions) == 1:
            return efforts[0], wrenches[0]
        return efforts, wrenches

    def bias(self, positions: ArrayLike, rates: ArrayLike, base: FrameMotion = LEVEL) -> FloatArray:
        """Return the efforts of zero accelerations, h(q, q') - G [N m or N].

        Args:
            positions: (n,) or (N, n) [rad or m].
            rates: (n,) or (N, n) [rad/s or m/s].
            base: Motion of the base frame.
        """
        return self.inverse_dynamics(positions, rates, np.zeros(np.shape(positions)), base)[0]

    def mass_matrix(self, positions: ArrayLike) -> FloatArray:
        """Return (n, n) H(q), rotors included.

        Args:
            positions: (n,) [rad or m].
        """
        zero = np.zeros(len(self))
        state = self._state(positions, zero, zero)[0]
        matrix = np.empty((len(self), len(self)))
        _mass_matrix(self._arrays, state, matrix)
        return matrix + np.diag(self.rotor_inertia)

    def base_inertia(self, positions: ArrayLike) -> FloatArray:
        """Return (N, 6, 6): wrench at the base per acceleration of the base, the joints locked.

        Columns are the linear acceleration of the base's origin, then its angular acceleration.

        Args:
            positions: (N, n) [rad or m].
        """
        zero = np.zeros(np.shape(positions))
        moved = [FrameMotion(unit[:3], np.zeros(3), unit[3:]) for unit in np.eye(6)]
        columns = [self.inverse_dynamics(positions, zero, zero, base)[1] for base in moved]
        return np.stack(columns, axis=-1)

    def last_link_motion(
        self, positions: ArrayLike, rates: ArrayLike, accelerations: ArrayLike, base: FrameMotion
    ) -> LinkMotion:
        """Return how the last link is placed in the base frame, and how it moves.

        Args:
            positions: (N, n) [rad or m].
            rates: (N, n) [rad/s or m/s].
            accelerations: (N, n) [rad/s^2 or m/s^2].
            base: Motion of the base frame, one for all or one for each configuration.

        Raises:
            ValueError: If a number is missing or not finite.
        """
        state = self._state(positions, rates, accelerations)
        rotation, position = np.empty((len(state), 3, 3)), np.empty((len(state), 3))
        motion = np.empty((len(state), 3, 3))
        _last_link_motion(self._arrays, state, _stacked(base), rotation, position, motion)
        return LinkMotion(rotation, position, FrameMotion(*np.swapaxes(motion, 0, 1)))

    def _state(self, *rows: ArrayLike) -> FloatArray:
        """Return (N, 3, n) positions, rates and accelerations."""
        count = len(rows[0]) if np.ndim(rows[0]) == 2 else 1  # pyright: ignore
        state = np.empty((count, 3, len(self)))
        for k, name in enumerate(("positions", "rates", "accelerations")):
            state[:, k] = self._checked(name, rows[k])
        return state

    def _checked(self, name: str, row: ArrayLike) -> FloatArray:
        numbers = np.asarray(row, dtype=float)
        # A sum of finite numbers is finite: cheaper than asking each, many times a tick.
        if (
            numbers.shape[-1:] != (len(self),)
            or numbers.ndim > 2
            or not math.isfinite(numbers.sum())
        ):
            raise ValueError(
                f"joint {name} of shape {numbers.shape}, {row}: expected {len(self)} finite "
                "numbers for each configuration"
            )
        return numbers


def _stacked(base: FrameMotion) -> FloatArray:
    """Return (1 or N, 3, 3) specific force, angular velocity and angular acceleration."""
    count = len(base.specific_force) if base.specific_force.ndim == 2 else 1
    motion = np.empty((count, 3, 3))
    motion[:, 0] = base.specific_force
    motion[:, 1] = base.angular_velocity
    motion[:, 2] = base.angular_acceleration
    return motion


@numba.njit(cache=True)
def _cross(a: Any, b: Any) -> Any:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@numba.njit(cache=True)
def _turn(axis: Any, angle: float) -> Any:
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
def _to_parent(chain: Any, i: int, position: float) -> Any:
    """Return rotation (3, 3) and origin (3,) of link i in its parent's frame."""
    place, rotation = chain.offsets[i].copy(), chain.rotations[i].copy()
    if chain.slides[i]:
        place += rotation @ (chain.axes[i] * position)
    else:
        # By hand: a call of BLAS costs more than these 27 products.
        turn = _turn(chain.axes[i], position)
        for row in range(3):
            x, y, z = rotation[row, 0], rotation[row, 1], rotation[row, 2]
            for column in range(3):
                rotation[row, column] = (
                    x * turn[0, column] + y * turn[1, column] + z * turn[2, column]
                )
    return rotation, place


@numba.njit(cache=True)
def _link_frames(chain: Any, positions: Any, root: Any, rotations: Any, origins: Any) -> None:
    """Write rotations (N, n, 3, 3) and origins (N, n, 3) of the links on a base at root (4, 4)."""
    for k in range(len(positions)):
        turn, origin = root[:3, :3], root[:3, 3]
        for i in range(positions.shape[1]):
            step, offset = _to_parent(chain, i, positions[k, i])
            for row in range(3):
                x, y, z = turn[row, 0], turn[row, 1], turn[row, 2]
                origins[k, i, row] = origin[row] + x * offset[0] + y * offset[1] + z * offset[2]
                for column in range(3):
                    rotations[k, i, row, column] = (
                        x * step[0, column] + y * step[1, column] + z * step[2, column]
                    )
            turn, origin = rotations[k, i], origins[k, i]


@numba.njit(cache=True)
def _moved(chain: Any, i: int, state: Any, parent: Any, rotation: Any, place: Any) -> Any:
    """Return the motion (3, 3) of link i: specific force, angular velocity and acceleration."""
    axis, rate = chain.axes[i], state[1, i]
    force, omega, alpha = parent[0], parent[1], parent[2]
    force = force + _cross(alpha, place) + _cross(omega, _cross(omega, place))
    back = np.ascontiguousarray(rotation.T)
    motion = np.empty((3, 3))
    force, omega, alpha = back @ force, back @ omega, back @ alpha
    if chain.slides[i]:
        force += axis * state[2, i] + 2.0 * _cross(omega, axis * rate)
    else:
        alpha += axis * state[2, i] + _cross(omega, axis * rate)
        omega = omega + axis * rate
    motion[0], motion[1], motion[2] = force, omega, alpha
    return motion


@numba.njit(cache=True)
def _body_wrench(chain: Any, body: int, motion: Any) -> Any:
    """Return force (3,) and moment (3,) about the origin that move a body so, in its frame."""
    force, omega, alpha = motion[0], motion[1], motion[2]
    centre, inertia = chain.centres[body], chain.inertias[body]
    swung = force + _cross(alpha, centre) + _cross(omega, _cross(omega, centre))
    push = chain.masses[body] * swung
    spin = inertia @ omega
    return push, inertia @ alpha + _cross(omega, spin) + _cross(centre, push)


@numba.njit(cache=True)
def _newton_euler(chain: Any, state: Any, base: Any, tip: Any, efforts: Any, wrench: Any) -> None:
    """Write the efforts (n,) and the wrench at the base (6,).

    State has positions, rates and accelerations, (3, n); base is specific force, angular velocity
    and angular acceleration, (3, 3).
    """
    count = state.shape[1]
    to_parent = np.empty((count, 3, 3))
    places = np.empty((count, 3))
    forces = np.empty((count, 3))
    moments = np.empty((count, 3))
    motion = base
    for i in range(count):
        rotation, place = _to_parent(chain, i, state[0, i])
        to_parent[i], places[i] = rotation, place
        motion = _moved(chain, i, state, motion, rotation, place)
        forces[i], moments[i] = _body_wrench(chain, i + 1, motion)
    force, moment = tip[:3].copy(), tip[3:].copy()
    for i in range(count - 1, -1, -1):
        force = force + forces[i]
        moment = moment + moments[i]
        carried = force if chain.slides[i] else moment
        efforts[i] = chain.axes[i] @ carried
        force = to_parent[i] @ force
        moment = to_parent[i] @ moment + _cross(places[i], force)
    carried_force, carried_moment = _body_wrench(chain, 0, base)
    wrench[:3], wrench[3:] = force + carried_force, moment + carried_moment


@numba.njit(cache=True)
def _inverse_dynamics(
    chain: Any, states: Any, bases: Any, tip: Any, efforts: Any, wrenches: Any
) -> None:
    """Write efforts (N, n) and wrenches (N, 6); there may be one base motion for all."""
    for k in range(len(states)):
        base = bases[min(k, len(bases) - 1)]
        _newton_euler(chain, states[k], base, tip, efforts[k], wrenches[k])


@numba.njit(cache=True)
def _last_link_motion(
    chain: Any, states: Any, bases: Any, rotations: Any, positions: Any, motions: Any
) -> None:
    """Write rotation (N, 3, 3), position (N, 3) and motion (N, 3, 3) of the last link."""
    for k in range(len(states)):
        motion = bases[min(k, len(bases) - 1)]
        turn, origin = np.eye(3), np.zeros(3)
        for i in range(states.shape[2]):
            rotation, place = _to_parent(chain, i, states[k, 0, i])
            motion = _moved(chain, i, states[k], motion, rotation, place)
            origin = origin + turn @ place
            turn = turn @ rotation
        rotations[k], positions[k], motions[k] = turn, origin, motion


@numba.njit(cache=True)
def _mass_matrix(chain: Any, state: Any, matrix: Any) -> None:
    """Write (n, n) the efforts of unit accelerations, one column a joint, free of gravity."""
    count = state.shape[1]
    still, column, wrench = np.zeros((3, 3)), np.empty(count), np.empty(6)
    for i in range(count):
        state[2] = 0.0
        state[2, i] = 1.0
        _newton_euler(chain, state, still, np.zeros(6), column, wrench)
        matrix[:, i] = column
