"""Scene of ``ch3-stereo``: two rovers with stereo heads before a panel among rocks and blocks.

A seed determines the whole scene. Pairs come from the cameras on the arms, whose joints are set
without dynamics, or from a free rig with any pose. The true camera pose and the true depth are for
scoring alone.
"""

import dataclasses
import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from models.clutter import PanelConfig
from models.compose import (
    ARM_JOINTS,
    FieldConfig,
    RobotPlacement,
    build_scene,
    compile_scene,
    load_part,
    settle,
)
from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray, ImageArray
from perception.stereo.geometry import StereoGeometry
from twin.camera import StereoConfig, StereoRig, camera_model, camera_pose

RIG = "rig"
"""Name of the free stereo head."""
TEXTURE_TILE = 0.5
"""Edge of the ground's noise tile [m]: a match one tile away lies outside the search up to 3 m."""
SHOWN_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)
"""Whether cameras show each group of geoms."""
_ARM_BODIES = ("turret", "upper_arm", "forearm", "wrist", "stereo_head")
HEAD = StereoGeometry(*CAMERA.pinhole.intrinsics, CAMERA.baseline)
"""Geometry of the stereo head by its datasheet."""
PIXEL_SIGMA = (0.05, 0.05, 0.044)
"""Standard deviations of the head's columns, rows and disparities [px]; the last was measured on
noise-textured ground, the others stand for the lens' calibration."""


@dataclasses.dataclass(frozen=True)
class CapturedPair:
    """A stereo pair and the true pose of its left camera.

    Attributes:
        pair: (2, height, width) uint8, left and right image.
        transform_camera_to_world: True pose of the left camera (x right, y down, z forward).
    """

    pair: ImageArray
    transform_camera_to_world: RigidTransform


def draw_layout(seed: int) -> tuple[PanelConfig, tuple[RobotPlacement, RobotPlacement]]:
    """Draw the poses of the panel and of the two rovers.

    The rovers face the panel from about 1.1 m away, on either side of the direction that it faces.

    Args:
        seed: Seed of the scene.
    """
    rng = np.random.default_rng(np.random.SeedSequence((seed, 1)))
    x, y = np.array([0.0, 0.35]) + rng.uniform(-0.08, 0.08, 2)
    panel = PanelConfig((x, y), yaw=rng.uniform(-0.2, 0.2), tilt=rng.uniform(0.2, 0.5))
    robots = []
    for index, side in enumerate((-1.0, 1.0)):
        bearing = side * rng.uniform(0.40, 0.70)  # from the direction in which the panel faces
        distance = rng.uniform(1.0, 1.2)
        angle = panel.yaw + bearing
        place = (x + distance * math.sin(angle), y - distance * math.cos(angle))
        robots.append(RobotPlacement(f"rover{index + 1}", place, angle + rng.uniform(-0.12, 0.12)))
    return panel, (robots[0], robots[1])


class StereoScene:
    """A compiled scene at rest, with settable arms and readable cameras.

    Args:
        seed: Random seed of the scene and of the images' noise.
        texture_pixels: Edge of the textures [px]; a power of two. Less than 2048 is too coarse for
            stereo at arm's length.

    Attributes:
        seed: Random seed of the scene and of the images' noise.
        panel: CAD and true pose of the panel.
        field: Ground with panel, rocks and blocks.
        robots: Names and poses of the two rovers.
        model: Compiled scene.
        data: State of the scene.
        geometry: Geometry of every stereo pair.
    """

    def __init__(self, seed: int, texture_pixels: int = 2048) -> None:
        self.seed = seed
        self.panel, self.robots = draw_layout(seed)
        self.field = FieldConfig(
            size=(3.2, 3.2),
            rocks=320,
            blocks=30,
            seed=seed,
            texture_pixels=texture_pixels,
            texture_tile=TEXTURE_TILE,
            panel=self.panel,
        )
        scene = build_scene(self.field, self.robots)
        _add_free_rig(scene)
        self.model = compile_scene(scene)
        # Facets of a drawn ellipsoid: it is within 0.1 mm of the true one.
        self.model.vis.quality.numslices, self.model.vis.quality.numstacks = 48, 32
        self.data = settle(self.model)
        streams = np.random.SeedSequence((seed, 2)).spawn(len(self.robots) + 1)
        self._rigs = {
            name: (StereoRig(self.model, f"{name}/", StereoConfig()), np.random.default_rng(stream))
            for name, stream in zip((*self.robot_names, RIG), streams, strict=True)
        }
        left = camera_model(self.model, f"{RIG}/stereo_left")
        offset = self.model.camera(f"{RIG}/stereo_right").pos - self.model.camera(left_name()).pos
        self.geometry = StereoGeometry(*left.intrinsics, float(offset[0]))

    @property
    def robot_names(self) -> tuple[str, ...]:
        """Names of the robots."""
        return tuple(robot.name for robot in self.robots)

    @property
    def transform_panel_to_world(self) -> RigidTransform:
        """True pose of the panel."""
        body = self.data.body("panel")
        return _transform(body.xmat, body.xpos)

    def joint_limits(self, robot: str) -> FloatArray:
        """Return (4, 2) ranges of an arm's joints [rad]."""
        return np.array([self.model.joint(name).range for name in _joints(robot)], dtype=float)

    def joints(self, robot: str) -> FloatArray:
        """Return (4,) angles of an arm [rad]."""
        return np.array([self.data.joint(name).qpos[0] for name in _joints(robot)])

    def set_joints(self, robot: str, angles: ArrayLike) -> None:
        """Set an arm's joints without dynamics; the base does not move.

        Args:
            robot: Name of the robot.
            angles: (4,) in the order of `models.compose.ARM_JOINTS` [rad].

        Raises:
            ValueError: If there is no such robot or an angle is out of its range.
        """
        self._check_name(robot)
        values = np.asarray(angles, dtype=float)
        limits = self.joint_limits(robot)
        if values.shape != (4,) or not np.all((limits[:, 0] <= values) & (values <= limits[:, 1])):
            raise ValueError(f"arm of {robot}: got {values}, needs angles within {limits.tolist()}")
        for name, value in zip(_joints(robot), values, strict=True):
            self.data.joint(name).qpos = value
        mujoco.mj_forward(self.model, self.data)

    def set_rig(self, transform_camera_to_world: RigidTransform) -> None:
        """Set the pose of the free rig by that of its left camera."""
        mount = self.model.camera(left_name())
        # MuJoCo's cameras look along -z with y up.
        axes = mount.mat0.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
        head = transform_camera_to_world * _transform(axes, mount.pos).inv()
        index = self.model.body(RIG).mocapid[0]
        self.data.mocap_pos[index] = head.translation
        self.data.mocap_quat[index] = head.rotation.as_quat(scalar_first=True)
        mujoco.mj_forward(self.model, self.data)

    def transform_camera_to_world(self, name: str) -> RigidTransform:
        """Return the true pose of the left camera of a robot or of the free rig."""
        self._check_name(name)
        rotation, translation = camera_pose(self.data, self.model.camera(left_name(name)).id)
        return _transform(rotation, translation)

    def capture(self, name: str) -> CapturedPair:
        """Take a pair with a robot's stereo head or the free rig.

        Args:
            name: Name of the robot, or `RIG`.

        Raises:
            ValueError: If there is no such robot.
        """
        pose = self.transform_camera_to_world(name)
        rig, rng = self._rigs[name]
        return CapturedPair(rig.capture(self.data, (rng, rng)), pose)

    def true_depths(self, name: str, pixels: ArrayLike) -> FloatArray:
        """Return the exact depths of pixels of a left camera, by casting rays.

        Args:
            name: Name of the robot, or `RIG`.
            pixels: (N, 2) column, row [px].

        Returns:
            (N,) depth along the optical axis [m]; NaN where there is only sky.
        """
        return self.true_hits(name, pixels)[0]

    def true_points(self, name: str, pixels: FloatArray) -> FloatArray:
        """Return (N, 3) points as `true_depths`, in the camera's frame [m]; NaN for sky."""
        disparities = self.geometry.fx * self.geometry.baseline / self.true_depths(name, pixels)
        return self.geometry.points(np.column_stack([pixels, disparities]))

    def true_hits(self, name: str, pixels: ArrayLike) -> tuple[FloatArray, NDArray[np.int32]]:
        """Return (N,) depths as `true_depths`, and (N,) indices of the geoms in view."""
        pose = self.transform_camera_to_world(name)
        rays = self.geometry.rays(np.asarray(pixels, dtype=float).reshape(-1, 2))
        lengths = np.linalg.norm(rays, axis=1)
        directions = pose.rotation.apply(rays / lengths[:, None]) if len(rays) else rays
        own_head = self.model.camera(left_name(name)).bodyid[0]
        distances, geoms = np.empty(len(rays)), np.empty(len(rays), np.int32)
        origin, geom = pose.translation, np.empty(1, np.int32)
        # One by one: mj_multiRay is faster but loses geoms (2 % of the rays here, MuJoCo 3.17).
        for index, direction in enumerate(directions):
            distances[index] = mujoco.mj_ray(
                self.model, self.data, origin, direction, SHOWN_GROUPS, 1, own_head, geom
            )
            geoms[index] = geom[0]
        return np.where(geoms >= 0, distances / lengths, np.nan), geoms

    def arm_touches(self, robot: str) -> bool:
        """Return whether an arm is in contact with anything now; truth."""
        arm = {self.model.body(f"{robot}/{body}").id for body in _ARM_BODIES}
        return bool(np.isin(self.model.geom_bodyid[self.data.contact.geom], list(arm)).any())

    def _check_name(self, name: str) -> None:
        if name not in (*self.robot_names, RIG):
            valid = ", ".join((*self.robot_names, RIG))
            raise ValueError(f"the scene has no stereo head {name!r}; it has: {valid}")


def left_name(name: str = RIG) -> str:
    """Return the name of the left camera of a robot or of the free rig."""
    return f"{name}/stereo_left"


def look_at(eye: ArrayLike, target: ArrayLike) -> RigidTransform:
    """Return the pose of a camera whose rows are level and whose axis meets a point.

    Args:
        eye: (3,) position of the camera [m], world.
        target: (3,) point on the optical axis [m], world; not straight above or below the eye.
    """
    start, end = np.asarray(eye, dtype=float), np.asarray(target, dtype=float)
    ahead = (end - start) / np.linalg.norm(end - start)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return _transform(np.column_stack([right, np.cross(ahead, right), ahead]), start)


def _joints(robot: str) -> Sequence[str]:
    return [f"{robot}/{name}_joint" for name in ARM_JOINTS]


def _transform(rotation: ArrayLike, translation: ArrayLike) -> RigidTransform:
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(rotation, (3, 3))
    matrix[:3, 3] = translation
    return RigidTransform.from_matrix(matrix)


def _add_free_rig(scene: mujoco.MjSpec) -> None:
    """Add a stereo head without housings, on a mocap body."""
    head = load_part("stereo_head")
    for geom in list(head.geoms):
        head.delete(geom)
    body = scene.worldbody.add_body(name=RIG, pos=[0.0, 0.0, 1.0], mocap=True)
    scene.attach(head, frame=body.add_frame(), prefix=f"{RIG}/")
