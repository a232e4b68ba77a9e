"""Points of a view to one height for each cell, and how it updates the map's.

A cell's height is that of the surface on which most of its points lie, unless they scatter more
than their noise explains: then a cell holds an edge, and its upper surface counts. Points that
stand alone, as false matches do, decide nothing.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false

from typing import Any, NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import FloatArray, IndexArray, IntArray

SCATTER = 1.5
"""Deviation of a cell's points over that of their noise, from which on the cell holds an edge."""
_QUANTILES = 2.56
"""Deviations from the 10 % to the 90 % quantile of a normal distribution: `support_share`."""
UPPER_REACH = 2.0
"""Deviations about a point of the upper surface within which points are of that surface."""


class FusionSettings(NamedTuple):
    """Settings of the compiled loops; see `perception.elevation.map.ElevationMapConfig`."""

    min_points: int
    support: int
    support_share: float
    roughness: float
    gate: float
    least_step: float
    lower_views: int
    correlated_points: float
    least_sigma: float


class Layers(NamedTuple):
    """Arrays of a map, by flat index of the cell.

    Attributes:
        heights: (cells,) height of the surface [m]; NaN where unknown.
        variances: (cells,) variance of the height [m^2]; NaN where unknown.
        lower: (cells,) height of a surface below, of which there are not yet enough views [m].
        lower_variances: (cells,) its variance [m^2].
        lower_views: (cells,) number of successive views of it.
    """

    heights: FloatArray
    variances: FloatArray
    lower: FloatArray
    lower_variances: FloatArray
    lower_views: IntArray


@numba.njit(cache=True)
def reduce_points(
    flat: Any, heights: Any, variances: Any, size: int, settings: FusionSettings
) -> tuple[Any, Any, Any]:
    """Return the cells that a view tells a height of, ascending, those heights and variances.

    Args:
        flat: (N,) flat index of each point's cell.
        heights: (N,) heights of the points [m].
        variances: (N,) variances of those heights [m^2].
        size: Number of cells of the map.
        settings: Settings of the fusion.
    """
    starts = np.zeros(size + 1, np.intp)
    for cell in flat:
        starts[cell + 1] += 1
    touched = 0
    for cell in range(size):
        touched += starts[cell + 1] > 0
        starts[cell + 1] += starts[cell]
    order, filled = np.empty(flat.size, np.intp), starts[:-1].copy()
    for point in range(flat.size):
        order[filled[flat[point]]] = point
        filled[flat[point]] += 1
    cells, means, deviations = np.empty(touched, np.intp), np.empty(touched), np.empty(touched)
    count = 0
    for cell in range(size):
        if starts[cell + 1] - starts[cell] < settings.min_points:
            continue
        points = order[starts[cell] : starts[cell + 1]]
        points = points[np.argsort(heights[points])]
        mean, variance = _surface_of(heights[points], variances[points], settings)
        if variance > 0.0:
            cells[count], means[count], deviations[count] = cell, mean, variance
            count += 1
    return cells[:count], means[:count], deviations[:count]


@numba.njit(cache=True)
def _surface_of(z: Any, variances: Any, settings: FusionSettings) -> tuple[float, float]:
    """Return height and variance of the surface of a cell's ascending heights; 0, 0 if none."""
    n = z.size
    sigma = np.sqrt(variances.mean() + settings.roughness**2)
    support = max(settings.support, int(np.ceil(settings.support_share * n)))
    if 2 * support < n and z[n - support] - z[support - 1] > SCATTER * _QUANTILES * sigma:
        reach = UPPER_REACH * sigma
        for top in range(n - support, -1, -1):
            first, last = _within(z, z[top], reach)
            if last - first >= support:
                return _mean(z, variances, first, last, settings)
        return 0.0, 0.0
    first, last = _within(z, z[n // 2], settings.gate * sigma)
    if last - first < settings.min_points:
        return 0.0, 0.0
    return _mean(z, variances, first, last, settings)


@numba.njit(cache=True)
def _within(z: Any, middle: float, reach: float) -> tuple[int, int]:
    """Return the first of ascending heights about another, and the first beyond them."""
    low, high = middle - reach, middle + reach
    return int(np.searchsorted(z, low)), int(np.searchsorted(z, high, side="right"))


@numba.njit(cache=True)
def _mean(
    z: Any, variances: Any, first: int, last: int, settings: FusionSettings
) -> tuple[float, float]:
    """Return mean and variance of some of a cell's heights, which share part of their error."""
    total = mean = stated = 0.0
    for i in range(first, last):
        weight = 1.0 / (variances[i] + settings.roughness**2)
        total += weight
        mean += weight * z[i]
        stated += weight * variances[i]
    mean, stated = mean / total, stated / total
    scatter = 0.0
    for i in range(first, last):
        scatter += (z[i] - mean) ** 2
    n = last - first
    alone = max(stated, scatter / n)
    share = max(1.0, n / settings.correlated_points)
    return mean, alone / share + settings.least_sigma**2


@numba.njit(cache=True)
def update_cells(
    cells: IndexArray, heights: Any, variances: Any, layers: Layers, settings: FusionSettings
) -> Any:
    """Update cells by one measurement of each, and return whether each one's height changed.

    Args:
        cells: (K,) flat indices.
        heights: (K,) measured heights [m].
        variances: (K,) variances of the measured heights [m^2].
        layers: Arrays of the map, changed in place.
        settings: Settings of the fusion.
    """
    changed = np.ones(cells.size, np.bool_)
    floor = settings.least_sigma**2
    for i in range(cells.size):
        cell, z, variance = cells[i], heights[i], variances[i]
        old, other = layers.heights[cell], layers.variances[cell]
        apart = z - old
        limit = max(settings.gate * np.sqrt(variance + other), settings.least_step)
        if np.isnan(old) or apart > limit:
            layers.heights[cell], layers.variances[cell] = z, max(variance, floor)
            layers.lower_views[cell] = 0
        elif apart >= -limit:
            gain = other / (other + variance)
            layers.heights[cell] = old + gain * apart
            layers.variances[cell] = max((1.0 - gain) * other, floor)
            layers.lower_views[cell] = 0
        else:
            changed[i] = _note_lower(cell, z, variance, layers, settings)
    return changed


@numba.njit(cache=True)
def _note_lower(
    cell: int, z: float, variance: float, layers: Layers, settings: FusionSettings
) -> bool:
    """Note a view of a surface below the map's, and return whether it has become the map's."""
    low, other = layers.lower[cell], layers.lower_variances[cell]
    limit = max(settings.gate * np.sqrt(variance + other), settings.least_step)
    if layers.lower_views[cell] > 0 and abs(z - low) <= limit:
        gain = other / (other + variance)
        z = low + gain * (z - low)
        variance = max((1.0 - gain) * other, settings.least_sigma**2)
        layers.lower_views[cell] += 1
    else:
        layers.lower_views[cell] = 1
    layers.lower[cell], layers.lower_variances[cell] = z, variance
    if layers.lower_views[cell] < settings.lower_views:
        return False
    layers.heights[cell], layers.variances[cell] = z, variance
    layers.lower_views[cell] = 0
    return True
