"""Placement in space: its parts on small cases, its options, and a small run end to end."""

import json

import numpy as np
import pytest

from controllers.placement.spatial.sight import sees_all
from experiments.ch4.spatial import stereo as ch4_stereo
from experiments.ch4.spatial.blocks import (
    BlocksTrial,
    RenderedBlocks,
    believed_blocks,
    hole_of,
    occluders_of,
    occupancy_of,
    run_blocks,
)
from experiments.ch4.spatial.search import LENS, SpatialSearchTrial, disc, run_search
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from models.blocks import FIGURE_4_12, draw_arrangement


def test_polygon_holds_the_disc_and_touches_it_on_the_axes():
    outline = disc("hole", 0.01, np.zeros(3), np.array([0.0, 0.0, 1.0])).outline
    turn = np.linspace(0.0, 2.0 * np.pi, 1000)
    rim = 0.01 * np.column_stack([np.cos(turn), np.sin(turn)])
    edges = np.roll(outline, -1, axis=0) - outline
    across = np.cross(edges, [0.0, 0.0, 1.0])[:, :2]
    assert np.all(rim @ across.T <= np.sum(outline[:, :2] * across, axis=1) + 1e-12)
    np.testing.assert_allclose(outline[:, :2].max(axis=0), 0.01)


def test_both_searches_agree_and_hulls_see_no_more_than_there_is():
    for seed, patchy in ((1, False), (2, True)):
        result = run_search(SpatialSearchTrial(seed, 5, patchy))
        assert result.match
        assert result.gain >= 1.0 - 1e-12
        assert not np.any((result.hull == 1) & (result.exact == 0))


def test_rendered_hole_is_whole_just_where_exact_sight_agrees():
    rng = np.random.default_rng(1)
    arrangement = draw_arrangement(rng, 8)
    target, rendered = hole_of(arrangement), RenderedBlocks(arrangement)
    rays = rng.normal(size=(24, 3))
    rays[:, 2] = 0.2 + np.abs(rays[:, 2])
    places = rays / np.linalg.norm(rays, axis=1, keepdims=True) * rng.uniform(0.15, 0.3, (24, 1))
    parts = np.array([rendered.seen(place, target.position)[0] for place in places])
    whole = sees_all(target, occluders_of(arrangement.blocks), places)
    assert 4 < whole.sum() < 20
    assert np.all(parts[whole] > 0.999)
    # The polygon about the disc is larger than it, by 3.5 % in its corners.
    assert np.count_nonzero(parts[~whole] > 0.999) <= 2


def test_camera_is_kept_off_blocks_and_face():
    blocks = believed_blocks(FIGURE_4_12.blocks, np.random.default_rng(0))
    occupancy = occupancy_of(blocks, [0.0] * len(blocks))
    wall = np.array(blocks[0].centre)
    places = np.array([wall, wall + [0.06, 0, 0.03], wall + [0.0, 0.0, 0.2], [0.1, 0.0, 0.02]])
    np.testing.assert_array_equal(occupancy(places), [1.0, 0.0, 0.0, 1.0])


def test_planned_pose_sees_the_whole_hole():
    result = run_blocks(BlocksTrial(5, 8))
    assert result is not None
    assert result.optimal > 0.98
    assert result.pixels > 2.0 * np.median(result.random_pixels)


@pytest.mark.parametrize(
    ("options", "named"),
    [({"scenes": 0}, "--scenes: expected at least 1, got 0"), ({"blocks": 40}, "--blocks 40"),
     ({"target": "slot"}, "--target slot: the work-piece has hole0, hole1, hole2")],
)  # fmt: skip
def test_bad_options_are_named(options, named):
    with pytest.raises(OptionError, match=named):
        ch4_stereo.Options(**options)


@pytest.mark.slow
def test_a_small_run_finds_the_thesis_optimum(tmp_path):
    options = ch4_stereo.Options(scenes=4, seeds=2, jobs=1, out=tmp_path, record=True)
    output = Output("ch4-stereo", options)
    ch4_stereo.run(options, output)
    output.finish()
    folder = tmp_path / "ch4-stereo"
    metrics = json.loads((folder / "metrics.json").read_text())
    measured = metrics["measured"]
    assert measured["optimum_r_inch"] == pytest.approx(5.0, abs=0.05)
    assert measured["optimum_theta_deg"] == pytest.approx(0.0, abs=0.5)
    assert measured["optimum_phi_deg"] == pytest.approx(60.0, abs=0.5)
    assert measured["search_match_fraction"] == 1.0
    assert measured["hull_false_visible"] == 0
    assert measured["visible_fraction/optimal"]["mean"] > 0.98
    assert LENS.near == pytest.approx(0.127)
    for name in ("figure_4-12", "figure_4-13", "figure_4-4_sphere", "searches", "seen"):
        assert (folder / "figures" / f"{name}.png").is_file()
    assert (folder / "run.rrd").stat().st_size > 10_000
