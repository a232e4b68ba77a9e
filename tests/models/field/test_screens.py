"""Screens: where they stand, what they hide, and what keeps clear of them."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from models.clutter import PanelConfig, ScreenConfig
from models.compose import FieldConfig, RobotPlacement, build_scene, make_model, make_terrain
from tests.models.scenes import PLAIN, make_scene, warnings
from twin.hardware.emulator.scene import SceneConfig

PANEL = PanelConfig((0.2, 1.2), yaw=0.2, tilt=0.3)
WALL = ScreenConfig((0.1, 0.5), yaw=0.15)
PILLAR = ScreenConfig((-0.9, 0.3), yaw=0.5, size=(0.1, 0.1, 0.45))
FIELD = FieldConfig((4.0, 4.0), texture_pixels=16, panel=PANEL, screens=(WALL, PILLAR), seed=2)
EYE = np.array([0.05, -0.3, 0.35])
"""Place of a camera before the wall."""


def forwarded(field, robots=()):
    model = make_model(field, robots)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def hit_by(model, data, start, towards):
    """Return the name of what a ray hits, and its distance [m]."""
    geom = np.zeros(1, dtype=np.int32)
    ray = (towards - start) / np.linalg.norm(towards - start)
    distance = mujoco.mj_ray(model, data, start, ray, None, 1, -1, geom)
    return model.geom(int(geom[0])).name, distance


@pytest.mark.parametrize("relief", [0.0, 0.02])
def test_wall_hides_every_marker_of_the_panel_from_a_camera_before_it(relief):
    field = dataclasses.replace(FIELD, relief=relief)
    model, data = forwarded(field)
    bare_model, bare = forwarded(dataclasses.replace(field, screens=()))
    for index in range(len(PANEL.markers)):
        marker = data.geom(f"panel_marker{index}_centre").xpos
        assert hit_by(bare_model, bare, EYE, marker)[0] == f"panel_marker{index}_centre"
        name, distance = hit_by(model, data, EYE, marker)
        assert name == "screen0"
        assert distance < 0.8 * np.linalg.norm(marker - EYE)


def test_screen_has_its_size_and_stands_where_it_is_put():
    model, data = forwarded(FIELD)
    for index, screen in enumerate(FIELD.screens):
        geom = model.geom(f"screen{index}")
        np.testing.assert_allclose(2.0 * geom.size[:2], screen.size[:2])
        np.testing.assert_allclose(geom.pos[:2], screen.position)
        assert geom.pos[2] + geom.size[2] == pytest.approx(screen.size[2])
        across = data.geom(f"screen{index}").xmat.reshape(3, 3)[:, 0]
        np.testing.assert_allclose(across, [math.cos(screen.yaw), math.sin(screen.yaw), 0.0])
        assert model.mat(geom.matid[0]).name == "block"
        corners = data.geom(f"screen{index}").xpos[:2] + np.array(
            [
                [a * screen.size[0] / 2, b * screen.size[1] / 2]
                for a, b in ((-1, -1), (1, -1), (-1, 1), (1, 1))
            ]
        ) @ np.array(
            [[math.cos(screen.yaw), math.sin(screen.yaw)],
             [-math.sin(screen.yaw), math.cos(screen.yaw)]]
        )  # fmt: skip
        np.testing.assert_allclose(screen.footprint(), corners, atol=1e-12)


@pytest.mark.parametrize("relief", [0.0, 0.03])
def test_heights_over_screens_are_those_of_rays_and_no_gap_is_below_them(relief):
    field = dataclasses.replace(FIELD, relief=relief, panel=None)
    ground = make_terrain(field)
    model, data = forwarded(field)
    for index, screen in enumerate(field.screens):
        points = screen.footprint(0.01) * 0.98 + 0.02 * np.array(screen.position)
        heights = ground.height_at(points)
        for (x, y), height in zip(points[::37], heights[::37]):
            name, distance = hit_by(model, data, np.array([x, y, 2.0]), np.array([x, y, -1.0]))
            assert name == f"screen{index}" and 2.0 - distance == pytest.approx(height, abs=1e-9)
        top = ground.ground_at(np.array(screen.position)) + screen.size[2]
        np.testing.assert_allclose(heights, top)
        rise = ground.rise_at(np.array(screen.position))
        assert rise == pytest.approx(screen.size[2])
        bottom = ground.screens.centres[index, 2] - ground.screens.half_sizes[index, 2]
        assert bottom < ground.ground_at(screen.footprint(0.005)).min()


def test_rocks_and_blocks_keep_clear_of_screens_and_are_else_as_without():
    crowded = dataclasses.replace(FIELD, rocks=900, blocks=60, size=(4.0, 4.0))
    ground, before = make_terrain(crowded), make_terrain(dataclasses.replace(crowded, screens=()))
    covered = np.concatenate([screen.footprint(0.01) for screen in crowded.screens])
    nothing = dataclasses.replace(ground, screens=before.screens)
    assert not np.any(nothing.rise_at(covered)) and np.any(before.rise_at(covered))
    rocks, former = ({tuple(c) for c in t.rocks.centres} for t in (ground, before))
    assert len(rocks) > 500 and len(rocks - former) < 5  # Where a block is gone.


def test_discs_cover_the_footprint_and_reach_little_further():
    for screen in (WALL, PILLAR, ScreenConfig((0.3, -0.2), 0.7, (0.2, 1.1, 0.3))):
        points = screen.footprint(0.005)
        distances = np.linalg.norm(points[:, None] - screen.discs[:, :2], axis=-1)
        assert np.all((distances <= screen.discs[:, 2] + 1e-12).any(axis=1))
        reach = [screen.distance(m) + r for *m, r in screen.discs]
        assert max(reach) < 0.75 * min(screen.size[:2])


def test_distance_of_a_point_is_that_of_the_nearest_point_of_the_footprint():
    rng = np.random.default_rng(0)
    fine = WALL.footprint(0.002)
    for point in rng.uniform(-1.0, 1.5, (40, 2)):
        nearest = np.linalg.norm(fine - point, axis=1).min()
        assert WALL.distance(point) == pytest.approx(nearest, abs=2e-3)
    assert WALL.distance(WALL.position) == 0.0


def test_field_without_screens_is_as_before_and_one_with_them_keeps_its_ground():
    bare = dataclasses.replace(FIELD, relief=0.02, blocks=5, screens=())
    plain, screened = (
        make_model(f, ()) for f in (bare, dataclasses.replace(bare, screens=(WALL,)))
    )
    np.testing.assert_array_equal(plain.hfield_data, screened.hfield_data)
    np.testing.assert_array_equal(plain.tex_data, screened.tex_data)
    names = [
        {model.geom(i).name for i in range(model.ngeom)} - {f"block{i}" for i in range(5)}
        for model in (plain, screened)
    ]
    assert names[1] - names[0] == {"screen0"} and names[0] < names[1]


def test_rover_drives_against_a_wall_and_no_further():
    wall = ScreenConfig((0.0, 0.6), size=(0.9, 0.12, 0.6))
    scene = make_scene(RobotPlacement(), field=dataclasses.replace(PLAIN, screens=(wall,)))
    data = scene.start()
    for index in range(4):
        data.ctrl[index] = 6.0
    scene.run(data, 6.0)
    # The wheels' front is a radius ahead of the axle, which is 0.15 m ahead of the middle.
    assert data.body("rover1/chassis").xpos[1] == pytest.approx(0.54 - 0.1987, abs=0.03)
    assert not warnings(data)


def test_scene_with_screens_reaches_an_emulator_in_words():
    config = SceneConfig((RobotPlacement(position=(0.0, -1.0)),), FIELD)
    assert SceneConfig.from_json(config.to_json()) == config


@pytest.mark.parametrize(
    "screen, reason",
    [
        (ScreenConfig((0.0, -0.7)), r"stands 0.24 m from the start of robot 'rover1'; needs 0.40"),
        (ScreenConfig((0.3, 1.0)), "stands 0.14 m from the panel; needs 0.27 m"),
        (ScreenConfig((1.8, 0.0)), "stands over the edge of the field of 4.0 x 4.0 m"),
    ],
)
def test_screen_at_a_start_at_the_panel_or_over_the_edge_is_refused(screen, reason):
    field = dataclasses.replace(FIELD, screens=(PILLAR, screen))
    with pytest.raises(ValueError, match=f"screen 1 at .*{reason}"):
        build_scene(field, [RobotPlacement(position=(0.0, -1.0))])


@pytest.mark.parametrize(
    "bad",
    [
        lambda: ScreenConfig((math.nan, 0.0)),
        lambda: ScreenConfig((0.0, 0.0), math.inf),
        lambda: ScreenConfig((0.0, 0.0), 0.0, (0.9, 0.0, 0.6)),
        lambda: ScreenConfig((0.0, 0.0), 0.0, (0.9, 0.12, 6.0)),
    ],
)
def test_impossible_screens_are_refused_with_what_is_valid(bad):
    with pytest.raises(ValueError, match="screen .*: got .*, needs "):
        bad()


@pytest.mark.parametrize("tile", [0.5, 2.0])
def test_each_face_of_a_wall_bears_the_whole_texture_of_a_block_whatever_the_grounds(tile):
    """On a uniform one a wide face bears the streaks of a ball's surface seen from its middle."""
    field = FieldConfig(
        size=(4.0, 4.0),
        rocks=1,
        texture_pixels=64,
        texture_tile=tile,
        screens=(ScreenConfig((1.0, 0.0), 0.0, (1.0, 0.1, 0.6)),),
    )
    model = make_model(field, ())
    uniform = {model.mat(i).name: bool(model.mat_texuniform[i]) for i in range(model.nmat)}
    assert uniform == {"ground": True, "rock": False, "block": False}
    repeats = model.mat_texrepeat[model.mat("ground").id]
    np.testing.assert_allclose(repeats, 2.0 / tile)
