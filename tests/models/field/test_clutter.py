"""Blocks and the panel: where they stand, what they keep clear, and that they are opt-in."""

import dataclasses
import itertools

import mujoco
import numpy as np
import pytest

from models.clutter import PanelConfig, PanelMarker
from models.compose import FieldConfig, RobotPlacement, build_scene, make_model, make_terrain
from tests.models.scenes import PLAIN, make_scene, warnings

ROBOTS = (RobotPlacement("rover1", (-0.6, -0.8), -0.5), RobotPlacement("rover2", (0.6, -0.8), 0.5))
PANEL = PanelConfig((0.1, 0.4), yaw=0.3, tilt=0.4)
CLUTTERED = FieldConfig((3.2, 3.2), rocks=80, blocks=40, seed=4, texture_pixels=16, panel=PANEL)


@pytest.fixture(scope="module")
def scene():
    return make_scene(*ROBOTS, field=CLUTTERED)


def test_markers_of_the_compiled_scene_are_at_their_cad_positions(scene):
    expected = PANEL.transform_panel_to_world(0.0).apply(PANEL.marker_points)
    for index, (marker, point) in enumerate(zip(PANEL.markers, expected, strict=True)):
        for ending, radius in (("", marker.radius), ("_centre", marker.radius * marker.dark)):
            name = f"panel_marker{index}{ending}"
            assert scene.model.geom(name).size[0] == pytest.approx(radius)
        disc, half = scene.rest.geom(name), scene.model.geom(name).size[1]
        top = disc.xpos + half * disc.xmat.reshape(3, 3)[:, 2]
        np.testing.assert_allclose(top, point, atol=1e-9)


def test_panel_frame_of_the_compiled_scene_is_that_of_the_cad(scene):
    pose, body = PANEL.transform_panel_to_world(0.0), scene.rest.body("panel")
    np.testing.assert_allclose(body.xpos, pose.translation, atol=1e-12)
    np.testing.assert_allclose(body.xmat.reshape(3, 3), pose.rotation.as_matrix(), atol=1e-12)
    x, y, z = pose.rotation.as_matrix().T
    assert x[2] == pytest.approx(0.0, abs=1e-12) and y[2] == pytest.approx(np.cos(PANEL.tilt))
    assert z @ [np.sin(PANEL.yaw), -np.cos(PANEL.yaw), 0.0] == pytest.approx(np.cos(PANEL.tilt))
    assert z[2] == pytest.approx(np.sin(PANEL.tilt))


def test_lower_edge_and_struts_of_the_panel_touch_the_ground(scene):
    edge = PANEL.transform_panel_to_world(0.0).apply([0.0, -PANEL.size[1] / 2, 0.0])
    np.testing.assert_allclose(edge, [*PANEL.position, 0.0], atol=1e-12)
    for index in range(2):
        geom = scene.rest.geom(f"panel_strut{index}")
        half = scene.model.geom(f"panel_strut{index}").size[1]
        ends = geom.xpos[2] + np.array([-1, 1]) * half * geom.xmat[8]
        assert ends.min() == pytest.approx(0.0, abs=1e-9)


def test_distances_between_markers_all_differ_by_more_than_a_centimetre():
    pairs = itertools.combinations(PANEL.marker_points, 2)
    distances = np.sort([np.linalg.norm(a - b) for a, b in pairs])
    assert np.diff(distances).min() > 0.01


def test_clutter_keeps_clear_of_starts_the_panel_and_itself():
    ground = make_terrain(CLUTTERED, ROBOTS)
    blocks, rocks = ground.blocks, ground.rocks
    assert len(blocks.yaws) > 10 and len(rocks.yaws) > 20
    places = np.concatenate([blocks.centres[:, :2], rocks.centres[:, :2]])
    radii = np.concatenate([blocks.radii, rocks.half_sizes[:, :2].max(axis=1)])
    for robot in ROBOTS:
        assert np.all(np.linalg.norm(places - robot.position, axis=1) > 0.4 + radii)
    gap = np.linalg.norm(places - PANEL.position, axis=1)
    assert np.all(gap > PANEL.footprint + radii)
    count = len(blocks.yaws)
    apart = np.linalg.norm(places[:count, None] - places[None], axis=-1)
    apart[np.arange(count), np.arange(count)] = np.inf
    assert np.all(apart > blocks.radii[:, None] + radii)


def test_clear_discs_are_free_of_clutter_and_what_is_left_is_as_without():
    discs = ((-0.9, 0.9, 0.5), (1.0, 0.6, 0.3))
    cleared = make_terrain(dataclasses.replace(CLUTTERED, clear=discs), ROBOTS)
    before = make_terrain(CLUTTERED, ROBOTS)
    for x, y, radius in discs:
        edge = [x, y] + 0.999 * radius * np.stack([np.cos(range(300)), np.sin(range(300))], axis=1)
        grid = np.stack(np.meshgrid(*[np.linspace(-radius, radius, 60)] * 2), axis=-1)
        inside = [x, y] + grid[np.linalg.norm(grid, axis=-1) < radius]
        for points in (inside, edge):
            assert not np.any(cleared.rise_at(points))
        assert np.any(before.rise_at(inside))
    assert 0 < len(cleared.blocks.yaws) < len(before.blocks.yaws)
    # Without blocks, below which there are no rocks either.
    stony = dataclasses.replace(CLUTTERED, blocks=0)
    rocks, former = (
        {tuple(c) for c in make_terrain(field, ROBOTS).rocks.centres}
        for field in (dataclasses.replace(stony, clear=discs), stony)
    )
    assert rocks and rocks < former


@pytest.mark.parametrize("relief", [0.0, 0.02])
def test_surface_rises_over_the_bare_ground_by_rocks_and_blocks_alone(relief):
    field = dataclasses.replace(CLUTTERED, relief=relief, panel=None)
    ground, bare = (make_terrain(f) for f in (field, dataclasses.replace(field, blocks=0, rocks=0)))
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (2000, 2))
    rise = ground.rise_at(points)
    np.testing.assert_allclose(rise, ground.height_at(points) - bare.height_at(points), atol=1e-12)
    assert rise.min() == 0.0 and np.mean(rise > 0.0) > 0.02
    # Brute force: over each solid its own top, over the ground there.
    for index, centre in enumerate(ground.blocks.centres):
        top = centre[2] + ground.blocks.half_sizes[index, 2] - bare.ground_at(centre[:2])
        assert ground.rise_at(centre[:2]) == pytest.approx(top)
    for index, centre in enumerate(ground.rocks.centres):
        top = centre[2] + ground.rocks.half_sizes[index, 2] - bare.ground_at(centre[:2])
        assert ground.rise_at(centre[:2]) >= top - 1e-12


def test_blocks_are_as_large_as_asked_and_inside_the_field():
    blocks = make_terrain(CLUTTERED, ROBOTS).blocks
    low, high = CLUTTERED.block_edge
    edges = 2.0 * blocks.half_sizes
    assert low <= edges.min() and edges.max() <= high
    reach = np.abs(blocks.centres[:, :2]) + blocks.radii[:, None]
    assert reach.max() <= CLUTTERED.size[0] / 2


@pytest.mark.parametrize("relief", [0.0, 0.02])
def test_heights_with_blocks_agree_with_rays_onto_the_compiled_scene(relief):
    field = dataclasses.replace(CLUTTERED, relief=relief, panel=None)
    model, ground = make_model(field, []), make_terrain(field)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (400, 2))
    on_blocks = ground.blocks.centres[:, :2]
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
    for some in (points, on_blocks):
        heights = [
            1.0 - mujoco.mj_ray(model, data, np.array([x, y, 1.0]), down, None, 1, -1, hit)
            for x, y in some
        ]
        error = np.abs(ground.height_at(some) - heights)
        assert np.percentile(error, 95) < (2e-3 if relief else 1e-6)


def test_same_seed_gives_the_same_clutter_and_another_seed_another():
    first, second = make_model(CLUTTERED, ROBOTS), make_model(CLUTTERED, ROBOTS)
    other = make_model(dataclasses.replace(CLUTTERED, seed=5), ROBOTS)
    np.testing.assert_array_equal(first.geom_pos, second.geom_pos)
    np.testing.assert_array_equal(first.tex_data, second.tex_data)
    assert not np.array_equal(first.tex_data, other.tex_data)
    assert first.ngeom != other.ngeom or not np.array_equal(first.geom_pos, other.geom_pos)


def test_a_field_without_clutter_has_none_of_it_and_the_same_rocks_as_one_with():
    bare = dataclasses.replace(CLUTTERED, blocks=0, panel=None)
    model = make_model(bare, ROBOTS)
    names = [model.geom(i).name for i in range(model.ngeom)]
    assert not any(name.startswith(("block", "panel")) for name in names)
    textures = {model.tex(i).name for i in range(model.ntex)}
    assert textures == {"ground", "rock", "sky"}
    all_rocks = {tuple(centre) for centre in make_terrain(bare, ROBOTS).rocks.centres}
    fewer = {tuple(centre) for centre in make_terrain(CLUTTERED, ROBOTS).rocks.centres}
    assert fewer < all_rocks


def test_cluttered_scene_driven_with_noise_for_a_second_gives_no_warning(scene):
    data = scene.start()
    rng = np.random.default_rng(0)
    low, high = scene.model.actuator_ctrlrange.T
    for _ in range(50):
        data.ctrl[:] = rng.uniform(0.5 * low, 0.5 * high)
        mujoco.mj_step(scene.model, data, 20)
    assert not warnings(data)
    assert np.isfinite(data.qpos).all()


def test_robot_at_the_panel_and_panel_over_the_border_are_refused():
    with pytest.raises(ValueError, match="'rover1' starts 0.50 m from the panel; needs 0.67 m"):
        field = dataclasses.replace(PLAIN, panel=PanelConfig((0.0, 0.5)))
        build_scene(field, [RobotPlacement()])
    with pytest.raises(ValueError, match=r"panel stands at \(2.9, 0.0\).* 6.0 x 6.0 m"):
        build_scene(dataclasses.replace(PLAIN, panel=PanelConfig((2.9, 0.0))), [])


@pytest.mark.parametrize(
    "bad",
    [
        lambda: PanelConfig((float("nan"), 0.0)),
        lambda: PanelConfig(tilt=-0.1),
        lambda: PanelConfig(size=(0.0, 0.3)),
        lambda: PanelConfig(markers=(PanelMarker(0.19, 0.0),)),
        lambda: PanelConfig(markers=(PanelMarker(0.0, 0.0, dark=1.5),)),
        lambda: FieldConfig(blocks=-1),
        lambda: FieldConfig(clear=((0.0, 0.0, 0.0),)),
        lambda: FieldConfig(clear=((0.0, float("inf"), 0.3),)),
        lambda: FieldConfig(block_edge=(0.2, 0.1)),
        lambda: FieldConfig(texture_tile=0.0),
    ],
)
def test_impossible_clutter_is_refused_with_what_is_valid(bad):
    with pytest.raises(ValueError, match="got .*, needs "):
        bad()
