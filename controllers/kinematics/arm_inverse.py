"""Closed-form inverse kinematics of an arm as the rover's: a yaw about z, then three pitches.

Shoulder, elbow and wrist turn about x. All links move in one vertical plane that the yaw turns;
the chain's tool, a camera with z along its view, may sit beside that plane and may squint out of
it. A view needs five numbers (the camera's place and where its axis points) and four joints are
there, so that from a fixed base only views in a plane can be had: `standing_views` gives those.
`parallel_views` gives none for other views; the base must move. A gripper's task is its place and
the pitch of its forward axis, as many numbers as there are joints: `GripperInverse`.
"""

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray

STRAIGHT = 1e-9
"""Slack of angles [rad] and lengths [m] where rounding must not decide."""
LEAST_DISTANCE = 1e-6
"""Distance of a gripper from the yaw's axis [m] below which every yaw is as good."""


class ArmGeometry(NamedTuple):
    """An arm by the numbers of its plane: y along the arm, z up, x to its right.

    Attributes:
        yaw_axis: (3,) foot of the yaw's axis [m], frame of the arm's base.
        shoulder: (2,) y, z from there [m].
        links: (2, 2) y, z of upper arm and forearm at angle zero [m].
        camera: (2,) y, z of the camera from the wrist's hinge at angle zero [m].
        beside: Distance of the camera to the right of the yaw's axis [m].
        axis: (3,) unit vector of the view in the wrist's frame.
        limits: (4, 2) lowest and highest angles [rad].
    """

    yaw_axis: FloatArray
    shoulder: FloatArray
    links: FloatArray
    camera: FloatArray
    beside: float
    axis: FloatArray
    limits: FloatArray

    @classmethod
    @functools.lru_cache(16)  # A search asks for the same arm thousands of times.
    def of(cls, arm: SerialChain) -> "ArmGeometry":
        """Read an arm's numbers.

        Raises:
            ValueError: If it is not of this kind, naming the hinge.
        """
        expected = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
        if len(arm) != len(expected):
            raise ValueError(f"arm of {len(arm)} joints: expected a yaw and three pitches about x")
        for joint, axis in zip(arm.joints, expected, strict=True):
            turned = joint.transform_link_to_parent.rotation.magnitude() > STRAIGHT
            if turned or joint.slides or not np.allclose(joint.axis, axis, atol=STRAIGHT):
                raise ValueError(
                    f"joint {joint.name} moves along or about {joint.axis}: expected a hinge about "
                    f"{axis}, not turned to its parent"
                )
        offsets = np.array([joint.transform_link_to_parent.translation for joint in arm.joints])
        camera = arm.transform_tool_to_link
        place = np.asarray(camera.translation, dtype=float)
        return cls(
            offsets[0],
            offsets[1, 1:],
            offsets[2:, 1:],
            place[1:],
            float(offsets[1:, 0].sum() + place[0]),
            np.asarray(camera.rotation.apply([0.0, 0.0, 1.0]), dtype=float),
            arm.limits,
        )

    @property
    def upright(self) -> float:
        """How much of the view's unit vector lies in the arm's plane."""
        return float(np.hypot(self.axis[1], self.axis[2]))

    @property
    def length(self) -> float:
        """Farthest that the camera can be from the shoulder, in the plane [m]."""
        return float(np.linalg.norm(self.links, axis=1).sum() + np.linalg.norm(self.camera))

    def bend(self, along: ArrayLike, height: ArrayLike, pitch: ArrayLike) -> FloatArray:
        """Return shoulder, elbow and wrist that hold the camera somewhere in the plane.

        Args:
            along: (...) y of the camera from the yaw's axis [m].
            height: (...) z of the camera from the foot of the yaw's axis [m].
            pitch: (...) angle of the view's part in the plane above the y axis [rad].

        Returns:
            (..., 2, 3) angles [rad] with the elbow up and down; NaN where out of reach or limits.
        """
        # Compiled: a steered arm needs one place, many times a second.
        given = np.broadcast_arrays(along, height, pitch)
        y, z, turn = (np.ascontiguousarray(numbers, dtype=float).ravel() for numbers in given)
        angles = np.empty((len(y), 2, 3))
        squint = math.atan2(self.axis[2], self.axis[1])
        _bend(self, y, z, turn - squint, angles)
        return angles.reshape(*given[0].shape, 2, 3)

    def turned(self, yaw: ArrayLike) -> FloatArray:
        """Return yaw angles [rad] brought within the limits; NaN where they cannot be."""
        low, high = self.limits[0]
        middle = self.limits.mean(axis=1)[0]
        near = middle + np.remainder(np.asarray(yaw) - middle + np.pi, 2.0 * np.pi) - np.pi
        fits = (near >= low - STRAIGHT) & (near <= high + STRAIGHT)
        return np.where(fits, np.clip(near, low, high), np.nan)

    def headings(self, direction: FloatArray) -> list[tuple[float, float]]:
        """Return the arm's two (heading, pitch) [rad] for a direction of view; none if upright.

        The heading is that of the arm's plane, from where y is ahead; with the second pair the
        camera is upside down.

        Args:
            direction: (3,) unit vector, frame of the base.
        """
        if abs(direction[2]) > self.upright:
            return []
        rise = float(np.arcsin(direction[2] / self.upright))
        seen = np.arctan2(direction[1], direction[0])
        return [
            (float(seen - np.arctan2(self.upright * np.cos(pitch), self.axis[0])), pitch)
            for pitch in (rise, np.pi - rise)
        ]


@numba.njit(cache=True)
def _bend(arm: Any, along: Any, height: Any, pitch: Any, angles: Any) -> None:
    """Write (N, 2, 3) angles of `ArmGeometry.bend`; the pitch is that of the wrist's y axis."""
    links = arm.links
    upper = math.hypot(links[0, 0], links[0, 1])
    fore = math.hypot(links[1, 0], links[1, 1])
    rest_upper = math.atan2(links[0, 1], links[0, 0])
    rest_fore = math.atan2(links[1, 1], links[1, 0])
    for n in range(len(along)):
        turn = pitch[n]
        cosine, sine = math.cos(turn), math.sin(turn)
        y = along[n] - arm.shoulder[0] - cosine * arm.camera[0] + sine * arm.camera[1]
        z = height[n] - arm.shoulder[1] - sine * arm.camera[0] - cosine * arm.camera[1]
        folded = (y * y + z * z - upper * upper - fore * fore) / (2.0 * upper * fore)
        # A stretched arm is at the edge of what acos takes.
        if not abs(folded) <= 1.0 + STRAIGHT:
            angles[n] = np.nan
            continue
        inside = math.acos(min(max(folded, -1.0), 1.0))
        for elbow in range(2):
            between = inside if elbow == 0 else -inside
            offset = math.atan2(fore * math.sin(between), upper + fore * math.cos(between))
            first = math.atan2(z, y) - offset
            found = angles[n, elbow]
            found[0] = first - rest_upper
            found[1] = first + between - rest_fore - found[0]
            found[2] = turn - found[0] - found[1]
            for k in range(3):
                low, high = arm.limits[k + 1]
                middle = 0.5 * (low + high)
                near = middle + (found[k] - middle + np.pi) % (2.0 * np.pi) - np.pi
                if not (low - STRAIGHT <= near <= high + STRAIGHT):
                    found[:] = np.nan
                    break
                found[k] = min(max(near, low), high)


class GripperInverse:
    """Joint angles of a yaw-and-pitch arm that bring its gripper somewhere, robot frame.

    Args:
        arm: Chain of the arm; its own tool plays no part.
        grip: (3,) grip point in the last link's frame, whose y axis points forward [m].

    Raises:
        ValueError: If the arm is not a yaw and three hinges about x, or the grip point is beside
            the plane in which they move it.
    """

    def __init__(self, arm: SerialChain, grip: ArrayLike) -> None:
        place = np.asarray(grip, dtype=float)
        if place.shape != (3,) or not np.all(np.isfinite(place)):
            raise ValueError(f"grip point {grip}: expected three finite numbers")
        # As a camera: x to the right, y down, z along the gripper.
        forward = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        gripper = RigidTransform.from_components(place, forward)
        self._geometry = ArmGeometry.of(dataclasses.replace(arm, transform_tool_to_link=gripper))
        self._base = arm.transform_base_to_robot.as_matrix()
        if abs(self._geometry.beside) > STRAIGHT:
            raise ValueError(
                f"grip point {grip}: {self._geometry.beside} m beside the arm's plane, needs 0"
            )

    def solutions(self, task: ArrayLike, near: ArrayLike | None = None) -> FloatArray:
        """Return the joint angles that bring the gripper somewhere.

        The arm's base must be level in the robot frame, as the rover's does.

        Args:
            task: (4,) place x, y, z [m] of the grip point and pitch of the gripper's forward axis
                [rad], robot frame.
            near: (4,) angles [rad]; the solutions are sorted by their distance to these. None for
                the order in which they are found.

        Returns:
            (N, 4) within the limits [rad]; none if it is out of reach.

        Raises:
            ValueError: If a number is missing or not finite, or the place is on the yaw's axis.
        """
        asked = np.asarray(task, dtype=float)
        if asked.shape != (4,) or not np.all(np.isfinite(asked)):
            raise ValueError(f"gripper task {task}: expected x, y, z and pitch, finite")
        eye = self._base[:3, :3].T @ (asked[:3] - self._base[:3, 3]) - self._geometry.yaw_axis
        distance = math.hypot(eye[0], eye[1])
        if distance < LEAST_DISTANCE:
            raise ValueError(f"gripper task {task}: on the yaw's axis, where no yaw is singled out")
        heading = math.atan2(-eye[0], eye[1])
        # Facing the place, or turned away and reaching over the shoulder.
        yaws = self._geometry.turned([heading, heading + math.pi])
        bends = self._geometry.bend([distance, -distance], eye[2], asked[3])
        turns = np.broadcast_to(yaws[:, None, None], (2, 2, 1))
        angles = np.concatenate([turns, bends], axis=2).reshape(4, 4)
        angles = angles[np.isfinite(angles).all(axis=1)]
        if near is None:
            return angles
        return angles[np.argsort(np.linalg.norm(angles - np.asarray(near, dtype=float), axis=1))]


def parallel_views(arm: SerialChain, cameras: ArrayLike, direction: ArrayLike) -> FloatArray:
    """Return the joint angles with the camera at points and its axis along one direction.

    Args:
        arm: Chain of the arm with the camera as its tool.
        cameras: (N, 3) the left camera [m], robot frame.
        direction: (3,) direction of view, not vertical in the frame of the arm's base, robot frame.

    Returns:
        (N, 4, 4) up to four postures for each point [rad]; NaN where there is none within the
        joints' limits, or the point is not in the arm's plane.
    """
    geometry, to_base = ArmGeometry.of(arm), arm.transform_base_to_robot.inv()
    eyes = to_base.apply(np.asarray(cameras, dtype=float)) - geometry.yaw_axis
    seen = to_base.rotation.apply(np.asarray(direction, dtype=float))
    postures = np.full((len(eyes), 4, 4), np.nan)
    for k, (yaw, pitch) in enumerate(geometry.headings(seen / np.linalg.norm(seen))):
        beside = np.cos(yaw) * eyes[:, 0] + np.sin(yaw) * eyes[:, 1]
        along = np.cos(yaw) * eyes[:, 1] - np.sin(yaw) * eyes[:, 0]
        found = postures[:, 2 * k : 2 * k + 2]
        found[..., 0] = geometry.turned(yaw)
        found[..., 1:] = geometry.bend(along, eyes[:, 2], pitch)
        found[np.abs(beside - geometry.beside) > STRAIGHT] = np.nan
    postures[np.isnan(postures).any(axis=2)] = np.nan
    return postures


def _yaws_beside(point: FloatArray, beside: FloatArray) -> FloatArray:
    """Return (2, ...) yaws at which a point is so far to the right of the yaw's axis [rad]."""
    with np.errstate(invalid="ignore", divide="ignore"):
        turn = np.arccos(beside / np.hypot(point[0], point[1]))
    return np.arctan2(point[1], point[0]) + np.stack([turn, -turn])


@dataclasses.dataclass(frozen=True)
class StandingViews:
    """Views of a target in reach of a resting rover's arm.

    Attributes:
        positions: (N, 3) of the left camera [m], robot frame.
        angles: (N, 4) of the arm [rad].
    """

    positions: FloatArray
    angles: FloatArray


def standing_views(
    arm: SerialChain, target: ArrayLike, distances: ArrayLike, pitches: ArrayLike
) -> StandingViews:
    """Return the views of a target in reach of the arm while the base rests.

    Args:
        arm: Chain of the arm with the camera as its tool.
        target: (3,) [m], robot frame.
        distances: (R,) of the camera from it [m].
        pitches: (S,) angles of the view above the horizon of the arm's base [rad], over a whole
            turn: beyond a quarter turn the camera points back over the arm.
    """
    geometry = ArmGeometry.of(arm)
    base = arm.transform_base_to_robot
    seen = base.inv().apply(np.asarray(target, dtype=float)) - geometry.yaw_axis
    far = np.asarray(distances, dtype=float)
    pitch = np.asarray(pitches, dtype=float)
    yaws = _yaws_beside(seen, geometry.beside + far * geometry.axis[0])  # (2, R)
    ahead = np.cos(yaws) * seen[1] - np.sin(yaws) * seen[0]
    part = far[:, None] * geometry.upright
    along = ahead[:, :, None] - part * np.cos(pitch)
    height = np.broadcast_to(seen[2] - part * np.sin(pitch), along.shape)
    bends = geometry.bend(along, height, np.broadcast_to(pitch, along.shape))
    turns = np.broadcast_to(geometry.turned(yaws)[:, :, None, None, None], (*bends.shape[:-1], 1))
    angles = np.concatenate([turns, bends], axis=-1).reshape(-1, 4)
    angles = angles[np.isfinite(angles).all(axis=1)]
    if len(angles) == 0:
        return StandingViews(np.zeros((0, 3)), angles)
    return StandingViews(np.asarray(arm.tool_in_robot(angles).translation), angles)
