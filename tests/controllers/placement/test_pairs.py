"""Two cameras at once: the best of all pairs, and neither camera occludes the other."""

import itertools

import numpy as np
import pytest

from controllers.placement.pairs import VisionSystem, _apart, best_pair, go_together
from controllers.placement.spatial.occluders import expand
from controllers.placement.spatial.search import (
    SearchConfig,
    SpatialTask,
    rate_directions,
    rate_positions,
)
from controllers.placement.spatial.sight import sees_all
from controllers.placement.task import Lens, PlacementError
from tests.controllers.placement.spatial.scenes import LENS, box, disc_target, random_occluders

COARSE = SearchConfig(level=2, rings=5, refine=False)
FIRST = VisionSystem("left", LENS)
SECOND = VisionSystem("right", Lens(0.6, 640, 0.2, 0.8), body_radius=0.05)


def fields_of(rng, count):
    made = []
    while len(made) < count:
        target = disc_target(f"hole {len(made)}", rng.normal(size=3) * 0.1, rng.normal(size=3))
        try:
            made.append(expand(target, random_occluders(rng, 6, target)))
        except PlacementError:
            continue
    return made


@pytest.mark.parametrize("targets", [1, 2])
def test_best_pair_is_the_best_of_all_pairs(targets):
    rng = np.random.default_rng(targets)
    for _ in range(3):
        fields = fields_of(rng, targets)
        found = best_pair(fields, (FIRST, SECOND), config=COARSE)
        lists = []
        for system in (FIRST, SECOND):
            rated = rate_directions(SpatialTask(fields, system.lens, None, COARSE))
            lists.append([
                rate_positions(fields[number], system.lens, place)[0]
                for place, number in zip(rated.positions, rated.fields)
            ])  # fmt: skip
        best = max(
            a.rating * b.rating
            for a, b in itertools.product(*lists)
            if go_together(fields, (FIRST, SECOND), (a, b))
        )
        assert found[0].rating * found[1].rating == pytest.approx(best, rel=1e-9)
        assert go_together(fields, (FIRST, SECOND), found)


def test_distance_of_segments_is_that_of_their_nearest_points():
    rng = np.random.default_rng(3)
    along = np.linspace(0.0, 1.0, 300)[:, None]
    for _ in range(25):
        a, b, c, d = rng.normal(size=(4, 3))
        first, second = a + along * (b - a), c + along * (d - c)
        nearest = np.linalg.norm(first[:, None] - second, axis=2).min()
        assert nearest - 0.02 <= _apart(a, b, c, d) <= nearest + 1e-12
    point = np.zeros(3)
    assert _apart(point, point, c, c) == pytest.approx(np.linalg.norm(c))
    assert _apart(point, 2 * c, c, 3 * c) == pytest.approx(0.0, abs=1e-12)


def test_each_still_sees_all_of_its_target_past_the_others_body():
    field = expand(disc_target(), [])
    views = best_pair([field], (FIRST, FIRST))
    directions = [view.position / view.distance for view in views]
    assert np.arccos(directions[0] @ directions[1]) >= np.deg2rad(30.0)
    for mine, other in (views, views[::-1]):
        # A box about the other's rod.
        back = other.position / other.distance
        side = np.cross(back, [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        axes = np.array([side, np.cross(back, side), back])
        body = box("body", np.zeros(3), [FIRST.body_radius / 2**0.5] * 2 + [0.075])
        rod = type(body)("body", body.points @ axes + other.position + 0.075 * back)
        assert sees_all(field.target, [rod], [mine.position])[0]


def test_no_pair_and_no_view_are_answers():
    chimney = [
        box(f"side {i}", [0.06 * x, 0.06 * y, 0.3], [0.04 if x else 0.1, 0.04 if y else 0.1, 0.3])
        for i, (x, y) in enumerate([(1, 0), (-1, 0), (0, 1), (0, -1)])
    ]
    field = expand(disc_target(), chimney)
    with pytest.raises(PlacementError, match="no two poses go together for 'left' and 'right'"):
        best_pair([field], (FIRST, SECOND), config=SearchConfig(level=5, rings=5))
    with pytest.raises(PlacementError, match="no pose sees the target 'hole'"):
        best_pair(
            [expand(disc_target(), [*chimney, box("lid", [0, 0, 0.06], [0.1, 0.1, 0.01])])],
            (FIRST, SECOND),
            config=COARSE,
        )
    with pytest.raises(ValueError, match="vision system 'odd'"):
        VisionSystem("odd", LENS, body_radius=-1.0)
