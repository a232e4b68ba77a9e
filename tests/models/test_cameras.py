"""Where a known point appears in each camera's picture."""

import mujoco
import numpy as np
import pytest

from models.compose import RobotPlacement, build_scene, compile_scene
from models.datasheets import CAMERA
from tests.models.scenes import PLAIN

SUBPIXELS = 4
POINTS = [
    (0.0, 0.0, 0.6),
    (-0.12, 0.1, 0.6),
    (0.16, -0.11, 0.6),
    (0.1, 0.15, 1.1),
    (-0.3, -0.2, 1.1),
]
"""Markers right, up and ahead of the middle of the stereo head [m]."""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    """A rover whose stereo head has small white spheres before it, alone in the dark."""
    scene = build_scene(PLAIN, [RobotPlacement()])
    head = scene.body("rover1/stereo_head")
    for index, (right, up, ahead) in enumerate(POINTS):
        body = head.add_body(name=f"marker{index}", pos=[right, ahead, up])
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[0.003, 0.0, 0.0],
            group=5,
            contype=0,
            conaffinity=0,
            mass=1e-6,
        )
    model = compile_scene(scene)
    model.vis.global_.offwidth, model.vis.global_.offheight = CAMERA.width, CAMERA.height
    return model


@pytest.fixture(scope="module")
def labels(model):
    """A renderer of geom ids, and the scene at its key frame."""
    with mujoco.Renderer(model, CAMERA.height, CAMERA.width) as renderer:
        renderer.enable_segmentation_rendering()
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        yield renderer, data


def pinhole(model: mujoco.MjModel, data: mujoco.MjData, camera: str, point: np.ndarray):
    """Return column and row [px] of a world point [m]; the camera looks along -z, y up."""
    view = data.camera(camera)
    local = view.xmat.reshape(3, 3).T @ (point - view.xpos)
    depth = -local[2]
    column = CAMERA.pinhole.cx + CAMERA.pinhole.fx * local[0] / depth
    row = CAMERA.pinhole.cy - CAMERA.pinhole.fy * local[1] / depth
    return np.array([column, row])


def centroid(model, labels, camera: str, geom: int) -> np.ndarray:
    """Return the centre of a geom's picture [px], its edges sampled at sixteen points a pixel.

    Moving MuJoCo's principal point by a fraction of a pixel moves the picture the other way under
    the renderer's grid.
    """
    renderer, data = labels
    options = mujoco.MjvOption()
    options.geomgroup[:] = 0
    options.geomgroup[5] = 1
    identity = model.camera(camera).id
    original = model.cam_intrinsic[identity].copy()
    pixel = np.array([CAMERA.sensing_width / CAMERA.width, CAMERA.sensing_height / CAMERA.height])
    steps = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    sums, count = np.zeros(2), 0
    try:
        for shift in np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2):
            model.cam_intrinsic[identity, 2:] = original[2:] + shift * pixel
            renderer.update_scene(data, camera, options)
            rows, columns = np.nonzero(renderer.render()[..., 0] == geom)
            sums += [np.sum(columns + shift[0]), np.sum(rows + shift[1])]
            count += len(rows)
    finally:
        model.cam_intrinsic[identity] = original
    assert count > 0, f"{camera} does not see geom {geom}"
    return sums / count


@pytest.mark.parametrize("camera", ["rover1/stereo_left", "rover1/stereo_right"])
def test_known_points_appear_within_a_twentieth_of_a_pixel(model, labels, camera):
    data = labels[1]
    errors = []
    for index in range(len(POINTS)):
        body = data.body(f"marker{index}")
        geom = model.body(f"marker{index}").geomadr[0]
        expected = pinhole(model, data, camera, body.xpos)
        found = centroid(model, labels, camera, geom)
        errors.append(found - expected)
    assert np.max(np.abs(errors)) < 0.05
