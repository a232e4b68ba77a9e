"""Motion and confusion of an image against finite differences and the path of the rays."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from models.datasheets import CAMERA
from twin.optics.flow import Surfaces, View, block_lens, confusion, image_flow

LENS = CAMERA.pinhole


def moved(pose, twist, time):
    """A pose after a body that carries it turned and moved about the world's origin."""
    return RigidTransform.from_exp_coords(np.asarray(twist) * time) * pose


def test_flow_is_how_points_move_in_the_image():
    rng = np.random.default_rng(7)
    pose = RigidTransform.from_components([0.3, -1.0, 0.5], Rotation.random(random_state=3))
    twists = rng.normal(0.0, 0.5, (4, 6))
    twists[0] = 0.0
    small = block_lens(LENS)
    shape = small.height, small.width
    closeness, bodies = rng.uniform(0.3, 3.0, shape), rng.integers(0, 3, shape)
    surfaces = Surfaces(closeness, bodies)
    flow = image_flow(View(LENS, pose), surfaces, 3, twists)
    rays = LENS.rays((small.pixel_grid() + 0.5) * 8 - 0.5)
    points = pose.apply((rays / closeness[..., None]).reshape(-1, 3))
    step = 1e-5
    seen = []
    for time in (-step, step):
        camera = moved(pose, twists[3], time)
        after = np.empty_like(points)
        for body in range(3):
            chosen = bodies.ravel() == body
            motion = moved(RigidTransform.identity(), twists[body], time)
            after[chosen] = motion.apply(points[chosen])
        seen.append(LENS.pixels(camera.inv().apply(after)))
    expected = (seen[1] - seen[0]) / (2.0 * step)
    np.testing.assert_allclose(flow.reshape(-1, 2), expected, rtol=1e-4, atol=1e-4)


def test_sky_moves_by_the_camera_s_turn_alone():
    pose = RigidTransform.identity()
    surfaces = Surfaces(np.zeros((62, 64)), np.zeros((62, 64), int))
    twists = np.array([[0.0] * 6, [0.0, 0.2, 0.0, 3.0, -2.0, 1.0]])
    flow = image_flow(View(LENS, pose), surfaces, 1, twists)
    # A camera that turns to the right about its y axis sees the sky go left.
    assert flow[31, 32, 0] == pytest.approx(-0.2 * LENS.fx, rel=1e-2)
    assert np.abs(flow[31, 32, 1]) < 0.2


@pytest.mark.parametrize("f_number", [2.0, 8.0])
def test_circle_of_confusion_is_where_the_rays_of_a_thin_lens_meet_the_sensor(f_number):
    focus, depths = 0.73, np.array([[0.2, 0.5, 0.73, 1.5, 40.0]])
    focal, aperture = CAMERA.focal_length, CAMERA.focal_length / f_number
    sensor, image = (1.0 / (1.0 / focal - 1.0 / z) for z in (focus, depths))
    # Rays from the rim of the lens cross behind or before the sensor.
    diameter = aperture * np.abs(image - sensor) / image
    pixel = sensor / LENS.fx
    found = confusion(LENS, Surfaces(1.0 / depths, np.zeros((1, 5), int)), f_number, focus)
    np.testing.assert_allclose(found, diameter / pixel, rtol=1e-9, atol=1e-12)
