"""Scenes: names, errors, seeds, ground."""

import dataclasses

import mujoco
import numpy as np
import pytest

from models import compose
from models.compose import (
    ROUGH,
    WHEELS,
    FieldConfig,
    PayloadConfig,
    RobotPlacement,
    build_scene,
    load_part,
    make_model,
    make_terrain,
)
from models.terrain import noise_image
from tests.models.scenes import PLAIN, make_scene

TWO = (RobotPlacement("rover1"), RobotPlacement("rover2", (1.0, 0.0), 0.5))


def test_every_robot_has_the_same_names_behind_its_prefix():
    model = make_model(PLAIN, TWO)
    names = [model.sensor(i).name.partition("/") for i in range(model.nsensor)]
    first, second = ({n[2] for n in names if n[0] == robot.name} for robot in TWO)
    assert first == second
    assert {"arm_base_force", "arm_base_torque", "wrist_pos", "orientation"} <= first
    assert [model.actuator(i).name for i in range(4)] == [f"rover1/{w}" for w in WHEELS]
    assert model.ncam == 4


def test_scene_has_the_simulation_options_of_the_project():
    option = make_model(PLAIN, TWO).opt
    assert option.timestep == 0.001
    assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert option.jacobian == mujoco.mjtJacobian.mjJAC_SPARSE
    assert option.impratio == 10.0


def test_scene_xml_can_be_read_back():
    scene = build_scene(dataclasses.replace(PLAIN, rocks=20), TWO)
    model = scene.compile()
    for texture in list(scene.textures):
        if texture.name in ("ground", "rock"):  # image data has no place in XML
            scene.delete(texture)
    for material in scene.materials:
        material.textures = [""] * len(material.textures)
    again = mujoco.MjModel.from_xml_string(scene.to_xml())
    assert again.nq == model.nq
    assert again.nsensor == model.nsensor
    np.testing.assert_allclose(again.actuator_gainprm, model.actuator_gainprm, rtol=1e-5)


def test_two_robots_of_one_name_are_refused_by_name():
    with pytest.raises(ValueError, match="two robots are called 'rover1'.*rover2"):
        build_scene(PLAIN, [RobotPlacement("rover1"), RobotPlacement("rover1", (1.0, 0.0))])


def test_robot_outside_the_field_is_refused():
    with pytest.raises(ValueError, match="'rover1' starts at .* of 6.0 x 6.0 m"):
        build_scene(PLAIN, [RobotPlacement(position=(0.0, 2.9))])


def test_patterned_decks_look_like_blocks_and_need_them():
    robots = (dataclasses.replace(TWO[0], patterned=True), TWO[1])
    model = make_model(dataclasses.replace(PLAIN, blocks=3), robots)
    looks = {
        name: model.material(int(model.geom(f"{name}/{end}_deck").matid[0])).name
        for name in ("rover1", "rover2")
        for end in ("front", "rear")
    }
    assert looks == {"rover1": "block", "rover2": "rover2/rover_deck"}
    with pytest.raises(ValueError, match="robot 'rover1' is patterned"):
        make_model(PLAIN, robots)


def test_unknown_part_is_refused_with_the_parts_there_are():
    with pytest.raises(ValueError, match="no model part 'legs'; there are arm, .*rover"):
        load_part("legs")


def test_unreadable_mjcf_is_refused_with_its_path(tmp_path, monkeypatch):
    monkeypatch.setattr(compose, "FOLDER", tmp_path)
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "arm.xml").write_text("<mujoco><worldbody><bod/></worldbody></mujoco>")
    with pytest.raises(ValueError, match="'arm' is not valid MJCF .*arm.xml.*bod"):
        load_part("arm")


@pytest.mark.parametrize(
    "bad",
    [
        lambda: RobotPlacement("a/b"),
        lambda: RobotPlacement(""),
        lambda: RobotPlacement(arm=False, payload=PayloadConfig(0.1)),
        lambda: PayloadConfig(-0.1),
        lambda: PayloadConfig(0.1, half_size=(0.0, 1.0, 1.0)),
        lambda: FieldConfig(friction=0.0),
        lambda: FieldConfig(relief=-1.0),
        lambda: FieldConfig(texture_pixels=100),
        lambda: FieldConfig(rock_radius=(0.1, 0.05)),
        lambda: FieldConfig(rocks=-1),
        lambda: FieldConfig(size=(float("inf"), 1.0)),
        lambda: RobotPlacement(position=(float("nan"), 0.0)),
        lambda: RobotPlacement(yaw=float("inf")),
        lambda: PayloadConfig(0.1, centre=(0.0, float("nan"), 0.0)),
        lambda: FieldConfig(friction=float("nan")),
    ],
)
def test_impossible_configuration_is_refused_with_what_is_valid(bad):
    with pytest.raises(ValueError, match="got .*, needs "):
        bad()


def test_friction_of_the_field_reaches_the_contacts():
    scene = make_scene(RobotPlacement(), field=dataclasses.replace(PLAIN, friction=0.3))
    np.testing.assert_allclose([c.friction[0] for c in scene.rest.contact], 0.3)


def test_locked_centre_stays_at_zero_under_a_roll_couple():
    scene = make_scene(RobotPlacement(centre_locked=True))
    data = scene.start()
    data.xfrc_applied[scene.model.body("rover1/rear_chassis").id, 4] = 1.0
    scene.run(data, 0.5)
    assert abs(data.joint("rover1/centre_joint").qpos[0]) < 1e-3


def test_payload_lies_where_it_is_put_in_the_grippers_frame():
    load = PayloadConfig(0.2, centre=(0.01, 0.02, -0.03))
    model = make_model(PLAIN, [RobotPlacement(payload=load)])
    body = model.body("rover1/payload")
    assert body.mass[0] == pytest.approx(0.2)
    offset = body.pos - model.site("rover1/gripper").pos
    np.testing.assert_allclose(offset, load.centre)


def test_same_seed_gives_the_same_scene_and_another_seed_another():
    field = dataclasses.replace(ROUGH, texture_pixels=64)
    first, second = make_model(field, TWO), make_model(field, TWO)
    other = make_model(dataclasses.replace(field, seed=1), TWO)
    np.testing.assert_array_equal(first.hfield_data, second.hfield_data)
    np.testing.assert_array_equal(first.tex_data, second.tex_data)
    np.testing.assert_array_equal(first.geom_pos, second.geom_pos)
    assert not np.array_equal(first.hfield_data, other.hfield_data)
    assert not np.array_equal(first.tex_data, other.tex_data)


def test_terrain_heights_agree_with_rays_onto_the_compiled_scene():
    field = dataclasses.replace(ROUGH, texture_pixels=16)
    model, ground = make_model(field, []), make_terrain(field)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = np.random.default_rng(0).uniform(-2.9, 2.9, (300, 2))
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
    heights = [
        1.0 - mujoco.mj_ray(model, data, np.array([x, y, 1.0]), down, None, 1, -1, hit)
        for x, y in points
    ]
    error = np.abs(ground.height_at(points) - heights)
    assert np.percentile(error, 95) < 2e-3  # a cell is two triangles there, bilinear here


def test_relief_and_rocks_are_as_large_as_asked():
    ground = make_terrain(ROUGH, TWO)
    assert ground.heights.std() == pytest.approx(ROUGH.relief, rel=0.1)
    low, high = ROUGH.rock_radius
    mean = np.sqrt(ground.rocks.half_sizes[:, 0] * ground.rocks.half_sizes[:, 1])
    assert low <= mean.min() and mean.max() <= high
    for robot in TWO:
        gap = np.linalg.norm(ground.rocks.centres[:, :2] - robot.position, axis=1)
        assert gap.min() > 0.4


def test_noise_image_is_seamless_and_normalised():
    image = noise_image(np.random.default_rng(0), 256, 6)
    assert image.mean() == pytest.approx(0.0, abs=1e-12)
    assert image.std() == pytest.approx(1.0)
    seam = np.abs(image[0] - image[-1]).mean()
    inside = np.abs(np.diff(image, axis=0)).mean()
    assert seam < 1.5 * inside


@pytest.mark.parametrize("field", [PLAIN, dataclasses.replace(ROUGH, texture_pixels=16)])
def test_robots_settle_on_their_wheels(field):
    scene = make_scene(*TWO, field=field)
    assert np.abs(scene.rest.qvel).max() < 0.05
    touched = {scene.model.geom(int(geom)).name for geom in np.unique(scene.rest.contact.geom)}
    for robot in TWO:
        assert sum(f"{robot.name}/{wheel}_tyre" in touched for wheel in WHEELS) >= 3
        up = scene.rest.body(f"{robot.name}/chassis").xmat[8]
        assert up > 0.9
