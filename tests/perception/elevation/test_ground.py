"""Heights above the local ground: closed forms, fits cell by cell, rates over random ground."""

import numpy as np
import pytest

from perception.elevation.grid import ElevationGrid
from perception.elevation.ground import (
    CURVATURE_PRIOR,
    DEGREES,
    MOST_LEVERAGE,
    STANDS_OUT,
    rises,
)
from perception.elevation.map import ElevationMap

CELL = 0.05


def mapped(heights, cell=CELL):
    model = ElevationMap(ElevationGrid((-1.0, 2.0), heights.shape, cell))
    model.heights[...] = heights
    return model


def places(rows, columns):
    """Height is to grow with both; x, y [m]."""
    row, column = np.indices((rows, columns))
    return CELL * column, CELL * row


def slope_of(degrees, rows=60, columns=70, towards=0.7):
    x, y = places(rows, columns)
    return np.tan(np.radians(degrees)) * (np.cos(towards) * x + np.sin(towards) * y)


def box_at(shape, row, column, edge):
    inside = np.zeros(shape, dtype=bool)
    inside[row : row + edge, column : column + edge] = True
    return inside


def relief_of(rng, sigma, cells=120, shortest=0.4, longest=6.0):
    """Isotropic noise of a band of wavelengths, as much in each octave, from its spectrum."""
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(cells, CELL)] * 2))
    band = (frequency >= 1.0 / longest - 1e-9) & (frequency <= 1.0 / shortest)
    amplitude = np.where(band, 1.0 / np.maximum(frequency, 1e-9), 0.0)
    noise = np.fft.fft2(rng.standard_normal((cells, cells)))
    heights = np.fft.ifft2(amplitude * noise).real
    return sigma * heights / heights.std()


@pytest.mark.parametrize("degrees", [0.0, 10.0, 15.0, 40.0])
def test_a_tilted_plane_rises_nowhere(degrees):
    heights = 3.0 + slope_of(degrees)
    np.testing.assert_allclose(rises(mapped(heights)), 0.0, atol=1e-9)
    rng = np.random.default_rng(0)
    heights[rng.uniform(size=heights.shape) < 0.7] = np.nan
    heights[:, 40:] = np.nan
    found = rises(mapped(heights))
    assert np.isnan(found[np.isnan(heights)]).all()
    assert np.nanmax(np.abs(found)) < 1e-8
    assert np.isfinite(found[np.isfinite(heights)]).mean() > 0.95


@pytest.mark.parametrize("edge", [1, 2, 4, 6])
def test_a_box_of_30_mm_on_a_slope_of_10_degrees_is_found_where_it_is(edge):
    heights = slope_of(10.0)
    box = box_at(heights.shape, 25, 31, edge)
    found = rises(mapped(heights + 0.03 * box))
    assert np.abs(found[box] - 0.03).max() < 0.005
    assert np.abs(found[~box]).max() < 0.005


def test_a_box_at_the_edge_of_what_is_known_is_found():
    """Seen from one side only: nothing is known behind it."""
    heights = slope_of(10.0)
    box = box_at(heights.shape, 25, 31, 4)
    heights = heights + 0.04 * box
    heights[:, 35:] = np.nan
    found = rises(mapped(heights))
    assert np.abs(found[box] - 0.04).max() < 0.005


def by_hand(heights, window):
    """The same fits by least squares cell by cell; the prior is three more observations."""
    reach = round(window / (2.0 * CELL))
    offsets = np.arange(-reach, reach + 1) / reach
    v, u = (grid.ravel() for grid in np.meshgrid(offsets, offsets, indexing="ij"))
    hann = np.cos(0.5 * np.pi * reach / (reach + 1) * v) ** 2
    hann *= np.cos(0.5 * np.pi * reach / (reach + 1) * u) ** 2
    design = {1: np.column_stack([np.ones_like(u), v, u])}
    design[2] = np.column_stack([design[1], v * v, v * u, u * u])
    weights = {1: np.ones_like(u), 2: hann}
    prior = np.sqrt(CURVATURE_PRIOR * (hann @ design[2][:, 3:] ** 2))
    framed = np.pad(heights, reach, constant_values=np.nan)
    ground = np.isfinite(framed)
    for degree in DEGREES:
        rise = np.full(heights.shape, np.nan)
        for row, column in np.argwhere(np.isfinite(heights)):
            part = slice(row, row + 2 * reach + 1), slice(column, column + 2 * reach + 1)
            used = ground[part].ravel()
            root = np.sqrt(weights[degree][used])
            rows = design[degree][used] * root[:, None]
            sides = framed[part].ravel()[used] * root
            if degree == 2:
                rows = np.vstack([rows, np.column_stack([np.zeros((3, 3)), np.diag(prior)])])
                sides = np.append(sides, np.zeros(3))
            solution, _, rank, _ = np.linalg.lstsq(rows, sides)
            certain = rank == rows.shape[1] and np.linalg.pinv(rows.T @ rows)[0, 0] <= MOST_LEVERAGE
            rise[row, column] = heights[row, column] - solution[0] if certain else np.nan
        ground[reach:-reach, reach:-reach] = np.isfinite(heights) & ~(rise > STANDS_OUT)
    return rise


def test_the_ground_is_what_least_squares_make_it_cell_by_cell():
    rng = np.random.default_rng(1)
    heights = relief_of(rng, 0.02)[:18, :22] + 0.004 * rng.standard_normal((18, 22))
    heights += 0.06 * box_at(heights.shape, 6, 8, 3)
    heights[rng.uniform(size=heights.shape) < 0.3] = np.nan
    heights[12:, 14:] = np.nan
    found, expected = rises(mapped(heights), 0.6), by_hand(heights, 0.6)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.nanmax(found) > 0.05


def test_boxes_of_40_mm_are_found_through_noise_of_4_mm_and_plain_ground_is_none():
    rng, missed, false, ground = np.random.default_rng(2), 0, 0, 0
    for degrees in np.repeat([0.0, 10.0, 15.0], 10):
        heights = slope_of(degrees) + 0.004 * rng.standard_normal((60, 70))
        boxes = np.zeros(heights.shape, dtype=int)
        corners = [(row, column) for row in (8, 28, 48) for column in (8, 28, 48)]
        for name, (row, column) in enumerate(corners, start=1):
            boxes[box_at(heights.shape, row, column, int(rng.integers(1, 5)))] = name
        found = rises(mapped(heights + 0.04 * (boxes > 0))) > 0.025
        missed += sum(not found[boxes == name].any() for name in range(1, 10))
        false, ground = false + int(found[boxes == 0].sum()), ground + int((boxes == 0).sum())
    # 25 mm is six deviations above the ground and a box four above 25 mm.
    assert missed <= 1
    assert false <= 2e-5 * ground


@pytest.mark.parametrize("slope", [0.0, 12.0])
def test_relief_of_20_mm_is_no_obstacle_and_rocks_on_it_are(slope):
    """Of planes alone 4.5 % of the relief would be obstacles."""
    rng, missed, rocks, false, cells = np.random.default_rng(3), 0, 0, 0, 0
    for _ in range(10):
        heights = slope_of(slope, 120, 120) + relief_of(rng, 0.02)
        heights += 0.004 * rng.standard_normal(heights.shape)
        top = np.zeros(heights.shape)
        for row, column in rng.integers(5, 110, (60, 2)):
            edge = int(rng.integers(1, 5))
            top[box_at(heights.shape, row, column, edge)] = rng.uniform(0.05, 0.1)
        found = rises(mapped(heights + top)) > 0.025
        missed, rocks = missed + int((~found[top > 0]).sum()), rocks + int((top > 0).sum())
        false, cells = false + int(found[top == 0].sum()), cells + int((top == 0).sum())
    assert false < 4e-3 * cells
    assert missed < 0.02 * rocks


def test_too_little_about_a_cell_tells_nothing_of_it():
    heights = np.full((30, 30), np.nan)
    heights[4, 4] = 0.1
    heights[20, 20:22] = 0.2
    assert np.isnan(rises(mapped(heights))).all()
    assert np.isnan(rises(mapped(np.full((5, 5), np.nan)))).all()
    heights[10:20, 10:20] = 0.0
    found = rises(mapped(heights))
    assert np.isnan(found[4, 4])
    assert np.abs(found[10:20, 10:20]).max() < 0.05


def test_rises_follow_the_heights_and_the_window():
    model = mapped(np.random.default_rng(4).normal(0.0, 0.01, (40, 50)))
    first = rises(model, 0.5)
    assert rises(model, 0.5) is first
    model.heights[20, 30] += 0.1
    model.heights[5, 5] = np.nan
    changed = rises(model, 0.5)
    assert changed[20, 30] > first[20, 30] + 0.08 and np.isnan(changed[5, 5])
    np.testing.assert_array_equal(changed, rises(mapped(model.heights), 0.5))
    assert not np.allclose(changed, rises(model, 0.9), equal_nan=True)


def test_window_narrower_than_three_cells_is_refused():
    with pytest.raises(ValueError, match="window 0.04"):
        rises(mapped(np.zeros((5, 5))), 0.04)
