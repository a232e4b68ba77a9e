"""Frustum culling: the driver does not get what a camera does not see, and no image shows that."""

import mujoco
import numpy as np
import pytest

import twin.camera
from twin.camera import cull, renderer, shadow_reach

KINDS = ("sphere", "capsule", "ellipsoid", "cylinder", "box")
INTRINSIC = 'focal="0.0085 0.0085" sensorsize="0.0064 0.0048" principal="0.0011 -0.0007"'


def crowd_xml(camera: str, light: str = "false", count: int = 150) -> str:
    """Return a plane with bodies strewn all around a camera that views some of them."""
    rng = np.random.default_rng(5)
    geoms = ""
    for index in range(count):
        place, turn = rng.uniform(-1.5, 1.5, 3), rng.uniform(-1.0, 1.0, 3)
        size, colour = rng.uniform(0.03, 0.3, 3), rng.uniform(0.2, 1.0, 3)
        geoms += (
            f'<geom type="{KINDS[index % 5]}" pos="{place[0]} {place[1]} {place[2]}" '
            f'euler="{turn[0]} {turn[1]} {turn[2]}" size="{size[0]} {size[1]} {size[2]}" '
            f'rgba="{colour[0]} {colour[1]} {colour[2]} 1"/>'
        )
    return f"""
        <mujoco><visual><map znear="0.01"/></visual><worldbody>
          <light pos="1 -2 4" dir="0 0.3 -1" castshadow="{light}"/>
          <geom type="plane" size="0 0 0.1" pos="0 0 -1.6"/>
          <camera name="eye" pos="0.1 -1.4 0.4" xyaxes="1 0.1 0 0 0.2 1" resolution="170 120"
            {camera}/>{geoms}
        </worldbody></mujoco>"""


def crowd(camera: str, light: str = "false", count: int = 150) -> mujoco.MjModel:
    """Return the scene, compiled."""
    return mujoco.MjModel.from_xml_string(crowd_xml(camera, light, count))


def seen(model: mujoco.MjModel) -> np.ndarray:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return renderer().render(model, data, "eye", 170, 120)


def seen_alike(model: mujoco.MjModel, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, int]:
    """Return the image, the same with and without culling, and how many geoms culling keeps."""
    kept = []

    def watched(scene, *rest):
        cull(scene, *rest)
        nothing = int(mujoco.mjtGeom.mjGEOM_NONE)
        kept.append(sum(geom.type != nothing for geom in scene.geoms[: scene.ngeom]))

    monkeypatch.setattr(twin.camera, "cull", watched)
    image = seen(model)
    monkeypatch.setattr(twin.camera, "cull", lambda *_: None)
    np.testing.assert_array_equal(image, seen(model))
    return image, kept[0]


@pytest.mark.chosen_seed  # Others show other shares of the crowd.
@pytest.mark.parametrize("camera", [INTRINSIC, 'fovy="50"'])
def test_image_without_unseen_geoms_is_the_whole_scenes_bit_for_bit(monkeypatch, camera):
    model = crowd(camera)
    _, kept = seen_alike(model, monkeypatch)
    # A third of the bodies are in view.
    assert 20 < kept < 0.6 * model.ngeom


def test_small_things_at_the_edges_of_a_near_view_stay(monkeypatch):
    # Nearer than ten times the distance of the two eyes that MuJoCo keeps of a camera.
    rng = np.random.default_rng(8)
    dots = "".join(
        f'<geom type="sphere" size="0.004" pos="{x} {y} -0.4" rgba="{c} 1 {c} 1"/>'
        for x, y, c in zip(*rng.uniform(-0.3, 0.3, (2, 400)), rng.uniform(0.2, 1.0, 400))
    )
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><visual><map znear="0.01"/></visual><worldbody>
          <light pos="0 0 2" castshadow="false"/>
          <camera name="eye" resolution="170 120" {INTRINSIC}/>{dots}
        </worldbody></mujoco>""")
    image = seen(model)
    monkeypatch.setattr(twin.camera, "cull", lambda *_: None)
    np.testing.assert_array_equal(image, seen(model))


def test_nothing_is_left_out_where_shadows_may_fall_into_the_view(monkeypatch):
    called = []
    monkeypatch.setattr(twin.camera, "cull", lambda *_: called.append(1))
    seen(crowd(INTRINSIC, light="true", count=5))
    assert not called


SUNS = {"high": (0.3, 0.2, -1.0), "low": (-0.9, 0.35, -0.25), "from_behind": (0.1, 0.8, -0.5)}


@pytest.mark.parametrize("sun", SUNS)
def test_image_with_shadows_of_what_is_out_of_view_is_the_whole_scenes_bit_for_bit(
    monkeypatch, sun
):
    x, y, z = SUNS[sun]
    spec = mujoco.MjSpec.from_string(crowd_xml(INTRINSIC, light="true", count=90))
    spec.lights[0].type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.lights[0].pos, spec.lights[0].dir = [-4.0 * x, -4.0 * y, -4.0 * z], [x, y, z]
    spec.visual.map.shadowclip = 2.0
    model = spec.compile()
    image, kept = seen_alike(model, monkeypatch)
    assert kept < model.ngeom
    # Without what throws shadows from out of the view, there would be fewer of them.
    monkeypatch.setattr(twin.camera, "cull", lambda *rest: cull(*rest[:4], rest[4][:0]))
    assert np.any(image != seen(model))


def test_shadows_of_balls_far_away_stay_to_their_very_end(monkeypatch):
    rng, sun = np.random.default_rng(3), np.array([-0.9, 0.35, -0.25])
    heights = rng.uniform(0.5, 1.5, 30)
    fallen = np.column_stack([rng.uniform(-0.25, 0.25, (30, 2)), np.zeros(30)])
    places = fallen + sun * (heights / sun[2])[:, None]
    balls = "".join(f'<geom size="0.03" pos="{x} {y} {z}"/>' for x, y, z in places)
    x, y, z = -6.0 * sun
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><visual><map znear="0.01" shadowclip="2"/></visual><worldbody>
          <light type="directional" pos="{x} {y} {z}" dir="-0.9 0.35 -0.25"/>
          <geom type="plane" size="0 0 0.1"/>
          <camera name="eye" pos="0 0 0.9" fovy="40" resolution="170 120"/>{balls}
        </worldbody></mujoco>""")
    image = seen(model)
    monkeypatch.setattr(twin.camera, "cull", lambda *_: None)
    np.testing.assert_array_equal(image, seen(model))
    # Nothing but shadows is to be seen.
    assert np.mean(image < 0.93 * np.median(image)) > 0.05


@pytest.mark.parametrize("change", ["low sun", "slope", "lamp"])
def test_shadows_without_an_end_are_not_bounded(change):
    spec = mujoco.MjSpec.from_string(crowd_xml(INTRINSIC, light="true", count=5))
    spec.lights[0].type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert shadow_reach(model, data).shape == (1, model.ngeom, 3)
    if change == "low sun":
        spec.lights[0].dir = [1.0, 0.0, -0.01]
    elif change == "slope":
        spec.geoms[0].quat = [0.999, 0.04, 0.0, 0.0]
    else:
        spec.lights[0].type = mujoco.mjtLightType.mjLIGHT_SPOT
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert shadow_reach(model, data) is None
