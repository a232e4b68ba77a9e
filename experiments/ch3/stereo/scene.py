"""Scene of ``ch3-stereo``: two rovers with stereo heads before a panel among rocks and blocks.

Everything is drawn from a seed. Pairs come from the cameras on the arms, whose joints are set
without dynamics, or from a free rig that can be put anywhere. The true camera pose and the true
depth come with them; they are for scoring alone.
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
from perception.geometry.arrays import FloatArray, ImageArray
from perception.stereo.geometry import StereoGeometry
from twin.camera import StereoConfig, StereoRig, camera_model, camera_pose

RIG = "rig"
"""Name of the free stereo head."""
FIELD_SIZE = (3.2, 3.2)  # [m]
TEXTURE_TILE = 0.5
"""Edge of the ground's noise tile [m]: a match one tile away lies outside the search up to 3 m."""
_ROUND = (48, 32)  # Facets of a drawn ellipsoid: it is within 0.1 mm of the true one.
_SEEN = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)  # Groups of geoms that cameras see.


@dataclasses.dataclass(frozen=True)
class StereoSceneConfig:
    """How much stands in a scene.

    Attributes:
        seed: Of everything that is drawn.
        rocks: Number of rocks drawn.
        blocks: Number of blocks drawn.
        texture_pixels: Edge of the textures; a power of two. Less than 2048 is too coarse for
            stereo at arm's length.
        stereo: How the cameras see.
    """

    seed: int = 0
    rocks: int = 320
    blocks: int = 30
    texture_pixels: int = 2048
    stereo: StereoConfig = dataclasses.field(default_factory=StereoConfig)


@dataclasses.dataclass(frozen=True)
class CapturedPair:
    """What a stereo head saw, and from where.

    Attributes:
        pair: (2, height, width) uint8, left and right.
        transform_camera_to_world: True pose of the left camera (x right, y down, z forward).
        joints: (4,) angles of the arm [rad]; NaN for the free rig.
    """

    pair: ImageArray
    transform_camera_to_world: RigidTransform
    joints: FloatArray


def draw_layout(seed: int) -> tuple[PanelConfig, tuple[RobotPlacement, RobotPlacement]]:
    """Draw where the panel and the two rovers stand.

    The rovers stand about 1.1 m from the panel on either side of where it faces, and look at it.

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
        yaw = angle + rng.uniform(-0.12, 0.12)
        robots.append(RobotPlacement(f"rover{index + 1}", place, yaw))
    return panel, (robots[0], robots[1])


class StereoScene:
    """A compiled scene at rest, whose arms can be set and whose cameras can be read.

    Attributes:
        config: What was asked for.
        field: The field.
        robots: The two rovers; `robot_names` are theirs.
        model: The compiled scene.
        data: Its state.
        geometry: Of every stereo pair.
    """

    def __init__(self, config: StereoSceneConfig) -> None:
        """Draw, compile and let the rovers come to rest.

        Args:
            config: Seed and contents.
        """
        self.config = config
        panel, self.robots = draw_layout(config.seed)
        self.field = FieldConfig(
            size=FIELD_SIZE,
            rocks=config.rocks,
            blocks=config.blocks,
            seed=config.seed,
            texture_pixels=config.texture_pixels,
            texture_tile=TEXTURE_TILE,
            panel=panel,
        )
        scene = build_scene(self.field, self.robots)
        _add_free_rig(scene)
        self.model = compile_scene(scene)
        quality = self.model.vis.quality
        quality.numslices, quality.numstacks = _ROUND
        self.data = settle(self.model)
        streams = np.random.SeedSequence((config.seed, 2)).spawn(len(self.robots) + 1)
        self._rigs = {
            name: (
                StereoRig(self.model, f"{name}/", config.stereo),
                np.random.default_rng(stream),
            )
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
    def panel(self) -> PanelConfig:
        """The panel's CAD, and where it truly stands."""
        assert self.field.panel is not None
        return self.field.panel

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
        """Put an arm somewhere, without dynamics; the base stays where it is.

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
        """Put the left camera of the free rig somewhere."""
        mount = self.model.camera(left_name())
        camera_in_head = _camera_transform(mount.mat0, mount.pos)
        head = transform_camera_to_world * camera_in_head.inv()
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
        """Return what a robot's stereo head or the free rig sees.

        Args:
            name: Name of the robot, or `RIG`.

        Raises:
            ValueError: If there is no such robot.
        """
        pose = self.transform_camera_to_world(name)
        joints = np.full(4, np.nan) if name == RIG else self.joints(name)
        rig, rng = self._rigs[name]
        return CapturedPair(rig.capture(self.data, (rng, rng)), pose, joints)

    def true_depths(self, name: str, pixels: ArrayLike) -> FloatArray:
        """Return the depth of what a left camera sees, exactly, by casting rays.

        Args:
            name: Name of the robot, or `RIG`; the scene as it stands now.
            pixels: (N, 2) column, row [px].

        Returns:
            (N,) along the optical axis [m]; NaN where there is only sky.
        """
        return self.true_hits(name, pixels)[0]

    def true_hits(self, name: str, pixels: ArrayLike) -> tuple[FloatArray, NDArray[np.int32]]:
        """Return (N,) depths as `true_depths`, and (N,) indices of the geoms that are seen."""
        pose = self.transform_camera_to_world(name)
        image = np.asarray(pixels, dtype=float).reshape(-1, 2)
        rays = self.geometry.rays(image)
        lengths = np.linalg.norm(rays, axis=1)
        directions = pose.rotation.apply(rays / lengths[:, None]) if len(rays) else rays
        own_head = self.model.camera(left_name(name)).bodyid[0]
        distances, geoms = np.empty(len(rays)), np.empty(len(rays), np.int32)
        origin, geom = pose.translation, np.empty(1, np.int32)
        # One by one: mj_multiRay is faster but loses geoms (2 % of the rays here, MuJoCo 3.17).
        for index, direction in enumerate(directions):
            distances[index] = mujoco.mj_ray(
                self.model, self.data, origin, direction, _SEEN, 1, own_head, geom
            )
            geoms[index] = geom[0]
        return np.where(geoms >= 0, distances / lengths, np.nan), geoms

    def arm_touches(self, robot: str) -> bool:
        """Return whether an arm, as it stands now, is in contact with anything; truth."""
        self._check_name(robot)
        arm = {self.model.body(f"{robot}/{body}").id for body in _ARM_BODIES}
        bodies = self.model.geom_bodyid[self.data.contact.geom]
        return bool(np.isin(bodies, list(arm)).any())

    def _check_name(self, name: str) -> None:
        if name not in (*self.robot_names, RIG):
            valid = ", ".join((*self.robot_names, RIG))
            raise ValueError(f"the scene has no stereo head {name!r}; it has: {valid}")


_ARM_BODIES = ("turret", "upper_arm", "forearm", "wrist", "stereo_head")


def left_name(name: str = RIG) -> str:
    """Return the name of the left camera of a robot or of the free rig."""
    return f"{name}/stereo_left"


def look_at(eye: ArrayLike, target: ArrayLike) -> RigidTransform:
    """Return the pose of a camera whose rows are level and whose axis meets a point.

    Args:
        eye: (3,) where the camera stands [m], world.
        target: (3,) where it looks [m], world; not straight above or below.
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


def _camera_transform(rotation: ArrayLike, translation: ArrayLike) -> RigidTransform:
    """Return a pose of MuJoCo's camera frame (y up, looking along -z) as that of ours."""
    return _transform(np.reshape(rotation, (3, 3)) @ np.diag([1.0, -1.0, -1.0]), translation)


def _add_free_rig(scene: mujoco.MjSpec) -> None:
    """Add a stereo head without housings, on a body that can be put anywhere."""
    head = load_part("stereo_head")
    for geom in list(head.geoms):
        head.delete(geom)
    body = scene.worldbody.add_body(name=RIG, pos=[0.0, 0.0, 1.0], mocap=True)
    scene.attach(head, frame=body.add_frame(), prefix=f"{RIG}/")
