"""Storage of a sparse map: bricks of 8 x 8 x 8 voxels behind a dense index.

A brick whose voxels are all alike is one number in the index. Others hold 512 log-odds of 8 bits;
those that surfaces pass through also hold the number of each voxel's surface estimate.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false, reportReturnType=false
# pyright: reportIncompatibleMethodOverride=false

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

KERNEL: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
"""Options of kernels that make no arrays. Without numba's runtime they count no references: handing
a tuple of arrays from one to another would else cost a third of their time. Such a tuple is handed
over word by word, some hundred of them: what is called for each brick, group or part is inlined."""
SIDE = 8
"""Voxels along a brick."""
CELLS = SIDE**3
NEVER = -128
"""Log-odds of a voxel that was never measured."""
NOWHERE = -1
SCAN, POINTS = 9, 10
"""Columns of `Bricks.records`."""
LAST_SCAN = 2**24
"""Scan numbers up to here are exact in 32-bit records."""
BRICKS, BLOCKS, RECORDS, FREE_BRICKS, FREE_RECORDS, DROPPED = range(6)
"""Entries of `Bricks.used`: how much of each store is taken, what was given back, what was lost."""


class Bricks(NamedTuple):
    """All arrays of a map.

    Attributes:
        index: (bx, by, bz) brick number, or -129 - v where all voxels have the log-odds v.
        values: (n, 512) log-odds in steps, z fastest.
        block: (n,) number of the brick's block of slots, or -1.
        slots: (m, 512) number of the surface estimate in the voxel, or -1.
        records: (r, 12) estimates of the surface, each on a cache line: mean [m] from the grid's
            corner (3); covariance [m^2] (6: xx, xy, xz, yy, yz, zz); number of the scan that last
            measured it, and how many points that gave.
        free_bricks: (n,) stack of bricks given back.
        free_records: (r,) stack of estimates given back.
        used: (6,) see BRICKS.
    """

    index: NDArray[np.int32]
    values: NDArray[np.int8]
    block: NDArray[np.int32]
    slots: NDArray[np.int32]
    records: NDArray[np.float32]
    free_bricks: NDArray[np.int32]
    free_records: NDArray[np.int32]
    used: NDArray[np.int64]


def empty_bricks(shape: tuple[int, int, int]) -> Bricks:
    """Return a map of which nothing is known; shape in bricks."""
    return Bricks(
        index=np.full(shape, NOWHERE, dtype=np.int32),
        values=np.empty((0, CELLS), dtype=np.int8),
        block=np.empty(0, dtype=np.int32),
        slots=np.empty((0, CELLS), dtype=np.int32),
        records=np.empty((0, 12), dtype=np.float32),
        free_bricks=np.empty(0, dtype=np.int32),
        free_records=np.empty(0, dtype=np.int32),
        used=np.zeros(6, dtype=np.int64),
    )


def with_capacity(store: Bricks, bricks: int, blocks: int, records: int) -> Bricks:
    """Return the same map with capacity for so many in all."""

    def longer(array: np.ndarray, length: int) -> np.ndarray:
        if length <= len(array):
            return array
        larger = np.empty((length, *array.shape[1:]), dtype=array.dtype)
        larger[: len(array)] = array
        return larger

    return store._replace(
        values=longer(store.values, bricks),
        block=longer(store.block, bricks),
        free_bricks=longer(store.free_bricks, bricks),
        slots=longer(store.slots, blocks),
        records=longer(store.records, records),
        free_records=longer(store.free_records, records),
    )


@numba.njit(**KERNEL, inline="always")
def whole(value: float) -> int:
    """Return the floor; `math.floor` is a call, which costs more than all around it."""
    nearer_zero = int(value)
    return nearer_zero - 1 if value < nearer_zero else nearer_zero


@numba.njit(**KERNEL, inline="always")
def has_capacity(store: Bricks, bricks: int, blocks: int, records: int) -> bool:
    """Return whether so many can still be taken."""
    used = store.used
    return (
        used[BRICKS] - used[FREE_BRICKS] + bricks <= store.values.shape[0]
        and used[BLOCKS] + blocks <= store.slots.shape[0]
        and used[RECORDS] - used[FREE_RECORDS] + records <= store.records.shape[0]
    )


@numba.njit(**KERNEL)
def dense_brick(store: Bricks, x: int, y: int, z: int) -> int:
    """Return the number of the brick at x, y, z, which is given its own voxels if it has none."""
    brick = store.index[x, y, z]
    if brick >= 0:
        return brick
    used = store.used
    if used[FREE_BRICKS] > 0:
        used[FREE_BRICKS] -= 1
        number = store.free_bricks[used[FREE_BRICKS]]
    else:
        number = np.int32(used[BRICKS])
        used[BRICKS] += 1
    store.values[number] = -129 - brick
    store.block[number] = NOWHERE
    store.index[x, y, z] = number
    return number


@numba.njit(**KERNEL, inline="always")
def slot_block(store: Bricks, brick: int) -> int:
    """Return the number of a dense brick's block of slots, made if there is none."""
    block = store.block[brick]
    if block < 0:
        block = np.int32(store.used[BLOCKS])
        store.used[BLOCKS] += 1
        store.slots[block] = NOWHERE
        store.block[brick] = block
    return block


@numba.njit(**KERNEL, inline="always")
def new_record(store: Bricks) -> int:
    """Return the number of an unused surface estimate."""
    used = store.used
    if used[FREE_RECORDS] > 0:
        used[FREE_RECORDS] -= 1
        return store.free_records[used[FREE_RECORDS]]
    used[RECORDS] += 1
    return np.int32(used[RECORDS] - 1)


@numba.njit(**KERNEL, inline="always")
def release_record(store: Bricks, block: int, cell: int) -> None:
    """Forget the surface estimate of a voxel."""
    store.free_records[store.used[FREE_RECORDS]] = store.slots[block, cell]
    store.used[FREE_RECORDS] += 1
    store.slots[block, cell] = NOWHERE


@numba.njit(**KERNEL, inline="always")
def record_at(store: Bricks, x: int, y: int, z: int) -> int:
    """Return the number of the estimate in a voxel (which must be inside), or -1."""
    brick = store.index[x >> 3, y >> 3, z >> 3]
    if brick < 0:
        return NOWHERE
    block = store.block[brick]
    if block < 0:
        return NOWHERE
    return store.slots[block, ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)]


@numba.njit(**KERNEL)
def read_cells(store: Bricks, cells: NDArray[np.int64], out: NDArray[np.int8]) -> None:
    """Write the log-odds of voxels (N, 3), all inside, to out (N,)."""
    for i in range(cells.shape[0]):
        x, y, z = cells[i, 0], cells[i, 1], cells[i, 2]
        brick = store.index[x >> 3, y >> 3, z >> 3]
        if brick < 0:
            out[i] = -129 - brick
        else:
            out[i] = store.values[brick, ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)]


@numba.njit(cache=True)
def count_values(store: Bricks, histogram: NDArray[np.int64]) -> None:
    """Count voxels by log-odds; histogram (256,) from -128 on."""
    for brick in store.index.flat:
        if brick < 0:
            histogram[-1 - brick] += CELLS
        else:
            for value in store.values[brick]:
                histogram[int(value) + 128] += 1


@numba.njit(**KERNEL)
def pack_states(
    store: Bricks, threshold: int, kinds: NDArray[np.int32], packed: NDArray[np.uint16]
) -> int:
    """Pack the states of the bricks that have their own voxels, two bits each.

    Args:
        store: The map.
        threshold: Log-odds from which on a voxel is occupied.
        kinds: (bx, by, bz), where such a brick's row is written, or -1 - s if all are in state s.
        packed: (n, 64) rows.

    Returns:
        How many rows were written.
    """
    row = 0
    for x in range(kinds.shape[0]):
        for y in range(kinds.shape[1]):
            for z in range(kinds.shape[2]):
                brick = store.index[x, y, z]
                if brick < 0:
                    continue
                every, some = 3, 0
                for column in range(CELLS // SIDE):
                    word = 0
                    for level in range(SIDE):
                        value = store.values[brick, column * SIDE + level]
                        state = 0 if value == NEVER else (2 if value >= threshold else 1)
                        every, some = every & state, some | state
                        word |= state << (2 * level)
                    packed[row, column] = word
                if every == some:
                    kinds[x, y, z] = -1 - some
                else:
                    kinds[x, y, z] = row
                    row += 1
    return row
