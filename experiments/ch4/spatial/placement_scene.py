"""The scene of chapter 3 as a voxel map and with targets, for placing cameras in it.

The map is of depths cast into the compiled scene from a free stereo head all about, with
the noise of stereo; the rovers are left out of it, as mapping robots leave each other out.
"""

import numpy as np

from controllers.placement.task import Lens, Target
from experiments.ch3.stereo.scene import PIXEL_SIGMA, RIG, StereoScene, look_at
from models.datasheets import CAMERA, INCH
from perception.geometry.pinhole import Frustum
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap

BOX = ((-1.5, -1.5, -0.2), (1.5, 1.5, 0.9))
"""Corners of the map [m], world."""
REACH = (0.25, 2.0)
"""Nearest and farthest depth that enters the map [m], as for the mapping robots."""
COLUMNS, ROWS = 170, 164
"""Rays of a view: every third pixel."""
EYES, SEEN = (-1.1, 1.1), (-0.9, 0.9)
"""Bounds along x and y of the head and of the points on its optical axis [m]."""
NOT_DOWN = 0.3
"""Least horizontal distance from the head to the point on its axis [m]."""
SIDES = 16
"""Corners of the polygon about a round target."""


def map_scene(
    scene: StereoScene, views: int, rng: np.random.Generator, resolution: float = 0.01
) -> VoxelMap:
    """Return a map of a scene.

    Args:
        scene: Scene that is mapped.
        views: Number of views.
        rng: Random generator for the views and the noise.
        resolution: Side of a voxel [m].
    """
    voxels = VoxelMap(VoxelGrid(resolution, *BOX))
    for _ in range(views):
        add_view(voxels, scene, rng)
    return voxels


def add_view(voxels: VoxelMap, scene: StereoScene, rng: np.random.Generator) -> None:
    """Add one view from anywhere to a map.

    Args:
        voxels: Map that receives the view.
        scene: Scene that is viewed.
        rng: Random generator for the view and the noise.
    """
    eye = np.append(rng.uniform(*EYES, 2), rng.uniform(0.4, 0.85))
    while np.linalg.norm(seen_at := rng.uniform(*SEEN, 2) - eye[:2]) < NOT_DOWN:
        pass
    scene.set_rig(look_at(eye, [*(eye[:2] + seen_at), 0.05]))
    g = scene.geometry
    pixels = g.pixel_grid(COLUMNS, ROWS).reshape(-1, 2)
    depth, geoms = scene.true_hits(RIG, pixels)
    rovers = [scene.model.body(f"{name}/chassis").id for name in scene.robot_names]
    of_rover = np.isin(scene.model.body_rootid[scene.model.geom_bodyid[geoms]], rovers)
    seen = np.isfinite(depth) & ~of_rover
    true = g.rays(pixels)[seen] * depth[seen, None]
    sigma = np.array(PIXEL_SIGMA)
    noisy = g.points(g.project(true) + sigma * rng.standard_normal(true.shape))
    kept = (noisy[:, 2] > REACH[0]) & (noisy[:, 2] < REACH[1])
    pose = scene.transform_camera_to_world(RIG)
    turn = pose.rotation.as_matrix()
    frustum = Frustum(*g.intrinsics, near=0.1, far=REACH[1] + 0.1)
    voxels.insert(
        pose,
        frustum.resized(COLUMNS, ROWS),
        pose.apply(noisy[kept]),
        turn @ g.covariance(noisy[kept], sigma) @ turn.T,
    )


def panel_targets(scene: StereoScene) -> list[Target]:
    """Return the panel's markers as targets at their true poses."""
    to_world = scene.transform_panel_to_world
    normal = to_world.rotation.apply([0.0, 0.0, 1.0])
    turn = 2.0 * np.pi * np.arange(SIDES) / SIDES
    found = []
    for number, (marker, point) in enumerate(
        zip(scene.panel.markers, scene.panel.marker_points, strict=True)
    ):
        # The corners of the polygon lie outside of the circle, so that it holds all of it.
        radius = marker.radius / np.cos(np.pi / SIDES)
        ring = radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(SIDES)])
        found.append(
            Target(f"marker {number}", to_world.apply(point), normal, to_world.rotation.apply(ring))
        )
    return found


def head_lens(near: float = 5.0 * INCH, far: float = 0.6) -> Lens:
    """Return the stereo head's left camera as a lens; near is the thesis' 5 inches."""
    return Lens(CAMERA.field_of_view[0], CAMERA.width, near, far)
