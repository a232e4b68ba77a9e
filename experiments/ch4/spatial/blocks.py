"""Blocks about a work-piece: plan on an uncertain CAD model, then render the true view.

The planner is given every block with an error of its pose, and expands the hulls by three standard
deviations of it. The visible share of the hole is counted in rendered images of the true scene:
the hole's pixels with the blocks, over those without.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from controllers.placement.spatial.best_first import direction_tree
from controllers.placement.spatial.occluders import TargetField, expand
from controllers.placement.spatial.search import SpatialTask, best_view, rate_positions, spherical
from controllers.placement.task import Occluder, PlacementError, Target, View
from experiments.ch4.spatial.search import LENS, disc
from models.blocks import (
    CAMERA_NAME,
    Arrangement,
    Block,
    build_blocks,
    draw_arrangement,
    place_camera,
)
from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray, ImageArray
from twin.camera import renderer

SIGMA = 1e-3
"""Standard deviation of a block's estimated position along x and y [m]."""
SIGMA_YAW = np.deg2rad(1.0)
"""Standard deviation of a block's estimated rotation about the vertical [rad]."""
DEVIATIONS = 3.0
CLEARANCE = 0.04
"""Least distance of the lens' principal node from anything [m]: over half the housing's length."""
RANDOM_VIEWS = 5


@dataclasses.dataclass(frozen=True)
class BlocksTrial:
    """One drawn arrangement.

    Attributes:
        seed: Random seed of the arrangement.
        blocks: Number of blocks.
    """

    seed: int
    blocks: int


def hole_of(arrangement: Arrangement, index: int = 0) -> Target:
    """Return a hole of the work-piece as a target."""
    position, normal = np.array([[*arrangement.holes[index], 0.0], [0.0, 0.0, 1.0]])
    return disc(f"hole{index}", arrangement.hole_radius, position, normal)


def occluders_of(blocks: tuple[Block, ...]) -> list[Occluder]:
    """Return blocks as occluders."""
    return [Occluder(block.name, block.corners) for block in blocks]


def believed_blocks(blocks: Sequence[Block], rng: np.random.Generator) -> tuple[Block, ...]:
    """Return blocks as the planner estimates them: each pose with an error.

    Args:
        blocks: Blocks at their true poses.
        rng: Random generator for the errors.
    """
    believed: list[Block] = []
    for block in blocks:
        x, y, z = block.centre
        dx, dy = rng.normal(scale=SIGMA, size=2)
        yaw = block.yaw + rng.normal(scale=SIGMA_YAW)
        believed.append(Block(block.name, (x + dx, y + dy, z), block.half, yaw))
    return tuple(believed)


def margins_of(blocks: tuple[Block, ...]) -> list[float]:
    """Return the bound of each block's surface error [m]."""
    return [DEVIATIONS * (SIGMA + SIGMA_YAW * block.reach) for block in blocks]


def occupancy_of(
    blocks: tuple[Block, ...], margins: list[float]
) -> Callable[[FloatArray], FloatArray]:
    """Return P of a camera position: 1 within the clearance of a block or the face, else 0."""
    planes = [ConvexHull(block.corners).equations for block in blocks]

    def occupancy(points: FloatArray) -> FloatArray:
        taken = points[:, 2] < CLEARANCE
        for faces, margin in zip(planes, margins):
            # The largest distance to a face's plane is no more than that to the block.
            gap = (points @ faces[:, :3].T + faces[:, 3]).max(axis=1)
            taken |= gap < CLEARANCE + margin
        return taken.astype(float)

    return occupancy


class BlocksPlan(NamedTuple):
    """A view planned on an uncertain model.

    Attributes:
        believed: Blocks as the planner estimates them.
        field: The hole with the expanded hulls of these blocks.
        occupancy: Probability of occupancy of camera positions by these blocks.
        view: Best view of the hole.
    """

    believed: tuple[Block, ...]
    field: TargetField
    occupancy: Callable[[FloatArray], FloatArray]
    view: View


def plan_view(arrangement: Arrangement, rng: np.random.Generator, hole: int = 0) -> BlocksPlan:
    """Plan the view of a hole.

    Args:
        arrangement: Work-piece with its blocks at their true poses.
        rng: Random generator for the errors of the model.
        hole: Index of the hole to watch.

    Raises:
        PlacementError: If no pose sees the hole; the message gives the reasons.
    """
    believed = believed_blocks(arrangement.blocks, rng)
    margins = margins_of(believed)
    field = expand(hole_of(arrangement, hole), occluders_of(believed), margins)
    occupancy = occupancy_of(believed, margins)
    return BlocksPlan(believed, field, occupancy, best_view(SpatialTask([field], LENS, occupancy)))


class RenderedBlocks:
    """The true scene, as pictures and as counts of the hole's pixels."""

    def __init__(self, arrangement: Arrangement) -> None:
        """Compile the scene in colour, as a mask, and as a mask without blocks."""
        self._models = [
            build_blocks(arrangement).compile(),
            build_blocks(arrangement, mask=True).compile(),
            build_blocks(dataclasses.replace(arrangement, blocks=()), mask=True).compile(),
        ]
        self._data = [mujoco.MjData(model) for model in self._models]

    def picture(self, position: FloatArray, aim: FloatArray, which: int = 0) -> ImageArray:
        """Return the picture (height, width, 3) of a camera at a position that points at `aim`."""
        model, data = self._models[which], self._data[which]
        place_camera(model, data, position, aim)
        return renderer().render(model, data, CAMERA_NAME, CAMERA.width, CAMERA.height)

    def seen(self, position: FloatArray, aim: FloatArray) -> tuple[float, float]:
        """Return the visible share of the hole's pixels, and their number without occluders."""
        there, all_of_it = (
            float(self.picture(position, aim, which)[..., 0].sum()) / 255.0 for which in (1, 2)
        )
        return (there / all_of_it if all_of_it > 0.0 else 0.0), all_of_it


def random_places(
    field: TargetField, occupancy: Callable[[FloatArray], FloatArray], rng: np.random.Generator,
    count: int,
) -> FloatArray:  # fmt: skip
    """Return (count, 3) free positions before the target, in focus, drawn evenly by direction."""
    found = np.empty((0, 3))
    while len(found) < count:
        rays = rng.normal(size=(50, 3))
        rays[:, 2] = np.abs(rays[:, 2])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        places = field.to_world(rays * rng.uniform(LENS.near, LENS.far, (50, 1)))
        found = np.concatenate([found, places[occupancy(places) < 0.05]])  # noqa: PLR2004
    return found[:count]


@dataclasses.dataclass(frozen=True)
class BlocksView:
    """A planned view of the hole, and random views, scored by rendering.

    Attributes:
        optimal: Visible share of the hole from the planned view.
        random: (n,) visible share from each random view.
        pixels: Number of the hole's pixels seen from the planned view.
        random_pixels: (n,) number of the hole's pixels seen from each random view.
        cap: Angle by which the planned view is free of occlusion [rad].
        elevation: Elevation of the planned view [rad].
    """

    optimal: float
    random: FloatArray
    pixels: float
    random_pixels: FloatArray
    cap: float
    elevation: float


def run_blocks(trial: BlocksTrial) -> BlocksView | None:
    """Plan in one arrangement and score the plan and random views; None if none is possible."""
    rng = np.random.default_rng(trial.seed)
    arrangement = draw_arrangement(rng, trial.blocks)
    try:
        _, field, occupancy, view = plan_view(arrangement, rng)
    except PlacementError:
        return None
    rendered = RenderedBlocks(arrangement)
    places = [view.position, *random_places(field, occupancy, rng, RANDOM_VIEWS)]
    scores = np.array([rendered.seen(place, field.target.position) for place in places])
    return BlocksView(
        optimal=float(scores[0, 0]),
        random=scores[1:, 0],
        pixels=float(scores[0].prod()),
        random_pixels=scores[1:].prod(axis=1),
        cap=view.free_cap,
        elevation=spherical(field, view.position)[2],
    )


def rating_cloud(
    field: TargetField, occupancy: Callable[[FloatArray], FloatArray] | None, level: int = 4
) -> tuple[FloatArray, FloatArray]:
    """Return (N, 3) positions [m], world, on five shells about the target, and ratings (N,)."""
    shells = np.geomspace(LENS.near, 2.0 * LENS.near, 5)
    rays = direction_tree(level).leaves[:, None] * shells[:, None]
    places = field.to_world(rays.reshape(-1, 3))
    ratings = [view.rating for view in rate_positions(field, LENS, places, occupancy)]
    return places, np.array(ratings)
