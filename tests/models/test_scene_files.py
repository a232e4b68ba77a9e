"""Each model's ``scene.xml``: opens by its path, can be shaken, is what Python builds."""

import io

import mujoco
import numpy as np
import pytest
from PIL import Image

from models.compose import FOLDER, RobotPlacement, build_scene
from models.write_scenes import GROUND, PICTURE, WRITTEN, write
from tests.models.scenes import warnings

MODELS = ("rover", "arm", "stereo_head", "compliant_base", "field", "braid", "card_and_slot")
SCENES = sorted(str(path.relative_to(FOLDER)) for path in FOLDER.glob("*/scene*.xml"))
COMPARED = ("body", "jnt", "dof", "geom", "cam", "light", "mat", "actuator", "sensor", "tendon")
COMPARED += ("eq", "exclude", "wrap", "key", "hfield", "qpos")
"""What arrays of a compiled model begin with that are compared; corners of meshes come in another
order."""


def test_every_model_has_a_scene():
    assert [name for name in MODELS if f"{name}/scene.xml" not in SCENES] == []


@pytest.mark.parametrize("scene", SCENES)
def test_scene_shaken_for_a_second_gives_no_warning(scene):
    """By noise on its motors and joints."""
    model = mujoco.MjModel.from_xml_path(str(FOLDER / scene))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    rng = np.random.default_rng(0)
    low, high = np.where(model.actuator_ctrllimited[:, None], model.actuator_ctrlrange, [-50, 50]).T
    begin = data.qpos.copy()
    for _ in range(round(0.1 / model.opt.timestep)):
        data.ctrl = rng.uniform(low, high)
        data.qfrc_applied = rng.normal(0.0, 1.0, model.nv)
        mujoco.mj_step(model, data, nstep=10)
    assert not warnings(data)
    assert np.isfinite(data.qpos).all()
    # Nothing moves in the scene of the stereo head.
    assert model.nq == 0 or np.abs(data.qpos - begin).max() > 1e-3


@pytest.mark.parametrize("scene", SCENES)
def test_scene_has_a_floor_below_the_model_and_a_light(scene):
    model = mujoco.MjModel.from_xml_path(str(FOLDER / scene))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    kinds = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    level = np.isin(model.geom_type, kinds) & (data.geom_xmat[:, 8] > 0.99)
    (floor,) = data.geom_xpos[level]
    assert floor[2] < data.xipos[1:, 2].min()
    assert model.nlight >= 1


def differing(one: mujoco.MjModel, other: mujoco.MjModel) -> list[str]:
    """Return the arrays that differ by more than MJCF's six digits."""
    found = [] if one.names == other.names else ["names"]
    for name in dir(one):
        left, right = getattr(one, name), getattr(other, name)
        if not isinstance(left, np.ndarray) or name.split("_")[0] not in COMPARED:
            continue
        alike = left.shape == right.shape
        if alike and left.dtype.kind in "fiub" and left.size:
            tolerance = 1e-5 * np.abs(left.astype(float)).max()
            alike = np.allclose(left.astype(float), right.astype(float), 1e-5, tolerance)
        found += [] if alike else [name]
    options = [name for name in dir(one.opt) if not name.startswith("_")]
    return found + [
        name for name in options if np.any(getattr(one.opt, name) != getattr(other.opt, name))
    ]


@pytest.mark.parametrize("name", WRITTEN)
def test_written_file_is_what_python_builds(name):
    build, _ = WRITTEN[name]
    written = mujoco.MjModel.from_xml_path(str(FOLDER / name))
    assert differing(build().compile(), written) == []


def test_a_mass_that_drifts_is_seen():
    build, _ = WRITTEN["card_and_slot/card_and_slot.xml"]
    drifted = build()
    drifted.geom("card_plate").mass *= 1.001
    assert "body_mass" in differing(build().compile(), drifted.compile())


def test_picture_of_the_ground_is_the_texture_that_python_draws():
    texture = build_scene(GROUND, [RobotPlacement()]).texture("ground")
    drawn = np.frombuffer(bytes(texture.data), np.uint8).reshape(texture.height, texture.width, 3)
    picture = np.asarray(Image.open(io.BytesIO((FOLDER / "field" / PICTURE).read_bytes())))
    # Another processor may round a grey level the other way.
    assert np.abs(picture.astype(int) - drawn).max() <= 1


def test_files_are_written_where_they_are_asked_for(tmp_path):
    for name in WRITTEN:
        (tmp_path / name).parent.mkdir(exist_ok=True)
    write(tmp_path)
    for name, (build, _) in WRITTEN.items():
        assert (
            differing(build().compile(), mujoco.MjModel.from_xml_path(str(tmp_path / name))) == []
        )
