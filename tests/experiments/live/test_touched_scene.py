"""What a person does to a scene, against MuJoCo's own state of it."""

import math

import cv2
import numpy as np
import pytest

from experiments.harness.contract import OptionError
from experiments.live.subjects import model_of
from experiments.live.touched_scene import TouchedScene
from models.compose import FLAT, RobotPlacement, make_model

PENDULUM = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <body name="ball" pos="0 0 0.5">
      <freejoint/>
      <geom size="0.2" mass="1"/>
    </body>
    <geom type="plane" size="2 2 0.1"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def rovers():
    pair = [RobotPlacement("one"), RobotPlacement("two", (1.5, 0.0), math.pi / 2)]
    scene = TouchedScene(make_model(FLAT, pair), (160, 100))
    yield scene
    scene.close()


def run(scene, seconds, drive=None):
    """Run a scene, with a key held."""
    for _ in range(round(seconds / 0.05)):
        if drive is not None:
            scene.take({"drive": drive}, scene.time)
        scene.advance(0.05, scene.time)


def moved(scene, seconds, drive=None):
    """Return how far (2,) the driven rover comes meanwhile."""
    before = np.array(scene.about["place"])
    run(scene, seconds, drive)
    return np.array(scene.about["place"]) - before


def test_a_held_key_drives_and_one_that_is_not_told_again_stops(rovers):
    assert np.linalg.norm(moved(rovers, 0.5)) < 2e-3
    ahead = moved(rovers, 2.0, (1.0, 0.0))
    assert ahead[1] > 0.1 and abs(ahead[0]) < 0.2 * ahead[1]  # It faces along y.
    run(rovers, 0.6)  # Told last at its beginning.
    assert np.linalg.norm(moved(rovers, 1.0)) < 2e-3
    assert moved(rovers, 2.0, (-1.0, 0.0))[1] < -0.1


def test_the_next_rover_is_driven_and_the_first_one_rests(rovers):
    rovers.take({"press": "next"}, 0.0)
    assert rovers.about["driven"] == "two"
    assert rovers._camera.trackbodyid == rovers._model.body("two/chassis").id
    along = moved(rovers, 2.0, (1.0, 0.0))
    assert along[0] < -0.1  # Facing left of y is against x.
    rovers.take({"press": "next"}, 0.0)
    assert rovers.about["place"] == pytest.approx([0.0, 0.0], abs=5e-3)


def test_it_stands_still_while_paused_and_begins_anew(rovers):
    run(rovers, 0.5, (1.0, 0.0))
    rovers.take({"press": "pause"}, 0.0)
    time = rovers.time
    run(rovers, 0.5, (1.0, 0.0))
    assert rovers.time == time and rovers.paused
    rovers.take({"press": "reset"}, 0.0)
    assert rovers.time == 0.0 and rovers.about["place"] == pytest.approx([0.0, 0.0], abs=2e-3)


def test_a_body_is_pushed_where_the_pointer_is_and_let_go(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(PENDULUM)
    model = model_of(str(path), 0)
    model.opt.gravity[:] = 0.0
    scene = TouchedScene(model, (160, 100))
    data = scene._data
    scene.take({"shift": (0.0, 0.0)}, 0.0)
    scene.image()
    scene.take({"grab": (0.02, 0.02)}, 0.0)  # Past the ball.
    scene.take({"pull": (0.2, 0.0)}, 0.0)
    scene.advance(0.05, 0.0)
    assert not data.qvel.any()
    scene.take({"grab": (0.5, 0.5)}, 0.0)
    scene.take({"pull": (0.2, 0.0)}, 0.0)
    scene.advance(0.1, 0.0)
    right = np.cross(
        *(getattr(scene._renderer.scene.camera[0], name) for name in ("forward", "up"))
    )
    velocity = data.qvel[:3].copy()
    assert velocity @ right > 0.9 * np.linalg.norm(velocity) > 0.0
    scene.take({"release": True}, 0.0)
    scene.advance(0.1, 0.0)
    np.testing.assert_allclose(data.qvel[:3], velocity, rtol=1e-6)
    scene.close()


def test_the_image_turns_and_comes_nearer_with_the_camera(rovers):
    def image():
        return cv2.imdecode(np.frombuffer(rovers.image(), np.uint8), cv2.IMREAD_COLOR)

    first = image()
    assert first.shape == (100, 160, 3) and first.std() > 5.0
    distance, azimuth = rovers._camera.distance, rovers._camera.azimuth
    rovers.take({"zoom": 0.5}, 0.0)
    rovers.take({"orbit": (0.5, 0.0)}, 0.0)
    assert rovers._camera.distance == pytest.approx(distance * math.exp(0.5))
    assert rovers._camera.azimuth == pytest.approx(azimuth - 90.0)
    assert np.abs(image().astype(int) - first).mean() > 3.0


@pytest.mark.parametrize("subject", ["rover", "braid"])
def test_our_scenes_are_there_by_name(subject):
    assert model_of(subject, 1).nv > 6


def test_what_is_no_scene_is_told_in_one_line(tmp_path):
    with pytest.raises(OptionError, match="scenes: rover, mission, braid"):
        model_of("rovr", 1)
    bad = tmp_path / "bad.xml"
    bad.write_text("<mujoco><worldbody>")
    with pytest.raises(OptionError, match=r"does not read .*bad\.xml \(.*\)$"):
        model_of(str(bad), 1)
