"""The blocks scene: what is drawn is what is planned on."""

import mujoco
import numpy as np
import pytest

from models.blocks import (
    CAMERA_NAME,
    FIGURE_4_12,
    THICKNESS,
    Arrangement,
    Block,
    build_blocks,
    draw_arrangement,
    place_camera,
)
from twin.camera import camera_model, camera_pose


def compiled(arrangement, mask=False):
    model = build_blocks(arrangement, mask).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_corners_are_those_of_the_compiled_geoms():
    arrangement = draw_arrangement(np.random.default_rng(0), 6)
    model, data = compiled(arrangement)
    for block in arrangement.blocks:
        geom = model.geom(block.name).id
        turn = data.geom_xmat[geom].reshape(3, 3)
        local = (block.corners - data.geom_xpos[geom]) @ turn
        np.testing.assert_allclose(np.abs(local), np.tile(model.geom_size[geom], (8, 1)), atol=1e-9)


def test_drawn_blocks_are_on_the_ground_apart_and_clear_of_the_hole():
    for seed in range(5):
        arrangement = draw_arrangement(np.random.default_rng(seed), 8)
        model, data = compiled(arrangement)
        geoms = [model.geom(block.name).id for block in arrangement.blocks]
        for block in arrangement.blocks:
            assert block.corners[:, 2].min() == pytest.approx(-THICKNESS)
        segment = np.empty(6)
        for index, first in enumerate(geoms):
            hole = model.geom("hole0").id
            assert mujoco.mj_geomDistance(model, data, first, hole, 1.0, segment) > 0.009
            for second in geoms[index + 1 :]:
                assert mujoco.mj_geomDistance(model, data, first, second, 1.0, segment) > 0.0


def test_same_seed_draws_the_same_arrangement():
    first, second = (draw_arrangement(np.random.default_rng(3), 8) for _ in range(2))
    assert first == second


def test_wall_of_figure_4_12_stands_at_sixty_degrees_and_no_other_block_is_as_near():
    radius = FIGURE_4_12.hole_radius
    wall, *others = FIGURE_4_12.blocks
    edge = wall.corners.max(axis=0) + [radius, 0.0, 0.0]
    assert np.rad2deg(np.arctan2(edge[2], -edge[0])) == pytest.approx(60.0)
    view = np.array([np.cos(np.pi / 3), 0.0, np.sin(np.pi / 3)])
    grid = np.linspace(0.0, 1.0, 15)
    part = np.array(np.meshgrid(grid, grid, grid)).reshape(3, -1).T
    for block in others:
        low, high = block.corners.min(axis=0), block.corners.max(axis=0)
        wide = radius * np.array([1.0, 1.0, 0.0]) / np.cos(np.pi / 12)
        points = (low - wide) + part * (high - low + 2 * wide)
        far = np.linalg.norm(points, axis=1)
        hiding = (far <= 5 * 0.0254) & (points[:, 2] > 0.0)
        cosines = points[hiding] @ view / far[hiding]
        assert np.all(cosines < 0.5)


def test_camera_looks_at_its_aim_with_the_data_sheets_lens():
    model, data = compiled(FIGURE_4_12)
    for position in ([0.1, -0.2, 0.3], [0.0, 0.0, 0.4]):
        aim = np.array([0.01, 0.0, 0.0])
        place_camera(model, data, np.array(position), aim)
        turn, place = camera_pose(data, model.camera(CAMERA_NAME).id)
        np.testing.assert_allclose(place, position)
        seen = camera_model(model, CAMERA_NAME).pixels((aim - place)[None] @ turn)
        np.testing.assert_allclose(seen, [[254.5, 245.5]], atol=1e-6)


def test_impossible_arrangements_are_refused_by_name():
    with pytest.raises(ValueError, match="block 'thin'"):
        Block("thin", (0, 0, 0), (0.1, 0.0, 0.1))
    twin = Block("twin", (0, 0, 0), (0.1, 0.1, 0.1))
    with pytest.raises(ValueError, match="block 'twin': there are two"):
        Arrangement((twin, twin))
    with pytest.raises(ValueError, match="hole at"):
        Arrangement((), holes=((0.5, 0.0),))
    with pytest.raises(ValueError, match="99 blocks: only"):
        draw_arrangement(np.random.default_rng(0), 99)
