"""Lines of sight on a grid, against a brute force by exact fractions and by sampling."""

from fractions import Fraction

import numpy as np
import pytest

from perception.planar.map import Grid
from perception.planar.raycast import (
    RangeSensor,
    expected_view,
    fan,
    ray_sums,
    scan,
    sector_sums,
)

GRID = Grid(30, 34, 0.5)
SENSOR = RangeSensor(np.radians(90.0), 6.0)


def scattered(seed, share=0.12):
    occupied = np.random.default_rng(seed).random(GRID.shape) < share
    occupied[15, 16] = False
    return occupied


def cells_crossed(start, target):
    """Cells whose closed square meets the segment between two centres, by clipping fractions."""
    found = set()
    (r0, c0), (r1, c1) = start, target
    for r in range(min(r0, r1), max(r0, r1) + 1):
        for c in range(min(c0, c1), max(c0, c1) + 1):
            near, far = Fraction(0), Fraction(1)
            for origin, end, cell in ((r0, r1, r), (c0, c1, c)):
                low, high = (
                    Fraction(2 * (cell - origin) - 1, 2),
                    Fraction(2 * (cell - origin) + 1, 2),
                )
                if end == origin:
                    continue
                ends = sorted((low / (end - origin), high / (end - origin)))
                near, far = max(near, ends[0]), min(far, ends[1])
            if near <= far:
                found.add((r, c))
    return found


def in_sector(cell, start, heading, sensor):
    offset = np.subtract(cell, start)
    if np.hypot(*offset) * GRID.cell > sensor.depth + 1e-9:
        return False
    away = np.angle(np.exp(1j * (np.arctan2(*offset) - heading)))
    return not offset.any() or abs(away) <= sensor.fov / 2 + 1e-9


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.3])
def test_every_cell_with_a_free_line_to_its_centre_is_seen(heading):
    occupied, start = scattered(1, share=0.06), (15, 16)
    seen = scan(occupied, GRID, start, heading, SENSOR)
    expected = set()
    for cell in np.ndindex(GRID.shape):
        if in_sector(cell, start, heading, SENSOR):
            between = cells_crossed(start, cell) - {cell}
            if not any(occupied[c] for c in between):
                expected.add(cell)
    assert len(expected) > 15
    for cell in expected:
        assert (seen.hit if occupied[cell] else seen.passed)[cell], cell


def test_every_seen_cell_has_a_free_line_to_some_point_of_it():
    occupied, start, sensor = scattered(2), (15, 16), RangeSensor(2 * np.pi, 6.0)
    seen = scan(occupied, GRID, start, 0.0, sensor)
    inside = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 41)] * 2), axis=-1).reshape(-1, 2)
    inside = inside[np.argsort(np.abs(inside).max(axis=1))]
    way = np.linspace(0.0, 1.0, 300)[:, None]
    for cell in np.argwhere(seen.passed | seen.hit):
        for offset in inside:
            line = np.round(start + way * (cell + offset - start)).astype(int)
            blocked = occupied[line[:, 0], line[:, 1]] & (line != cell).any(axis=1)
            if not blocked.any():
                break
        else:
            pytest.fail(f"no line of sight to {cell}")


def test_a_scan_without_noise_never_mistakes_a_cell():
    for seed in range(5):
        occupied = scattered(seed)
        seen = scan(occupied, GRID, (15, 16), 0.4 * seed, SENSOR)
        assert not (seen.passed & occupied).any()
        assert not (seen.hit & ~occupied).any()


def test_no_beam_slips_between_two_cells_that_touch_at_a_corner():
    occupied = np.eye(34, dtype=bool)[:30]
    seen = scan(occupied, GRID, (5, 12), 0.0, RangeSensor(2 * np.pi, 10.0))
    rows, columns = np.indices(GRID.shape)
    assert not seen.passed[columns < rows].any()


def test_noise_spreads_hits_along_the_beam_and_follows_the_generator():
    occupied = np.zeros(GRID.shape, dtype=bool)
    occupied[:, 26] = True
    sensor = RangeSensor(np.radians(20.0), 9.0, noise=0.05)
    scans = [
        scan(occupied, GRID, (15, 12), 0.0, sensor, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    ]
    assert (scans[0].hit == scans[1].hit).all()
    assert (scans[0].hit != scans[2].hit).any()
    columns = np.argwhere(scans[0].hit)[:, 1]
    assert columns.min() < 26 <= columns.max()
    with pytest.raises(ValueError, match="generator"):
        scan(occupied, GRID, (15, 12), 0.0, sensor)


def test_fan_pieces_fill_the_disc():
    table = fan(6.0, 0.5, 240)
    assert table.areas.sum() == pytest.approx(np.pi * 36.0, rel=1e-12)


def test_ray_sums_agree_with_fine_sampling_of_each_ray():
    occupied = scattered(3)
    values = np.random.default_rng(4).random(GRID.shape)
    table = fan(6.0, 0.5, 48)
    cells = np.array([[15, 16], [2, 3]])
    occupied[2, 3] = False
    found = ray_sums(values[None], occupied, cells, table)[0]
    steps = 40_000
    radii = (np.arange(steps) + 0.5) * 6.0 / steps
    for n, cell in enumerate(cells):
        for ray in range(48):
            angle = (ray + 0.5) * 2 * np.pi / 48
            line = cell + np.outer(radii / 0.5, [np.sin(angle), np.cos(angle)])
            at = np.round(line).astype(int)
            inside = ((at >= 0) & (at < GRID.shape)).all(axis=1)
            at = np.clip(at, 0, np.array(GRID.shape) - 1)
            blocked = ~inside | occupied[at[:, 0], at[:, 1]]
            last = np.argmax(blocked) if blocked.any() else steps
            pieces = radii[:last] * (6.0 / steps) * (2 * np.pi / 48)
            expected = float(pieces @ values[at[:last, 0], at[:last, 1]])
            assert found[n, ray] == pytest.approx(expected, rel=2e-3, abs=1e-4)


def test_values_of_another_map_are_refused():
    opaque, cells, table = scattered(3), np.array([[15, 16]]), fan(6.0, 0.5, 48)
    for shape in ((1, 30, 35), (30, 34)):
        with pytest.raises(ValueError, match=r"values: expected shape \(layers, 30, 34\)"):
            ray_sums(np.zeros(shape), opaque, cells, table)


@pytest.mark.parametrize("degrees", [30.0, 75.0, 90.0, 360.0])
def test_sliding_sums_are_the_sums_of_each_sector(degrees):
    sums = np.random.default_rng(5).random((3, 240))
    found = sector_sums(sums, np.radians(degrees), 24)
    width = round(degrees / 1.5)
    for heading in range(24):
        rays = (heading * 10 - width // 2 + np.arange(width)) % 240
        np.testing.assert_allclose(found[:, heading], sums[:, rays].sum(axis=1), rtol=1e-12)


def test_expected_view_agrees_with_a_scan_except_at_the_edge():
    occupied = scattered(6, share=0.03)
    expected = expected_view(occupied, (15, 16), 0.5, SENSOR.fov, fan(6.0, 0.5, 240))
    seen = scan(occupied, GRID, (15, 16), 0.5, SENSOR).passed
    assert (expected & seen).sum() > 0.85 * (expected | seen).sum()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fov": 0.0}, "fov"),
        ({"fov": 7.0}, "fov"),
        ({"depth": float("nan")}, "depth"),
        ({"noise": -1.0}, "noise"),
    ],
)
def test_impossible_sensors_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        RangeSensor(**change)


def test_a_sensor_in_an_obstacle_or_outside_is_refused():
    occupied = np.zeros(GRID.shape, dtype=bool)
    occupied[3, 3] = True
    with pytest.raises(ValueError, match="stands in an obstacle"):
        scan(occupied, GRID, (3, 3), 0.0, SENSOR)
    with pytest.raises(ValueError, match="outside"):
        scan(occupied, GRID, (3, 34), 0.0, SENSOR)
    with pytest.raises(ValueError, match="shape"):
        scan(occupied[1:], GRID, (3, 4), 0.0, SENSOR)
