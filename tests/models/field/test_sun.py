"""The sun of a field: where it stands by its seed, and where its shadows fall."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from models.compose import FieldConfig, build_scene, compile_scene, make_model
from models.configuration import SUN_ELEVATION

FIELD = FieldConfig(texture_pixels=16, sun_elevation=SUN_ELEVATION)


def towards(field):
    """Direction to the sun (3,)."""
    return -make_model(field, ()).light("sun").dir


def test_sun_stands_at_every_azimuth_and_at_the_elevations_of_its_range():
    suns = np.array([towards(dataclasses.replace(FIELD, seed=seed)) for seed in range(40)])
    np.testing.assert_allclose(np.linalg.norm(suns, axis=1), 1.0, atol=1e-6)
    elevation = np.arcsin(suns[:, 2])
    low, high = SUN_ELEVATION
    assert np.all((low - 1e-6 <= elevation) & (elevation <= high + 1e-6))
    # Of 40 uniform numbers, all in half of the range once in 10^12.
    assert elevation.min() < 0.5 * (low + high) < elevation.max()
    azimuth = np.arctan2(suns[:, 1], suns[:, 0])
    assert all(
        np.any((azimuth > quarter) & (azimuth < quarter + 1.6)) for quarter in (-3.14, -1.6, 0, 1.5)
    )


def test_one_seed_has_one_sun_and_the_same_ground_with_any():
    np.testing.assert_array_equal(towards(FIELD), towards(FIELD))
    plain, sunny = (
        make_model(dataclasses.replace(FIELD, rocks=20, sun_elevation=range_), ())
        for range_ in (None, SUN_ELEVATION)
    )
    np.testing.assert_array_equal(plain.geom_pos, sunny.geom_pos)
    np.testing.assert_array_equal(plain.tex_data, sunny.tex_data)
    former = np.array([-0.35, 0.5, -1.0])
    np.testing.assert_allclose(plain.light("sun").dir, former / np.linalg.norm(former), atol=1e-6)


@pytest.mark.parametrize("place", [(0.0, 0.0), (2.0, -1.5), (-2.2, 2.1)])
def test_shadow_of_a_ball_falls_where_the_sun_s_ray_through_it_meets_the_ground(place):
    elevation = math.radians(50.0)
    scene = build_scene(dataclasses.replace(FIELD, sun_elevation=(elevation, elevation)), ())
    height, radius = 0.3, 0.06
    body = scene.worldbody.add_body(pos=[*place, height])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], rgba=[1, 1, 1, 1])
    scene.geom("ground").material, scene.geom("ground").rgba = "", [0.5, 0.5, 0.5, 1.0]
    scene.worldbody.add_camera(name="above", pos=[*place, 3.0], fovy=40.0)
    model = compile_scene(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    model.vis.global_.offwidth = model.vis.global_.offheight = 300
    with mujoco.Renderer(model, 300, 300) as renderer:
        renderer.update_scene(data, "above")
        image = renderer.render().astype(float).mean(axis=2)
    ray = model.light("sun").dir
    shadow = np.array(place) + ray[:2] * height / -ray[2]
    scale = 150.0 / math.tan(math.radians(20.0)) / 3.0
    across, up = scale * (shadow - place)
    column, row = 149.5 + across, 149.5 - up
    lit = np.median(image)
    dark = np.argwhere(image < 0.8 * lit)
    assert image[round(row), round(column)] < 0.8 * lit
    np.testing.assert_allclose(dark.mean(axis=0), [row, column], atol=1.5)
    # The shadow's area on level ground is the ball's outline over the sine of the elevation.
    area = math.pi * radius**2 / math.sin(elevation) * scale**2
    assert len(dark) == pytest.approx(area, rel=0.15)


@pytest.mark.parametrize("wrong", [(0.0, 0.5), (0.6, 0.5), (0.5, 2.0)])
def test_impossible_sun_is_refused(wrong):
    with pytest.raises(ValueError, match="field sun_elevation"):
        FieldConfig(sun_elevation=wrong)
