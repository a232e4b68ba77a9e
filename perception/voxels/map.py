"""A sparse probabilistic map of voxels, with an estimate of the surface in each occupied one."""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.geometry.pinhole import Frustum
from perception.voxels.bricks import (
    BLOCKS,
    BRICKS,
    CELLS,
    DROPPED,
    FREE_BRICKS,
    FREE_RECORDS,
    LAST_SCAN,
    NEVER,
    NOWHERE,
    RECORDS,
    SIDE,
    Bricks,
    count_values,
    empty_bricks,
    pack_states,
    read_cells,
    with_capacity,
)
from perception.voxels.carving import bricks_in, carve_scan, samples_of
from perception.voxels.fusion import (
    MIN_SIGMA_VOXELS,
    allocate_estimates,
    fuse_scan,
    touch_scan,
)
from perception.voxels.grid import MapError, VoxelGrid, checked_cloud, checked_points
from perception.voxels.occupancy import State, UpdateModel, log_odds, probability
from perception.voxels.scan import (
    TILE,
    Camera,
    Scan,
    ScanSettings,
    allocate_scan,
    binned,
    camera_of,
    fill_scan,
    window_of,
)

VOXEL_MODEL = UpdateModel(hit=0.85, miss=0.18, lowest=0.01, highest=0.99)
"""Free space ends well before a surface, so that a view is strong evidence: two make P < 0.05."""
LARGEST_STEP = 126
"""Log-odds are kept in 8 bits; the larger clamp is this."""


class MapFull(MapError):
    """The map needs more memory than it may take; it is valid, but lacks part of the last scan."""


@dataclasses.dataclass(frozen=True)
class VoxelMapConfig:
    """How scans enter a map.

    Attributes:
        model: Update of a voxel by hits and misses.
        margin_deviations: Deviations of a point's depth by which free space ends before it.
        margin_voxels: Voxels across the surface by which free space ends before that; half a
            voxel's diagonal is 0.87.
        correlated_points: Number of neighbouring points of a scan that share one error, as those of
            block matching do; together they count as one.
        coarse: Ask about free space for 2 x 2 x 2 voxels at once, and where a view ends free whole
            bricks only. For voxels smaller than what a pixel sees; saves most time and memory.
        memory_limit: Memory of all arrays [byte].
    """

    model: UpdateModel = VOXEL_MODEL
    margin_deviations: float = 2.0
    margin_voxels: float = 0.87
    correlated_points: float = 1.0
    coarse: bool = False
    memory_limit: int = 2**30

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        margins = (self.margin_deviations, self.margin_voxels)
        if not (np.isfinite(margins).all() and min(margins) >= 0.0):
            raise MapError(f"{self}: expected finite margins of at least zero")
        if not (np.isfinite(self.correlated_points) and self.correlated_points >= 1.0):
            raise MapError(f"{self}: expected correlated_points of at least 1")


@dataclasses.dataclass(frozen=True)
class Surface:
    """Estimates of where the surface is, one for each occupied voxel.

    Attributes:
        means: (M, 3) [m], world.
        covariances: (M, 3, 3) [m^2], world.
        probabilities: (M,) probabilities of occupancy.
    """

    means: FloatArray
    covariances: FloatArray
    probabilities: FloatArray


class VoxelMap:
    """Voxels of a box: never measured, free or occupied, and where in them the surface is.

    Attributes:
        grid: The box, extended to whole bricks of 8 voxels.
        config: Update model and margins of scans.
        bricks: All arrays; see `perception.voxels.bricks`.
        scans: Number of scans it holds.
    """

    def __init__(self, grid: VoxelGrid, config: VoxelMapConfig | None = None) -> None:
        """Start with a map of which nothing is known.

        Raises:
            MapError: If the box has too many voxels for the memory.
        """
        self.config = VoxelMapConfig() if config is None else config
        shape = -(-np.array(grid.shape) // SIDE)
        upper = (grid.first + shape * SIDE) * grid.resolution
        x, y, z = upper.tolist()
        self.grid = dataclasses.replace(grid, upper=(x, y, z))
        needed = 4 * float(np.prod(shape, dtype=float))
        if needed > self.config.memory_limit / 2:
            raise MapError(
                f"{grid}: its index alone takes {needed / 1e6:.0f} MB, more than half of the "
                f"{self.config.memory_limit / 1e6:.0f} MB of memory_limit"
            )
        i, j, k = shape.tolist()
        self.bricks: Bricks = empty_bricks((i, j, k))
        self.scans = 0
        self._scan: Scan | None = None
        self._outline: tuple[int, NDArray[np.int32], NDArray[np.uint16]] | None = None
        low, high = self.config.model.clamps
        self._scale = LARGEST_STEP / max(-low, high)

    def insert(
        self,
        transform_camera_to_world: RigidTransform,
        frustum: Frustum,
        points: ArrayLike,
        covariances: ArrayLike,
    ) -> int:
        """Add a scan.

        Voxels in view before the measured depth become freer, those where points are become more
        occupied, those behind stay as they are. The camera may be outside of the box.

        Args:
            transform_camera_to_world: Pose of the camera that took the scan.
            frustum: The camera's pixels. Those finer than a voxel at the far end are taken
                together. A pixel keeps its nearest points; one without a point frees nothing, so
                that pixels should not be finer than the cloud.
            points: (N, 3) [m], world. May be empty: nothing was seen.
            covariances: (N, 3, 3) [m^2], world; the uncertainty of the pose included.

        Returns:
            How many points were used.

        Raises:
            MapError: If a number is not finite, or a covariance not positive definite; the map is
                unchanged.
            MapFull: If there was no memory for all of the scan.
        """
        where, checked = checked_cloud(points, covariances)
        if not np.isfinite(transform_camera_to_world.as_matrix()).all():
            raise MapError(f"transform_camera_to_world: not finite: {transform_camera_to_world}")
        if len(where) == 0:
            return 0
        resolution = self.grid.resolution
        pixels = binned(frustum, resolution)
        camera = camera_of(transform_camera_to_world, pixels, self.grid.corner)
        margins = (self.config.margin_deviations, self.config.margin_voxels)
        size = (pixels.height, pixels.width)
        if self._scan is None or self._scan.depth.shape != size:
            self._scan = allocate_scan(pixels)
        scan = self._scan
        bad = fill_scan(scan, camera, where, checked, resolution, margins)
        if bad >= 0:
            raise MapError(
                f"point {bad}: {where[bad]} with covariance {checked[bad].tolist()}: expected "
                "finite numbers, and a positive definite covariance"
            )
        count = int(scan.count.sum())
        if self.scans == LAST_SCAN:
            raise MapError(f"map: holds {LAST_SCAN} scans, it cannot number more")
        self.scans += 1
        self.bricks.used[DROPPED] = 0
        self._add(scan, camera)
        if self.bricks.used[DROPPED]:
            raise MapFull(
                f"map: {self.bricks.used[DROPPED]} changes of this scan do not fit in "
                f"{self.config.memory_limit / 1e6:.0f} MB; use larger voxels, a smaller box, "
                "coarse or a larger memory_limit"
            )
        return count

    def _add(self, scan: Scan, camera: Camera) -> None:
        """Make voxels with points more occupied and those before them freer, as memory allows."""
        settings, work = self._settings(), allocate_estimates()
        settings = self._in_parts(
            lambda settings, begin: fuse_scan(self.bricks, scan, camera, settings, work, begin),
            scan.high.size,
            TILE * TILE,
            settings,
        )
        settings = self._in_parts(
            lambda settings, begin: touch_scan(self.bricks, scan, settings, begin),
            camera.height,
            camera.width,
            settings,
        )
        side, deepest = self.grid.resolution * SIDE, float(scan.high.max())
        window = window_of(camera, deepest, side, self.bricks.index.shape)
        samples = samples_of(camera, self.grid.resolution, self.config.coarse)
        self._in_parts(
            lambda settings, begin: carve_scan(
                self.bricks, scan, camera, samples, window, settings, begin
            ),
            bricks_in(window) if np.all(window[3:] >= window[:3]) else 0,
            1,
            settings,
        )

    def _in_parts(
        self,
        add: Callable[[ScanSettings, int], int],
        end: int,
        need: int,
        settings: ScanSettings,
    ) -> ScanSettings:
        """Add a scan part by part, growing where the next part has no room.

        Args:
            add: Kernel that goes on from a part, and returns the part before which it stopped.
            end: Number of parts.
            need: Capacity that a part may need.
            settings: Settings of the scan's update.

        Returns:
            The settings, which drop changes from where memory ran out.
        """
        begin = 0
        while begin < end:
            begin = add(settings, begin)
            if begin < end and not settings.drop_when_full and not self._grow(need):
                settings = settings._replace(drop_when_full=True)
        return settings

    def _settings(self) -> ScanSettings:
        """Return how the scan at hand enters the map; log-odds in the map's own steps."""
        config, grid = self.config, self.grid
        values = np.array([*config.model.steps, *config.model.clamps]) * self._scale
        hit, miss, low, high = np.rint(values).astype(int).tolist()
        return ScanSettings(
            grid.resolution,
            grid.shape,
            max(hit, 1),
            min(miss, -2),
            low,
            high,
            float(config.correlated_points),
            config.coarse,
            self.scans,
            drop_when_full=False,
        )

    def _grow(self, need: int) -> bool:
        """Add capacity for so many more; return whether there was memory."""
        used, store = self.bricks.used, self.bricks
        taken = (
            (used[BRICKS] - used[FREE_BRICKS], len(store.values)),
            (used[BLOCKS], len(store.slots)),
            (used[RECORDS] - used[FREE_RECORDS], len(store.records)),
        )
        for factor, extra in ((1.5, 1024), (1.1, need), (1.0, need)):
            sizes = [
                int(size * factor) + extra if count + need > size else size for count, size in taken
            ]
            total = sum(n * each for n, each in zip(sizes, (CELLS + 8, 4 * CELLS, 52), strict=True))
            if total + store.index.nbytes <= self.config.memory_limit:
                self.bricks = with_capacity(store, *sizes)
                return True
        return False

    @property
    def memory(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in self.bricks)

    def states(self, points: ArrayLike) -> NDArray[np.int8]:
        """Return (N,) of `State` at (N, 3) points [m], world; UNKNOWN outside of the box."""
        values = self._values(points)
        known = np.where(values >= self.threshold(), State.OCCUPIED, State.FREE)
        return np.where(values == NEVER, State.UNKNOWN, known).astype(np.int8)

    def probabilities(self, points: ArrayLike) -> FloatArray:
        """Return (N,) probabilities of occupancy at (N, 3) points; NaN where never measured."""
        return self._probability(self._values(points))

    def collides(self, points: ArrayLike, threshold: float = 0.05) -> NDArray[np.bool_]:
        """Return whether any of some points may be in something (Thesis section 3.2.4, i).

        Args:
            points: (..., N, 3) [m], world: for instance the bodies of a robot in many postures.
            threshold: A voxel is free below this probability; an unknown one never is.

        Returns:
            (...,), or a single truth value.
        """
        array = np.asarray(points, dtype=float)
        free = self.probabilities(array.reshape(-1, 3)) < threshold
        return np.any(~free.reshape(array.shape[:-1]), axis=-1)

    def surface(self) -> Surface:
        """Return the surface estimates of all occupied voxels."""
        store = self.bricks
        bricks = store.index[store.index >= 0]
        bricks = bricks[store.block[bricks] >= 0]
        slots, values = store.slots[store.block[bricks]], store.values[bricks]
        chosen = (slots >= 0) & (values >= self.threshold())
        records = store.records[slots[chosen], :9].astype(float)
        floor = (MIN_SIGMA_VOXELS * self.grid.resolution) ** 2 * np.array([1, 0, 0, 1, 0, 1])
        packed = records[:, 3:] + floor
        covariances = packed[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        means = records[:, :3] + self.grid.corner
        return Surface(means, covariances, self._probability(values[chosen]))

    def counts(self) -> dict[State, int]:
        """Return how many voxels are in each state."""
        histogram = np.zeros(256, dtype=np.int64)
        count_values(self.bricks, histogram)
        values = np.arange(-128, 128)
        occupied = int(histogram[values >= self.threshold()].sum())
        unknown = int(histogram[NEVER + 128])
        free = int(histogram.sum()) - occupied - unknown
        return {State.UNKNOWN: unknown, State.FREE: free, State.OCCUPIED: occupied}

    def brick_states(self) -> NDArray[np.int8]:
        """Return (bx, by, bz) of `State` for the map's bricks of 8 x 8 x 8 voxels.

        A brick with an occupied voxel is occupied; another one of which half was measured is free.
        """
        index = self.bricks.index
        dense = index >= 0
        values = self.bricks.values[index[dense]]
        states = np.full(index.shape, State.FREE, dtype=np.int8)
        whole = -129 - np.where(dense, NOWHERE, index)
        states[whole == NEVER] = State.UNKNOWN
        states[(whole != NEVER) & (whole >= self.threshold())] = State.OCCUPIED
        measured = np.count_nonzero(values != NEVER, axis=1) >= CELLS // 2
        occupied = np.any(values >= self.threshold(), axis=1)
        parts = np.where(measured, State.FREE, State.UNKNOWN)
        states[dense] = np.where(occupied, State.OCCUPIED, parts)
        return states

    def outline(self) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
        """Return the states of all voxels as `view_counts` reads them, kept until the next scan.

        Returns:
            (bx, by, bz) what is in each brick, -1 - s where all voxels are in the state s and
            elsewhere a number n; and (count, 64) for those the states of voxels 8 along z, two
            bits each.
        """
        if self._outline is None or self._outline[0] != self.scans:
            index = self.bricks.index
            alike = -129 - index
            states = np.where(alike >= self.threshold(), State.OCCUPIED, State.FREE)
            states[index == NOWHERE] = State.UNKNOWN
            kinds = (-1 - states).astype(np.int32)
            mixed = np.empty((int(np.count_nonzero(index >= 0)), CELLS // SIDE), dtype=np.uint16)
            count = pack_states(self.bricks, self.threshold(), kinds, mixed)
            self._outline = (self.scans, kinds, mixed[:count])
        return self._outline[1:]

    def occupied_cells(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Return indices (M, 3) of the occupied voxels and their probabilities (M,)."""
        index = self.bricks.index
        where = np.argwhere(index >= 0)
        values = self.bricks.values[index[index >= 0]]
        brick, cell = np.nonzero(values >= self.threshold())
        inner = np.column_stack([cell >> 6, (cell >> 3) & 7, cell & 7])
        return where[brick] * SIDE + inner, self._probability(values[brick, cell])

    def threshold(self) -> int:
        """Return from which log-odds on, in the map's steps, a voxel is occupied."""
        return int(np.ceil(float(log_odds(self.config.model.occupied_above)) * self._scale))

    def _probability(self, values: NDArray[np.int8]) -> FloatArray:
        return np.where(values == NEVER, np.nan, probability(values / self._scale))

    def _values(self, points: ArrayLike) -> NDArray[np.int8]:
        cells, inside = self.grid.cells(checked_points(points))
        values = np.empty(len(cells), dtype=np.int8)
        read_cells(self.bricks, cells, values)
        return np.where(inside, values, np.int8(NEVER))
