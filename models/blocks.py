"""A work-piece with round holes and simple blocks about it (thesis figure 4-12).

The world's origin is the middle of the first hole, in the work-piece's upper face; z points up. The
holes are painted: dark discs that stand out of the face by a hair.
"""

import dataclasses
import itertools
import math

import mujoco
import numpy as np

from models.datasheets import CAMERA
from models.work_piece import HOLES
from perception.geometry.arrays import FloatArray

CAMERA_NAME = "view"
THICKNESS = 0.02
"""Thickness of the work-piece; the ground is that much below its face [m]."""
_PAINT = 1e-4  # Height of a hole's disc above the face [m].


@dataclasses.dataclass(frozen=True)
class Block:
    """An upright box.

    Attributes:
        name: Name of the block's geom.
        centre: (x, y, z) [m], world.
        half: Half of its edges in its own frame [m].
        yaw: Angle of that frame about the vertical [rad].
    """

    name: str
    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    yaw: float = 0.0

    def __post_init__(self) -> None:
        """Refuse blocks without a volume.

        Raises:
            ValueError: Naming the block.
        """
        if not all(math.isfinite(number) for number in (*self.centre, self.yaw)):
            raise ValueError(f"block {self.name!r}: its pose is not finite")
        if not all(0.0 < edge < math.inf for edge in self.half):
            raise ValueError(f"block {self.name!r}: half edges {self.half}, expected above 0 m")

    @property
    def corners(self) -> FloatArray:
        """(8, 3) [m], world."""
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * self.half
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(signs @ turn.T + self.centre, dtype=np.float64)

    @property
    def reach(self) -> float:
        """Radius of the upright cylinder about it [m]."""
        return math.hypot(self.half[0], self.half[1])


@dataclasses.dataclass(frozen=True)
class Arrangement:
    """A work-piece and the blocks about it.

    Attributes:
        blocks: Blocks with different names.
        holes: (x, y) of the holes' middles [m]; the first is at the origin.
        hole_radius: Radius of the holes [m].
        half: Half length and width of the work-piece [m].
    """

    blocks: tuple[Block, ...]
    holes: tuple[tuple[float, float], ...] = HOLES
    hole_radius: float = 0.008
    half: tuple[float, float] = (0.10, 0.07)

    def __post_init__(self) -> None:
        """Refuse two blocks of one name, and holes that hang over the edge.

        Raises:
            ValueError: Naming the offender.
        """
        names = [block.name for block in self.blocks]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"block {name!r}: there are two of this name")
        for place in self.holes:
            reach = np.abs(place) + self.hole_radius
            if not (self.hole_radius > 0.0 and np.all(reach <= self.half)):
                raise ValueError(f"hole at {place}: does not lie on the work-piece {self.half} m")


WALL_EDGE = 0.1
"""How far the expanded upper edge of `FIGURE_4_12`'s wall is from the hole [m]."""


def _figure_4_12() -> Arrangement:
    """Return a long wall whose edge, expanded by the hole, is at 60 deg behind the hole.

    The other blocks are so low, or so far off, that none is nearer than 60 deg to the camera which
    looks from 60 deg above the opposite side.
    """
    radius, thick = Arrangement.hole_radius, 0.01
    face = -(0.5 * WALL_EDGE + radius)
    top = WALL_EDGE * math.sin(math.pi / 3.0)
    middle, high = 0.5 * (top - THICKNESS), 0.5 * (top + THICKNESS)
    low = -THICKNESS
    return Arrangement(
        (
            Block("wall", (face - thick, 0.0, middle), (thick, 0.25, high)),
            Block("left", (0.0, 0.085, 0.5 * (0.02 + low)), (0.015, 0.015, 0.5 * (0.02 - low))),
            Block(
                "right",
                (-0.02, -0.105, 0.5 * (0.045 + low)),
                (0.02, 0.02, 0.5 * (0.045 - low)),
            ),
            Block("tower", (-0.01, 0.165, 0.5 * (0.09 + low)), (0.02, 0.02, 0.5 * (0.09 - low))),
        )
    )


FIGURE_4_12 = _figure_4_12()


def draw_arrangement(rng: np.random.Generator, count: int) -> Arrangement:
    """Draw blocks about the first hole, none over it and none in another.

    Args:
        rng: Source of randomness.
        count: Number of blocks, 30 mm to 150 mm off; edges of 15 mm to 60 mm, up to 120 mm high.

    Raises:
        ValueError: If so many do not fit.
    """
    made: list[Block] = []
    for _ in range(2000):
        if len(made) == count:
            return Arrangement(tuple(made), holes=((0.0, 0.0),))
        half = rng.uniform(0.0075, 0.03, 2)
        top = rng.uniform(0.02, 0.12)
        angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.03, 0.15)
        place = far * np.array([np.cos(angle), np.sin(angle)])
        block = Block(
            f"block {len(made)}",
            (float(place[0]), float(place[1]), float(0.5 * (top - THICKNESS))),
            (float(half[0]), float(half[1]), float(0.5 * (top + THICKNESS))),
            float(rng.uniform(-np.pi, np.pi)),
        )
        free = far - block.reach > Arrangement.hole_radius + 0.01
        apart = (math.dist(block.centre[:2], b.centre[:2]) - block.reach - b.reach for b in made)
        if free and all(gap > 0.0 for gap in apart):
            made.append(block)
    raise ValueError(f"{count} blocks: only {len(made)} fit about the hole")


def build_blocks(arrangement: Arrangement, mask: bool = False) -> mujoco.MjSpec:
    """Compose the scene with a camera ``view`` of the data sheet's size, which may be moved.

    Geoms are ``ground``, ``workpiece``, ``hole0`` and so on, and the blocks by their names.

    Args:
        arrangement: Work-piece and blocks.
        mask: Paint the first hole red and all else black, without shade: the red of an image is
            what one sees of the hole.
    """
    scene = mujoco.MjSpec()
    scene.modelname = "blocks"
    scene.stat.extent, scene.stat.center = 1.0, [0.0, 0.0, 0.0]
    scene.visual.map.znear, scene.visual.map.zfar = 0.005, 50.0
    scene.visual.quality.offsamples = 4
    light = scene.visual.headlight
    light.ambient = [1.0] * 3 if mask else [0.35] * 3
    light.diffuse = [0.0] * 3 if mask else [0.25] * 3
    light.specular = [0.0] * 3
    if not mask:
        scene.worldbody.add_light(
            name="lamp", pos=[0.4, -0.5, 1.2], dir=[-0.3, 0.4, -1.0], diffuse=[0.6] * 3,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, specular=[0.0] * 3,
        )  # fmt: skip
    colours = itertools.cycle(
        [[0.75, 0.45, 0.2, 1], [0.25, 0.45, 0.7, 1], [0.35, 0.6, 0.35, 1], [0.7, 0.65, 0.3, 1]]
    )
    black = [0.0, 0.0, 0.0, 1.0]

    def box(name: str, centre: object, half: object, yaw: float, colour: list[float]) -> None:
        scene.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half,
            quat=[math.cos(yaw / 2.0), 0.0, 0.0, math.sin(yaw / 2.0)],
            rgba=black if mask else colour,
        )  # fmt: skip

    box("ground", [0, 0, -THICKNESS - 0.01], [1.0, 1.0, 0.01], 0.0, [0.55, 0.55, 0.53, 1])
    box("workpiece", [0.02, 0, -THICKNESS / 2], [*arrangement.half, THICKNESS / 2], 0.0,
        [0.85, 0.85, 0.88, 1])  # fmt: skip
    for block in arrangement.blocks:
        box(block.name, block.centre, block.half, block.yaw, next(colours))
    for index, place in enumerate(arrangement.holes):
        paint = [1.0, 0.0, 0.0, 1.0] if mask and index == 0 else black
        scene.worldbody.add_geom(
            name=f"hole{index}", type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=[*place, 0.0],
            size=[arrangement.hole_radius, _PAINT, 0.0],
            rgba=paint if mask else [0.05, 0.05, 0.06, 1.0],
        )  # fmt: skip
    scene.worldbody.add_camera(
        name=CAMERA_NAME,
        pos=[0.0, 0.0, 0.3],
        resolution=[CAMERA.width, CAMERA.height],
        sensor_size=[CAMERA.sensing_width, CAMERA.sensing_height],
        focal_length=[CAMERA.focal_length, CAMERA.focal_length],
    )
    return scene


def camera_axes(position: FloatArray, aim: FloatArray) -> FloatArray:
    """Return (3, 3) right, up and backward axes of a camera as columns, its top towards z.

    Args:
        position: (3,) position of the camera [m], world.
        aim: (3,) point that the camera looks at [m], world.
    """
    back = np.asarray(position, dtype=float) - np.asarray(aim, dtype=float)
    back /= np.linalg.norm(back)
    up = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 0.999 else np.array([-1.0, 0.0, 0.0])  # noqa: PLR2004
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(back, right), back])


def place_camera(
    model: mujoco.MjModel, data: mujoco.MjData, position: FloatArray, aim: FloatArray
) -> None:
    """Move the camera ``view`` and let it look at a point, its top as near to z as can be.

    Args:
        model: Compiled model from `build_blocks`.
        data: State of the model; positions are computed.
        position: (3,) [m], world.
        aim: (3,) [m], world.
    """
    camera = model.camera(CAMERA_NAME).id
    model.cam_pos[camera] = position
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, camera_axes(position, aim).ravel())
    model.cam_quat[camera] = quaternion
    mujoco.mj_forward(model, data)
