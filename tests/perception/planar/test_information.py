"""Three readings of new information, against cases worked by hand."""

import numpy as np
import pytest

from perception.planar.information import (
    READINGS,
    KnownGround,
    new_information,
    stretch,
    undecided_entropy,
)
from perception.planar.map import Grid
from perception.planar.raycast import RangeSensor, fan

GRID = Grid(30, 30, 0.5)
DEPTH, FOV, RAYS = 5.0, np.radians(90.0), 48
TABLE = fan(DEPTH, GRID.cell, RAYS)
HERE = np.array([[15, 15]])
SENSOR = RangeSensor(FOV, DEPTH)


def histogram_entropy(areas, total, premultiplied=False):
    """Equation 3-12b: (2, levels) areas of known and unknown cells of a sector of a total area."""
    levels = areas.shape[1]
    middle = (np.arange(levels) + 0.5) / levels
    weights = -middle * np.log2(middle) if premultiplied else np.ones(levels)
    terms = [-q * np.log2(q) * w for row in areas / total for q, w in zip(row, weights) if q > 0]
    return sum(terms) / (np.log2(levels) * weights.mean())


def rate(reading, probability=0.5, measured=False, opaque=False):
    full = [np.broadcast_to(a, GRID.shape).copy() for a in (probability, measured, opaque)]
    return new_information(reading, KnownGround(*full), HERE, TABLE, SENSOR, 24)[0]


def test_stretch_is_continuous_and_maps_0_to_1_onto_itself():
    p = np.linspace(0.0, 1.0, 100_001)
    stretched = stretch(p)
    assert stretched[[0, -1]].tolist() == [0.0, 1.0]
    assert stretch(0.5) == pytest.approx(0.5)
    assert (np.diff(stretched) > 0).all()
    assert np.diff(stretched).max() < 3e-5


def test_stretch_follows_equation_3_14_without_distance():
    assert stretch(0.2) == pytest.approx((1 / 0.8 - 1) / 2)
    assert stretch(0.8) == pytest.approx(1 - (1 / 0.8 - 1) / 2)


def test_entropy_reading_counts_the_undecided_share_of_the_sector():
    assert rate("entropy") == pytest.approx(np.ones(24))
    half = np.zeros(GRID.shape, dtype=bool)
    half[:, :15] = True
    half[:, 15] = True
    found = rate("entropy", np.where(half, 0.04, 0.5), half)
    # East is unknown but for the sensor's own column.
    assert found[12] == pytest.approx(0.0, abs=1e-12)
    assert 0.95 < found[0] < 1.0


@pytest.mark.parametrize("reading", ["entropy", "histogram", "premultiplied"])
def test_every_reading_falls_when_obstacles_hide_the_unknown(reading):
    opaque = np.zeros(GRID.shape, dtype=bool)
    opaque[:, 18] = True
    measured = opaque.copy()
    probability = np.where(opaque, 0.99, 0.5)
    found = rate(reading, probability, measured, opaque)
    assert found[0] < 0.7 * found[12]


def test_known_empty_ground_is_worth_nothing():
    assert rate("entropy", 0.04, True).max() == 0.0
    assert rate("histogram", 0.04, True).max() == pytest.approx(0.0, abs=1e-9)
    assert rate("premultiplied", 0.04, True).max() == pytest.approx(0.0, abs=1e-9)


def test_fan_histograms_agree_with_one_histogram_of_each_sector():
    generator = np.random.default_rng(1)
    probability = generator.choice([0.04, 0.3, 0.6, 0.97], GRID.shape)
    measured = generator.random(GRID.shape) < 0.5
    opaque = np.zeros(GRID.shape, dtype=bool)
    for reading in ("histogram", "premultiplied"):
        found = rate(reading, probability, measured, opaque)
        premultiplied = reading == "premultiplied"
        for heading in (0, 7, 23):
            areas = np.zeros((2, 32))
            for ray in (heading * 2 - 6 + np.arange(12)) % RAYS:
                for k in range(TABLE.starts[ray], TABLE.starts[ray + 1]):
                    r, c = HERE[0] + TABLE.offsets[k]
                    p = probability[r, c] if measured[r, c] else TABLE.radii[k] / DEPTH
                    p = p if premultiplied else float(stretch(p))
                    areas[0 if measured[r, c] else 1, min(int(p * 32), 31)] += TABLE.areas[k]
            expected = histogram_entropy(areas, 0.5 * FOV * DEPTH**2, premultiplied)
            assert found[heading] == pytest.approx(expected, rel=1e-9)


def test_unknown_area_at_one_grey_level_has_no_entropy_so_levels_follow_distance():
    one_level = np.zeros((2, 32))
    one_level[1, 16] = 1.0
    assert histogram_entropy(one_level, 1.0) == 0.0
    assert rate("histogram").min() > 0.8


def test_decided_cells_have_no_entropy_and_unmeasured_ones_all():
    probability = np.array([0.04, 0.06, 0.5, 0.94, 0.96, 0.5])
    measured = np.array([True, True, True, True, True, False])
    found = undecided_entropy(probability, measured)
    assert found[[0, 4]].tolist() == [0.0, 0.0]
    assert found[[2, 5]] == pytest.approx([1.0, 1.0])
    assert 0.3 < found[1] == pytest.approx(found[3])


def test_unknown_reading_is_refused_naming_the_valid_ones():
    with pytest.raises(ValueError, match=", ".join(READINGS)):
        rate("grey")
