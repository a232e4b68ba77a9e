"""A rover with BRAID before a target that blocks hide: the scene, and what its camera sees."""

import dataclasses

import mujoco
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from experiments.appe.mechanism.bench import BraidBench
from models.blocks import Block
from models.braid.build import BraidConfig, build_rover
from models.compose import FLAT, RobotPlacement
from models.datasheets import CAMERA
from models.render_pictures import Shot, take
from perception.geometry.arrays import FloatArray, ImageArray
from twin.camera import camera_model, camera_pose

ROVER = "rover1/"
CAMERA_NAME = f"{ROVER}stereo_left"
TARGET_RADIUS = 0.01
"""Radius of the disc on the board [m]."""
FACING = np.array([0.0, -1.0, 0.0])
"""Normal of the target: it faces the rover, which looks along y."""
SETTLE = 1.0
_BLOCK_GROUP = 1
_HIDDEN = {"contype": 0, "conaffinity": 0}
_COLOURS = ([0.75, 0.45, 0.2, 1.0], [0.25, 0.45, 0.7, 1.0], [0.35, 0.6, 0.35, 1.0])


@dataclasses.dataclass(frozen=True)
class PlacementSetting:
    """Target and blocks before the rover.

    Attributes:
        target: (3,) middle of the disc [m], world.
        blocks: Upright blocks on the ground between rover and target.
    """

    target: FloatArray
    blocks: tuple[Block, ...]


def draw_setting(rng: np.random.Generator, count: int = 2) -> PlacementSetting:
    """Draw a target, and blocks that stand about the line to it from the arm at home.

    Args:
        rng: Random generator for target and blocks.
        count: Number of blocks.
    """
    target = np.array([rng.uniform(-0.08, 0.08), rng.uniform(0.48, 0.56), rng.uniform(0.28, 0.4)])
    blocks = []
    for index in range(count):
        wide, deep = (float(edge) for edge in rng.uniform([0.015, 0.01], [0.04, 0.02]))
        high = 0.5 * float(rng.uniform(0.30, 0.42))
        y = 0.29 + 0.08 * index + rng.uniform(-0.01, 0.01)
        x = target[0] + rng.uniform(-0.07, 0.07)
        centre = (float(x), float(y), high)
        blocks.append(Block(f"block{index}", centre, (wide, deep, high)))
    return PlacementSetting(target, tuple(blocks))


class RoverView:
    """The rover with BRAID in a setting, at rest.

    Attributes:
        bench: Simulation of the rover with BRAID.
        transform_base_to_world: Pose of BRAID's base, the rover at rest with all legs short.
        transform_camera_to_tip: Pose of the left camera on the last platform.
        intrinsics: Intrinsics of the left camera.
    """

    def __init__(self, setting: PlacementSetting, stages: int) -> None:
        """Build the scene and let the rover settle."""
        scene = build_rover(BraidConfig(stages), FLAT, RobotPlacement())
        _add_setting(scene, setting)
        model = scene.compile()
        self.bench = BraidBench(model, stages, ROVER)
        self._target = model.geom("target").id
        self._camera = model.camera(CAMERA_NAME).id
        self.bench.step(SETTLE)
        self.transform_base_to_world = self._site(f"{ROVER}braid_base")
        tip = self._site(f"{ROVER}tip")
        self.transform_camera_to_tip = tip.inv() * self.transform_camera_to_world()
        self.intrinsics = camera_model(model, CAMERA_NAME)

    def transform_camera_to_world(self) -> RigidTransform:
        """Return the true pose of the left camera."""
        rotation, place = camera_pose(self.bench.data, self._camera)
        return RigidTransform.from_components(place, Rotation.from_matrix(rotation))

    def picture(self) -> ImageArray:
        """Return the left camera's image (height, width, 3)."""
        with mujoco.Renderer(self.bench.model, CAMERA.height, CAMERA.width) as renderer:
            renderer.update_scene(self.bench.data, CAMERA_NAME, self._option(True))
            return renderer.render().copy()

    def seen(self) -> tuple[float, float]:
        """Return the visible share of the target's pixels, and their number if nothing hid it.

        A target that is cut off by the picture's edge counts with what is in the picture only.
        """
        counts = []
        with mujoco.Renderer(self.bench.model, CAMERA.height, CAMERA.width) as renderer:
            renderer.enable_segmentation_rendering()
            for blocks in (True, False):
                renderer.update_scene(self.bench.data, CAMERA_NAME, self._option(blocks))
                ids = renderer.render()
                counts.append(float(np.count_nonzero(ids[..., 0] == self._target)))
        return (counts[0] / counts[1] if counts[1] else 0.0), counts[1]

    def from_outside(self) -> ImageArray:
        """Return (480, 640, 3) rover, blocks and target from the side."""
        shot = Shot((0.0, 0.28, 0.22), 1.15, 155.0, -20.0)
        return take(self.bench.model, self.bench.data, shot, (640, 480))

    def _option(self, blocks: bool) -> mujoco.MjvOption:
        option = mujoco.MjvOption()
        option.geomgroup[_BLOCK_GROUP] = int(blocks)
        option.geomgroup[3:] = 0
        option.sitegroup[:] = 0
        return option

    def _site(self, name: str) -> RigidTransform:
        site = self.bench.data.site(name)
        return RigidTransform.from_components(
            site.xpos, Rotation.from_matrix(site.xmat.reshape(3, 3))
        )


def _add_setting(scene: mujoco.MjSpec, setting: PlacementSetting) -> None:
    board = setting.target - FACING * 0.006
    scene.worldbody.add_geom(
        name="board", type=mujoco.mjtGeom.mjGEOM_BOX, pos=board, size=[0.06, 0.005, 0.06],
        rgba=[0.85, 0.85, 0.88, 1.0], group=2, **_HIDDEN,
    )  # fmt: skip
    post = 0.5 * (setting.target[2] - 0.06)
    scene.worldbody.add_geom(
        name="post", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[board[0], board[1], post],
        size=[0.008, 0.004, post], rgba=[0.55, 0.57, 0.60, 1.0], group=2, **_HIDDEN,
    )  # fmt: skip
    scene.worldbody.add_geom(
        name="target", type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=setting.target,
        size=[TARGET_RADIUS, 5e-4, 0.0], quat=[np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0],
        rgba=[0.85, 0.1, 0.1, 1.0], group=2, **_HIDDEN,
    )  # fmt: skip
    for block, colour in zip(setting.blocks, _COLOURS * len(setting.blocks)):
        turn = [np.cos(block.yaw / 2.0), 0.0, 0.0, np.sin(block.yaw / 2.0)]
        scene.worldbody.add_geom(
            name=block.name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=block.centre, size=block.half,
            quat=turn, rgba=colour, group=_BLOCK_GROUP, **_HIDDEN,
        )  # fmt: skip
