"""New information of a planar view (Thesis eq. 3-12b to 3-14), in three readings.

All are scaled so that a wholly unknown sector that nothing hides has about 1, and hold area in
place of numbers of cells, so that a heading's value is a sliding sum over one fan.

- ``histogram``: entropy of the grey-level histogram of the stretched probabilities (3-14 without
  1 / d, which leaves [0, 1] and is singular at the camera), known and unknown apart.
- ``premultiplied``: levels of p itself, each term weighted by -p log2 p.
- ``entropy``: binary entropy of each undecided cell, times its area.
"""

from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numba
import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import BoolArray, FloatArray, IntArray
from perception.planar.map import FREE_BELOW
from perception.planar.raycast import Fan, RangeSensor, ray_sums, sector_rays, sector_sums
from perception.voxels.occupancy import binary_entropy

Reading: TypeAlias = Literal["histogram", "premultiplied", "entropy"]
READINGS: tuple[Reading, ...] = get_args(Reading)
LEVELS = 32
"""Grey levels N_gray of the histograms."""

_njit: Any = numba.njit(cache=True)


def stretch(probability: ArrayLike) -> FloatArray:
    """Spread probabilities around 0.5 (Thesis eq. 3-14 as mended: without 1 / d_voxel).

    A continuous, rising map of [0, 1] onto itself.
    """
    p = np.asarray(probability, dtype=float)
    low = (1.0 / np.maximum(1.0 - p, 0.5) - 1.0) / 2.0
    high = 1.0 - (1.0 / np.maximum(p, 0.5) - 1.0) / 2.0
    return np.where(p < 0.5, low, high)


def undecided_entropy(probability: ArrayLike, measured: ArrayLike) -> FloatArray:
    """Return the binary entropy of cells that are not decided, 0 for the others [bit].

    A cell below P = 0.05 or above 0.95 is known as well as it must be; the little entropy that a
    clamped probability keeps would otherwise make known ground worth another look.
    """
    p = np.asarray(probability, dtype=float)
    decided = np.asarray(measured) & ((p < FREE_BELOW) | (p > 1.0 - FREE_BELOW))
    entropy = np.zeros(p.shape)
    entropy[~decided] = binary_entropy(p[~decided])
    return entropy


class KnownGround(NamedTuple):
    """What is known of the cells of a planar map.

    Attributes:
        probability: (rows, columns) probability of occupancy.
        measured: (rows, columns) whether a cell was ever measured.
        opaque: (rows, columns) cells known to hide what is behind.
    """

    probability: FloatArray
    measured: BoolArray
    opaque: BoolArray


def new_information(
    reading: Reading,
    ground: KnownGround,
    cells: IntArray,
    table: Fan,
    sensor: RangeSensor,
    headings: int,
) -> FloatArray:
    """Rate the views from some cells in all headings.

    Args:
        reading: Reading of eq. 3-12b to 3-14.
        ground: Present knowledge of the cells.
        cells: (n, 2) rows and columns of the viewpoints.
        table: A fan of the sensor's depth of field.
        sensor: Field of view and depth of field.
        headings: Number of headings.

    Returns:
        (n, headings) new information NI; heading k is 2 pi k / headings.

    Raises:
        ValueError: If there is no such reading.
    """
    probability, measured, opaque = ground
    fov, depth, total = sensor.fov, sensor.depth, sensor.area
    if reading == "entropy":
        worth = undecided_entropy(probability, measured)
        return sector_sums(ray_sums(worth[None], opaque, cells, table)[0], fov, headings) / total
    if reading not in READINGS:
        raise ValueError(f"reading {reading}: expected {', '.join(READINGS)}")
    premultiplied = reading == "premultiplied"
    shade = probability if premultiplied else stretch(probability)
    distant = table.radii / depth
    distant = distant if premultiplied else stretch(distant)
    width, first = sector_rays(fov, headings, table.rays)
    weights = _level_weights(premultiplied)
    levels = GreyLevels(shade, measured, distant, weights, total)
    entropies = _fan_entropies(levels, opaque, cells, table, width, first)
    # Over the entropy of evenly filled levels.
    return entropies / float(np.log2(LEVELS) * np.mean(weights))


def _level_weights(premultiplied: bool) -> FloatArray:
    middle = (np.arange(LEVELS) + 0.5) / LEVELS
    return -middle * np.log2(middle) if premultiplied else np.ones(LEVELS)


class GreyLevels(NamedTuple):
    """What histograms of grey levels are made of.

    Attributes:
        shade: (rows, columns) grey level of each measured cell, 0 to 1.
        measured: (rows, columns) whether a cell was ever measured.
        distant: (m,) grey level of an unmeasured cell, for each of the fan's cells, 0 to 1.
        weights: (levels,) weight of each level's term.
        total: Area of the whole sector [m^2].
    """

    shade: FloatArray
    measured: BoolArray
    distant: FloatArray
    weights: FloatArray
    total: float


@_njit
def _fan_entropies(
    grey: GreyLevels, opaque: BoolArray, cells: IntArray, table: Fan, width: int, first: IntArray
) -> FloatArray:
    """Slide a histogram of known and unknown levels around each fan."""
    shade, measured, distant, weights, total = grey
    starts, offsets, areas = table.starts, table.offsets, table.areas
    rows, columns = shade.shape
    rays, levels = starts.size - 1, weights.size
    entropies = np.zeros((cells.shape[0], first.size))
    summed = np.zeros((2 * rays + 1, 2, levels))
    for n in range(cells.shape[0]):
        for ray in range(rays):
            summed[ray + 1] = summed[ray]
            for k in range(starts[ray], starts[ray + 1]):
                r, c = cells[n, 0] + offsets[k, 0], cells[n, 1] + offsets[k, 1]
                if r < 0 or r >= rows or c < 0 or c >= columns or opaque[r, c]:
                    break
                known = measured[r, c]
                level = int((shade[r, c] if known else distant[k]) * levels)
                summed[ray + 1, 0 if known else 1, min(level, levels - 1)] += areas[k]
        for ray in range(rays):
            summed[rays + ray + 1] = summed[rays] + summed[ray + 1]
        for heading in range(first.size):
            begin = first[heading] % rays
            entropy = 0.0
            for group in range(2):
                for level in range(levels):
                    area = summed[begin + width, group, level] - summed[begin, group, level]
                    q = area / total
                    if q > 1e-12:
                        entropy -= weights[level] * q * np.log2(q)
            entropies[n, heading] = entropy
    return entropies
