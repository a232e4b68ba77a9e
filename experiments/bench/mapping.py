"""Our voxel maps beside OctoMap: same clouds, same resolution, one thread each, in the same run."""

# pyright: reportAttributeAccessIssue=false

import dataclasses
import itertools
import time
from collections.abc import Callable

import numpy as np
import pyoctomap
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.bench.bench_options import Options
from experiments.ch3.stereo.scene import HEAD, PIXEL_SIGMA, look_at
from experiments.harness.output import Output
from experiments.harness.timing import compare, timed
from perception.geometry.arrays import FloatArray
from perception.geometry.pinhole import Frustum
from perception.voxels.dense import DenseVoxelMap
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap, VoxelMapConfig
from perception.voxels.occupancy import State, UpdateModel
from perception.voxels.views import RAYS, view_counts

WIDTH, HEIGHT = 320, 240
MAX_DEPTH = 1.6
"""Points farther away are left out [m], as a stereo rig does."""
GROUND = 0.0033
"""Height of the ground [m]: inside a voxel, not on a face, where its voxel would be a toss."""
CLOUDS, QUICK_CLOUDS, FINE_CLOUDS = 20, 3, 4
"""Clouds inserted; fewer at 5 mm, where each takes OctoMap seconds."""
VIEWS = 20
"""Number of views that are evaluated, as candidates are."""
BOX = ((-1.5, -1.5, -0.25), (1.5, 1.5, 1.1))
FINE_BOX = ((-0.75, -0.75, -0.2), (0.75, 0.75, 1.3))
"""Box of 1.5 m in each direction, for voxels of 1 mm."""
MEMORY = 1e9
OCTOMAP_CONFIG = VoxelMapConfig(UpdateModel())
NOTHING = 1e-6
"""Range of rays that end where they start [m], whose time is that of the call."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """Ground at z = GROUND with spheres and upright boxes on it.

    Attributes:
        spheres: (n, 4) centre and radius [m].
        boxes: (m, 6) lower and upper corner [m].
    """

    spheres: FloatArray
    boxes: FloatArray

    @classmethod
    def random(cls, generator: np.random.Generator, radius: float = 0.45) -> "Scene":
        """Scatter four spheres and four boxes around the origin.

        Args:
            generator: Random generator.
            radius: Radius of the disc that holds their centres [m].
        """
        where = _in_disc(generator, 8, radius)
        size = generator.uniform(0.04, 0.12, 4)
        spheres = np.column_stack([where[:4], 0.7 * size, size])
        half = generator.uniform(0.03, 0.12, (4, 2))
        tall = generator.uniform(0.05, 0.3, (4, 1))
        low = np.column_stack([where[4:] - half, np.zeros(4)])
        return cls(spheres, np.hstack([low, where[4:] + half, tall]))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the signed distance of points to the nearest surface [m], negative inside.

        Args:
            points: (N, 3) [m].
        """
        nearest = points[:, 2] - GROUND
        for *centre, radius in self.spheres:
            nearest = np.minimum(nearest, np.linalg.norm(points - centre, axis=1) - radius)
        for box in self.boxes:
            beyond = np.abs(points - (box[:3] + box[3:]) / 2) - (box[3:] - box[:3]) / 2
            outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
            nearest = np.minimum(nearest, outside + np.minimum(beyond.max(axis=1), 0.0))
        return nearest

    def cast(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """Return how far along each ray the first surface is, in lengths of the direction.

        Args:
            origin: (3,) [m].
            directions: (N, 3).

        Returns:
            (N,), infinite where there is none.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            ground = (GROUND - origin[2]) / directions[:, 2]
            nearest = np.where(ground > 0.0, ground, np.inf)
            for *centre, radius in self.spheres:
                offset = origin - centre
                a = np.sum(directions**2, axis=1)
                b = directions @ offset
                root = np.sqrt(b * b - a * (offset @ offset - radius**2))
                hit = (-b - root) / a
                nearest = np.where(hit > 0.0, np.minimum(nearest, hit), nearest)
            for box in self.boxes:
                sides = np.stack([(box[:3] - origin) / directions, (box[3:] - origin) / directions])
                enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
                hit = (enter > 0.0) & (enter <= leave)
                nearest = np.where(hit, np.minimum(nearest, enter), nearest)
        return nearest


@dataclasses.dataclass(frozen=True)
class Cloud:
    """Points of one view.

    Attributes:
        transform_camera_to_world: Pose of the camera.
        points: (N, 3) measured [m], world.
        covariances: (N, 3, 3) [m^2], world.
        truth: (N, 3) true points of the surface on the same rays [m], world.
    """

    transform_camera_to_world: RigidTransform
    points: FloatArray
    covariances: FloatArray
    truth: FloatArray


def random_view(generator: np.random.Generator) -> RigidTransform:
    """Return a view of the scene's middle from a ring around it."""
    angle = generator.uniform(0.0, 2.0 * np.pi)
    radius, height = generator.uniform(0.8, 1.05), generator.uniform(0.4, 0.8)
    position = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
    target = np.append(_in_disc(generator, 1, 0.2)[0], 0.05)
    return look_at(position, target)


def see(scene: Scene, pose: RigidTransform, generator: np.random.Generator) -> Cloud:
    """Return a cloud of at most 320 x 240 points with the noise that the stereo head has.

    The points are every so many pixels of the head's image, over its whole field of view.

    Args:
        scene: Scene in view.
        pose: Transform from the camera to the world.
        generator: Random generator of the noise.
    """
    rays = HEAD.rays(HEAD.pixel_grid(WIDTH, HEIGHT)).reshape(-1, 3)
    depth = scene.cast(pose.translation, pose.rotation.apply(rays))
    seen = depth < MAX_DEPTH
    true = rays[seen] * depth[seen, None]
    sigma = np.array(PIXEL_SIGMA)
    noisy = HEAD.points(HEAD.project(true) + sigma * generator.standard_normal(true.shape))
    turn = pose.rotation.as_matrix()
    covariances = np.ascontiguousarray(turn @ HEAD.covariance(noisy, sigma) @ turn.T)
    points = np.ascontiguousarray(pose.apply(noisy))
    return Cloud(pose, points, covariances, pose.apply(true))


def _in_disc(generator: np.random.Generator, count: int, radius: float) -> FloatArray:
    angle = generator.uniform(0.0, 2.0 * np.pi, count)
    length = radius * np.sqrt(generator.uniform(0.0, 1.0, count))
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])


def bench_mapping(options: Options, output: Output) -> None:
    """Insert the same clouds into our maps and into OctoMap, and view both from the same poses.

    Times are processor time. The time to hand the points or a ray to OctoMap from Python is
    measured by rays of no length, and subtracted from its time.

    Args:
        options: ``quick`` takes fewer clouds and leaves the finer maps out.
        output: Receives ``octomap_speedup/*``, ``surface_within_one_voxel/*`` and more.
    """
    generator = np.random.default_rng(options.job_seeds(1, 1)[0])
    scene = Scene.random(generator)
    count = QUICK_CLOUDS if options.quick else CLOUDS
    clouds = [see(scene, random_view(generator), generator) for _ in range(count)]
    output.measure("mapping/points", sum(len(cloud.points) for cloud in clouds))
    rounds = 2 if options.quick else 3
    _exact(clouds, rounds, output)
    speedup = _insert(fast_map, 0.01, clouds, rounds, "fast_1cm", output)
    output.check("mapping, fast at 1 cm over OctoMap", speedup, ">= 40", speedup >= 40.0)
    ours, peer = fast_map(0.01, clouds), octomap(0.01, clouds)
    _views(ours, peer, [random_view(generator) for _ in range(VIEWS)], output)
    _quality(ours, peer, scene, clouds, output, "1cm", 0.97)
    if not options.quick:
        _insert(fast_map, 0.005, clouds[:FINE_CLOUDS], 1, "fast_5mm", output)
        fine = octomap(0.005, clouds[:FINE_CLOUDS])
        _quality(
            fast_map(0.005, clouds[:FINE_CLOUDS]), fine, scene, clouds[:FINE_CLOUDS], output,
            "5mm_few_views", None,
        )  # fmt: skip
        _quality(fast_map(0.005, clouds), None, scene, clouds, output, "5mm", 0.87)
        _millimetre(scene, clouds, output)


def frustum() -> Frustum:
    """Return the field of view of the clouds."""
    view = Frustum(*HEAD.intrinsics, near=0.1, far=MAX_DEPTH + 0.1)
    return view.resized(WIDTH, HEIGHT)


def fast_map(
    resolution: float,
    clouds: list[Cloud],
    config: VoxelMapConfig = OCTOMAP_CONFIG,
    box: tuple[tuple[float, float, float], tuple[float, float, float]] = BOX,
) -> VoxelMap:
    """Return our sparse map of clouds.

    Args:
        resolution: Edge of a voxel [m].
        clouds: Clouds to insert.
        config: Properties of the map; unless given, OctoMap's update model.
        box: Lower and upper corner of the map [m].
    """
    voxels = VoxelMap(VoxelGrid(resolution, *box), config)
    insert_clouds(voxels, clouds)
    return voxels


def insert_clouds(voxels: VoxelMap, clouds: list[Cloud]) -> None:
    """Insert clouds into a sparse map, one after the other."""
    view = frustum()
    for cloud in clouds:
        voxels.insert(cloud.transform_camera_to_world, view, cloud.points, cloud.covariances)


def exact_map(resolution: float, clouds: list[Cloud]) -> DenseVoxelMap:
    """Return our dense map of clouds."""
    voxels = DenseVoxelMap(VoxelGrid(resolution, *BOX))
    for cloud in clouds:
        voxels.insert(cloud.transform_camera_to_world.translation, cloud.points)
    return voxels


def octomap(resolution: float, clouds: list[Cloud], max_range: float = -1.0) -> pyoctomap.OcTree:
    """Return OctoMap's map of clouds."""
    tree = pyoctomap.OcTree(resolution)
    for cloud in clouds:
        origin = np.array(cloud.transform_camera_to_world.translation)
        tree.insertPointCloud(cloud.points, origin, max_range)
    return tree


def octomap_counts(tree: pyoctomap.OcTree) -> dict[State, int]:
    """Return how many voxels OctoMap holds as free and as occupied; larger leaves hold many."""
    counts = {State.FREE: 0, State.OCCUPIED: 0}
    for leaf in tree.begin_leafs():
        state = State.OCCUPIED if tree.isNodeOccupied(leaf) else State.FREE
        counts[state] += round(leaf.getSize() / tree.getResolution()) ** 3
    return counts


def octomap_occupied(tree: pyoctomap.OcTree, grid: VoxelGrid) -> NDArray[np.int64]:
    """Return the indices in a grid (M, 3) of OctoMap's occupied voxels."""
    found = []
    for leaf in tree.begin_leafs():
        if tree.isNodeOccupied(leaf):
            side = round(leaf.getSize() / tree.getResolution())
            steps = (np.arange(side) - (side - 1) / 2) * tree.getResolution()
            offsets = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
            found.append(np.array(leaf.getCoordinate()) + offsets)
    cells, inside = grid.cells(np.concatenate(found))
    return cells[inside]


def _speedup(name: str, times: dict, call: float, output: Output) -> float:
    """Store both times, and return their ratio without the cost of OctoMap's calls."""
    peer = times["peer_s"]["median"] - call
    output.measure(f"mapping_s/{name}/ours", times["ours_s"])
    output.measure(f"mapping_s/{name}/octomap", times["peer_s"])
    output.measure(f"mapping_s/{name}/octomap_call", call)
    speedup = peer / times["ours_s"]["median"]
    output.measure(f"octomap_speedup/{name}", speedup)
    return speedup


def _insert(
    make: Callable[[float, list[Cloud]], object],
    resolution: float,
    clouds: list[Cloud],
    rounds: int,
    name: str,
    output: Output,
) -> float:
    """Time the same map by ours and by OctoMap, and return the speed-up."""
    times = compare(lambda: make(resolution, clouds), lambda: octomap(resolution, clouds), rounds)
    call = timed(lambda: octomap(resolution, clouds, NOTHING))
    return _speedup(name, times, call, output)


def _exact(clouds: list[Cloud], rounds: int, output: Output) -> None:
    speedup = _insert(exact_map, 0.01, clouds, rounds, "exact_1cm", output)
    output.check("mapping, exact at 1 cm over OctoMap", speedup, ">= 5", speedup >= 5.0)
    ours, peer = exact_map(0.01, clouds).counts(), octomap_counts(octomap(0.01, clouds))
    for state in (State.OCCUPIED, State.FREE):
        name = state.name.lower()
        output.measure(f"exact_voxels/{name}", {"ours": ours[state], "octomap": peer[state]})
        difference = ours[state] - peer[state]
        output.check(f"exact: {name} voxels less OctoMap's", difference, "== 0", difference == 0)


def _views(ours: VoxelMap, peer: pyoctomap.OcTree, poses: list, output: Output) -> None:
    """Time our evaluation of views beside OctoMap's casting of the same rays."""
    view = frustum().resized(*RAYS)
    rays = view.rays(view.pixel_grid()).reshape(-1, 3)
    reach = np.linalg.norm(rays, axis=1)
    end = np.zeros(3)

    jobs = [
        (np.array(pose.translation), turned, far)
        for pose in poses
        for turned, far in zip(pose.rotation.apply(rays), view.far * reach)
    ]

    def evaluate() -> list[FloatArray]:
        return [view_counts(ours, pose, view).depths.ravel() for pose in poses]

    def cast(jobs: list[tuple[FloatArray, FloatArray, float]] = jobs) -> None:
        for origin, direction, far in jobs:
            peer.castRay(origin, direction, end, True, far)

    call = timed(lambda: cast([(origin, direction, NOTHING) for origin, direction, _ in jobs]))
    times = compare(evaluate, cast, 5)
    speedup = _speedup("views", times, call, output)
    output.check("mapping, view evaluation over OctoMap's rays", speedup, ">= 20", speedup >= 20.0)
    output.measure("views/ms_each", 1e3 * times["ours_s"]["median"] / len(poses))
    found = np.full(len(jobs), np.inf)
    for i, (origin, direction, far) in enumerate(jobs):
        if peer.castRay(origin, direction, end, True, far):
            found[i] = np.linalg.norm(end - origin) / far * view.far
    both = np.concatenate(evaluate()), found
    stopped = np.isfinite(both[0]) & np.isfinite(both[1])
    same = float(np.mean(np.isfinite(both[0]) == np.isfinite(both[1])))
    output.measure("views/same_verdict", same)
    output.measure(
        "views/depth_difference_m", float(np.median(np.abs(both[0][stopped] - both[1][stopped])))
    )


def _quality(
    ours: VoxelMap,
    peer: pyoctomap.OcTree | None,
    scene: Scene,
    clouds: list[Cloud],
    output: Output,
    name: str,
    bound: float | None,
) -> None:
    """Compare the occupied voxels with the true surface, in both directions."""
    grid = ours.grid
    seen, inside = grid.cells(np.concatenate([cloud.truth for cloud in clouds]))
    true = np.unique(seen[inside], axis=0)
    maps = {"": ours.occupied_cells()[0]}
    if peer is not None:
        maps["octomap/"] = octomap_occupied(peer, grid)
    for whose, cells in maps.items():
        off = np.abs(scene.distance(grid.centres(cells)))
        within = float(np.mean(off <= grid.resolution))
        output.measure(f"surface_within_one_voxel/{whose}{name}", within)
        strict, near = recall(true, cells, grid.shape)
        output.measure(f"surface_recall/{whose}{name}", strict)
        output.measure(f"surface_recall_within_one_voxel/{whose}{name}", near)
        if bound is not None and not whose:
            text = f"mapping, occupied within a voxel of the surface, {name}"
            output.check(text, within, f">= {bound:g}", within >= bound)
    _consistency(ours, scene, output, name)


def _consistency(ours: VoxelMap, scene: Scene, output: Output, name: str) -> None:
    """Check the surface estimates' errors against their covariances."""
    error = normalised_error(ours, scene)
    output.measure(f"surface_nees/{name}", float(np.mean(error)))
    output.measure(f"surface_nees/{name}_over_9", float(np.mean(error > 9.0)))
    text = f"mapping, normalised squared error of the surface, {name}"
    output.check(text, float(np.mean(error)), "0.5 to 2", bool(0.5 <= np.mean(error) <= 2.0))


def recall(
    true: NDArray[np.int64], cells: NDArray[np.int64], shape: tuple[int, int, int]
) -> tuple[float, float]:
    """Return the fractions of true voxels that are found, and that are or neighbour a found one."""
    size = np.array(shape) + 2
    found = np.ravel_multi_index(tuple((cells + 1).T), tuple(size))
    near = np.zeros(len(true), dtype=bool)
    for step in itertools.product((0, 1, 2), repeat=3):
        near |= np.isin(np.ravel_multi_index(tuple((true + step).T), tuple(size)), found)
    exact = np.isin(np.ravel_multi_index(tuple((true + 1).T), tuple(size)), found)
    return float(exact.mean()), float(near.mean())


def normalised_error(voxels: VoxelMap, scene: Scene) -> FloatArray:
    """Return (M,) squared distance of each surface estimate from the truth over its variance.

    Both are taken across the true surface: along it, an estimate has no true place.
    """
    surface = voxels.surface()
    distance = scene.distance(surface.means)
    steps = 1e-5 * np.eye(3)
    ahead = np.stack([scene.distance(surface.means + step) for step in steps], axis=1)
    behind = np.stack([scene.distance(surface.means - step) for step in steps], axis=1)
    normal = (ahead - behind) / 2e-5
    variance = np.einsum("ni,nij,nj->n", normal, surface.covariances, normal)
    return distance**2 / variance


def _millimetre(scene: Scene, clouds: list[Cloud], output: Output) -> None:
    config = VoxelMapConfig(UpdateModel(), coarse=True, memory_limit=int(MEMORY))
    voxels = VoxelMap(VoxelGrid(0.001, *FINE_BOX), config)
    start = time.process_time()
    insert_clouds(voxels, clouds)
    rate = sum(len(cloud.points) for cloud in clouds) / (time.process_time() - start)
    output.measure("points_per_s/1mm", rate)
    output.measure("memory_bytes/1mm", voxels.memory)
    output.check("mapping, points a second at 1 mm", rate, ">= 1e5", rate >= 1e5)
    output.check(
        "mapping, memory at 1 mm over 1.5 m", voxels.memory, "<= 1e9", voxels.memory <= MEMORY
    )
    _consistency(voxels, scene, output, "1mm")
