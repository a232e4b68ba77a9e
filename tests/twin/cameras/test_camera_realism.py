"""Stereo heads as made: every effect in rendered pairs against its closed form."""

import dataclasses

import cv2
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from models.datasheets import CAMERA
from perception.geometry.pinhole import Pinhole
from tests.twin.cameras.test_camera import noise, settled
from tests.twin.scene import SERVO, compile_scene
from twin.camera import StereoConfig, StereoHead, StereoRig, camera_model, camera_pose, renderer
from twin.optics.flow import View, block_lens
from twin.optics.realism import DEFAULT_CAMERA, HARSH_CAMERA, IDEAL_CAMERA, CameraRealism
from twin.robot import ArmMode, Command
from twin.sensors import IDEAL
from twin.simulation import Simulation

MODEL = compile_scene()
PAIR = compile_scene(("rover1", "rover2"))
SEED = np.random.SeedSequence(11)
DEPTH = 0.6
EYES = "".join(
    f'<camera name="stereo_{side}" pos="{x} 0 0" xyaxes="1 0 0 0 0 1" focal="0.0085 0.0085" '
    'sensorsize="0.0064 0.0048" resolution="510 492"/>'
    for side, x in (("left", -0.019), ("right", 0.019))
)
BODY = '<geom size="0.01" group="4"/>'
SCENE = f"""
<mujoco><visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/>
<quality numslices="64" numstacks="64"/><map znear="0.002"/></visual><worldbody>
<body name="head"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>{BODY}{EYES}
</body>%s</worldbody></mujoco>
"""
WALL = f"""
<body name="wall" pos="0 {DEPTH} 0"><joint type="slide" axis="1 0 0"/>
<geom type="box" size="2 0.01 2" pos="-2 0.01 0" rgba="0.2 0.2 0.2 1"/>
<geom type="box" size="2 0.01 2" pos="2 0.01 0" rgba="0.8 0.8 0.8 1"/></body>
"""
SPOTS = [
    (0.0, 0.5, 0.0),
    (0.1, 0.45, 0.08),
    (-0.12, 0.6, 0.1),
    (-0.08, 0.5, -0.1),
    (0.1, 0.7, -0.1),
]
BALL = 0.018


def wall(velocity=()):
    """A head before a wall that is dark on the left and bright on the right."""
    model = mujoco.MjModel.from_xml_string(SCENE % WALL)
    data = mujoco.MjData(model)
    data.qvel[: len(velocity)] = velocity
    mujoco.mj_forward(model, data)
    return model, data


def seen(model, data, **realism):
    """Both images without noise."""
    config = StereoConfig(noise_db=None, realism=CameraRealism(**realism))
    return StereoRig(model, "", config, SEED).capture(data, noise()).astype(float)


def edge_variance(scene, **realism):
    """Variance of the edge's spread along the rows of the left image [px^2]."""
    config = StereoConfig(noise_db=46.0, realism=CameraRealism(**realism))
    rig = StereoRig(scene[0], "", config, SEED)
    # Noise and the mean over many rows see below the grey levels' steps.
    pairs = [rig.capture(scene[1], (rng, rng)) for rng in np.random.default_rng(2).spawn(4)]
    profile = np.mean([pair[0, 40:460] for pair in pairs], axis=(0, 1))
    middle = int(np.argmax(np.diff(cv2.GaussianBlur(profile[None], (0, 0), 3.0)[0])))
    columns = np.arange(middle - 10, middle + 11)
    weights = np.diff(profile)[columns]
    weights = weights / weights.sum()
    return weights @ (columns - weights @ columns) ** 2


def blank():
    """A head before an evenly bright wall."""
    model, data = wall()
    model.geom_rgba[:] = 0.7
    data.qpos[2] = 1.5  # The edge out of the view.
    mujoco.mj_forward(model, data)
    return model, data


SPEED, EXPOSURE = 0.3, 1.0 / 60.0


@pytest.mark.parametrize("velocity", [(SPEED,), (0.0, 0.0, SPEED)], ids=["camera", "wall"])
def test_sideways_motion_spreads_an_edge_as_a_box_of_its_way_in_the_image(velocity):
    still, moving = (
        edge_variance(wall(v), exposure=EXPOSURE, latency=EXPOSURE) for v in ((), velocity)
    )
    way = CAMERA.pinhole.fx * SPEED * EXPOSURE / DEPTH
    assert way == pytest.approx(5.64, abs=0.01)
    assert moving - still == pytest.approx(way**2 / 12.0, rel=0.03)


def test_turning_arm_spreads_an_edge_by_its_turn_and_by_its_reach():
    reach, rate = 0.3, 0.4
    hinge = f'<joint axis="0 0 1" pos="0 {-reach} 0"/>'
    xml = (SCENE % WALL).replace('<joint type="slide" axis="0 0 1"/>', hinge)
    # Away from the world's origin.
    xml = xml.replace('name="head"', 'name="head" pos="1 -2 0.5"')
    model = mujoco.MjModel.from_xml_string(xml.replace(f'"0 {DEPTH} 0"', f'"1 {DEPTH - 2.0} 0"'))
    variances = []
    for speed in (0.0, rate):
        data = mujoco.MjData(model)
        data.qvel[1] = speed
        mujoco.mj_forward(model, data)
        variances.append(edge_variance((model, data), exposure=EXPOSURE, latency=EXPOSURE))
    way = CAMERA.pinhole.fx * rate * (1.0 + reach / DEPTH) * EXPOSURE
    assert variances[1] - variances[0] == pytest.approx(way**2 / 12.0, rel=0.03)


def test_head_that_moves_with_what_it_sees_sees_no_blur():
    exposed = {"exposure": EXPOSURE, "latency": EXPOSURE}
    together = seen(*wall((SPEED, 0.0, SPEED)), **exposed)
    np.testing.assert_array_equal(together, seen(*wall(), **exposed))


def test_motion_along_an_edge_leaves_it_sharp():
    still, moving = (
        edge_variance(wall(v), exposure=EXPOSURE, latency=EXPOSURE) for v in ((), (0.0, SPEED))
    )
    assert moving - still == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("focus", [0.2, 1.5])
def test_edge_out_of_focus_is_spread_as_a_disc_of_the_thin_lens(focus):
    sharp, soft = (edge_variance(wall(), f_number=n, focus_distance=focus) for n in (1e6, 4.0))
    focal, pitch = CAMERA.focal_length, CAMERA.sensing_width / CAMERA.width
    disc = focal / 4.0 * focal / (focus - focal) * abs(DEPTH - focus) / DEPTH
    # The drawing's focal length is the distance of the sensor, whatever the lens is in focus at.
    disc *= (focus - focal) / focus
    assert soft - sharp == pytest.approx((disc / pitch) ** 2 / 16.0, rel=0.03)


def test_light_falls_off_with_the_fourth_power_of_the_cosine():
    model, data = blank()
    image, flat = seen(model, data, vignetting=0.0), seen(model, data, gain_error=1e-9)
    rays = CAMERA.pinhole.rays(CAMERA.pinhole.pixel_grid())
    cosine = 1.0 / np.linalg.norm(rays, axis=-1)
    assert flat.std() == 0.0
    # The images are of whole grey levels.
    np.testing.assert_allclose(image, np.broadcast_to(flat * cosine**4, flat.shape), atol=0.51)
    assert image[0, 0, 0] / flat[0, 0, 0] == pytest.approx(0.67, abs=0.01)
    barrel = seen(model, data, vignetting=0.2)
    assert barrel[0, 0, 0] / image[0, 0, 0] == pytest.approx(0.8, abs=0.01)


def test_exposure_error_scales_the_light_of_both_eyes_alike():
    model, data = blank()
    plain, levels = seen(model, data)[0, 0, 0], []
    for seed in range(5):
        config = StereoConfig(noise_db=None, realism=CameraRealism(gain_error=0.1))
        rig = StereoRig(model, "", config, np.random.SeedSequence(seed))
        pair = rig.capture(data, noise())
        assert pair.std() == 0.0
        levels.append(pair[0, 0, 0] / plain)
    assert len(set(levels)) > 1 and 0.6 < min(levels) < max(levels) < 1.6


def ball_centres(camera, rotation, translation):
    """Where the middles of the balls' outlines are, as the cones from the camera have them [px]."""
    away = (np.array(SPOTS) - translation) @ rotation
    distance = np.linalg.norm(away, axis=1)
    centres = []
    for ray, cosine in zip(away / distance[:, None], 1.0 - (BALL / distance) ** 2, strict=True):
        cone = np.outer(ray, ray) - cosine * np.eye(3)
        centres.append([*np.linalg.solve(cone[:2, :2], -cone[:2, 2]), 1.0])
    return camera.pixels(np.array(centres))


@pytest.mark.parametrize("made", [DEFAULT_CAMERA, HARSH_CAMERA], ids=["default", "harsh"])
def test_balls_are_seen_where_cameras_as_made_project_them(made):
    balls = "".join(
        f'<geom size="{BALL}" pos="{x} {y} {z}" rgba="0.7 0.7 0.7 1"/>' for x, y, z in SPOTS
    )
    model = mujoco.MjModel.from_xml_string(SCENE % balls)
    data = settled(model)
    # A lens that loses light towards the edge would shift the middle of the light.
    realism = dataclasses.replace(made, exposure=0.0, vignetting=None, f_number=None)
    rig = StereoRig(model, "", StereoConfig(noise_db=None, realism=realism), SEED)
    drawn = [camera_model(model, f"stereo_{side}") for side in ("left", "right")]
    pair = rig.capture(data, noise()).astype(float)
    for eye, (image, lens, pose) in enumerate(zip(pair, rig.cameras, rig.poses(data), strict=True)):
        expected = ball_centres(lens, pose.rotation.as_matrix(), pose.translation)
        as_drawn = ball_centres(drawn[eye], *camera_pose(data, eye))
        assert np.abs(expected - as_drawn).max() > 0.06
        for pixel in expected:
            left, top = (np.rint(pixel) - 50).astype(int)
            rows, columns = np.mgrid[top : top + 101, left : left + 101]
            light = image[rows, columns]
            centre = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
            np.testing.assert_allclose(centre, pixel, atol=0.05)


def test_depths_and_bodies_of_the_blocks_are_those_that_rays_meet():
    data = settled(PAIR)
    lens = Pinhole(200, 131, 150.0, 160.0, 99.0, 66.0)
    # From above and behind the second rover towards the first.
    turn = Rotation.from_euler("yx", [-90.0, -25.0], degrees=True)
    camera = RigidTransform.from_components(
        [1.6, 0.1, 0.5], Rotation.from_euler("x", -90.0, degrees=True) * turn
    )
    _, surfaces = renderer().render_view(PAIR, data, View(lens, camera))
    small = block_lens(lens)
    assert surfaces.closeness.shape == (small.height, small.width) == (17, 25)
    hits, rays = np.zeros(1, np.int32), small.rays(small.pixel_grid())
    agreeing = []
    for place in np.ndindex(17, 25):
        ray = camera.rotation.apply(rays[place])
        ahead = mujoco.mj_ray(PAIR, data, camera.translation, ray, None, True, -1, hits, None)
        body = PAIR.geom_bodyid[hits[0]] if ahead > 0.0 else 0
        close = 1.0 / ahead if ahead > 0.0 else 0.0
        agreeing.append(
            surfaces.bodies[place] == body and abs(surfaces.closeness[place] - close) < 0.02
        )
    # All but some at outlines, which are drawn as facets.
    assert np.mean(agreeing) > 0.97
    assert len(np.unique(surfaces.bodies)) > 6 and np.any(surfaces.closeness == 0.0)


def test_ideal_set_draws_what_the_renderer_draws_and_adds_noise():
    data, config = settled(), StereoConfig(noise_db=40.0, realism=IDEAL_CAMERA)
    pair = StereoRig(MODEL, "rover1/", config).capture(data, noise())
    rng = noise()[0]
    for image, side in zip(pair, ("left", "right"), strict=True):
        colour = renderer().render(MODEL, data, f"rover1/stereo_{side}", 102, 98)
        grey = cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_RGB2GRAY)
        errors = np.float32(2.55) * rng.standard_normal(grey.shape, dtype=np.float32)
        np.testing.assert_array_equal(image, np.clip(np.rint(grey + errors), 0, 255))
    assert StereoConfig().realism == IDEAL_CAMERA


def test_view_of_a_camera_as_drawn_is_the_camera_s_own():
    data, name = settled(), "rover1/stereo_right"
    pose = StereoRig(MODEL, "rover1/", StereoConfig()).poses(data)[1]
    view = View(camera_model(MODEL, name), pose)
    image, _ = renderer().render_view(MODEL, data, view)
    own = renderer().render(MODEL, data, name, 102, 98)
    # Rounding moves single samples of pixels at outlines.
    assert np.mean(image != own) < 0.002


def simulated(realism, names=("rover1",), model=MODEL, seed=3, rate=20.0):
    config = StereoConfig(rate=rate, realism=realism)
    return Simulation(model, names, suite=IDEAL, servo=SERVO, stereo=config, seed=seed)


def swinging(simulation, ticks):
    """Every robot's pair at each tick, not read, while the arms swing."""
    for robot in simulation.robots.values():
        robot.activate()
    pairs = []
    for tick in range(ticks):
        for name, robot in simulation.robots.items():
            pairs.append((name, simulation.time, robot.observe().stereo))
            rates = np.full(4, 0.5 * (-1) ** (tick // 30))
            robot.command(Command(arm=rates, arm_mode=ArmMode.RATE))
        simulation.tick()
    return pairs


@pytest.mark.parametrize("latency", [0.03, 0.05, 0.12])
def test_pair_arrives_its_latency_after_its_stamp(latency):
    """At 20 Hz: those under way when the simulation begins show the scene at its start."""
    pairs = swinging(simulated(CameraRealism(latency=latency)), 40)
    for _, time, pair in pairs:
        expected = np.floor((time + 1e-9) / 0.05) * 0.05 - latency
        # What is exposed after the start is so at a tick, here up to one late.
        assert expected - 1e-9 <= pair.stamp <= expected + 0.01 + 1e-9
        assert pair.stamp + latency <= time + 1e-9
    assert len({pair.stamp for _, _, pair in pairs}) == 8


def test_late_pair_shows_the_scene_of_its_stamp():
    late = swinging(simulated(CameraRealism(latency=0.05)), 30)
    prompt = swinging(simulated(CameraRealism(latency=1e-6)), 30)
    shown = {round(pair.stamp, 3): pair.value for _, _, pair in prompt}
    compared = 0
    for stamp, value in {round(pair.stamp, 3): pair.value for _, _, pair in late}.items():
        if stamp > 0.0:
            # The numbers of the pairs differ, and with them the noise.
            away = np.abs(value.astype(float) - shown[stamp])
            assert np.percentile(away, 95) < 8
            compared += 1
    assert compared >= 4
    first, last = shown[0.0].astype(float), shown[max(shown)]
    assert np.percentile(np.abs(first - last), 95) > 8


def test_one_seed_gives_one_head_and_two_robots_are_never_alike():
    def made(seed):
        simulation = simulated(DEFAULT_CAMERA, ("rover1", "rover2"), PAIR, seed)
        simulation.settle(0.1)
        heads = simulation.heads.values()
        poses = [pose.as_matrix() for head in heads for pose in head.poses(simulation.data)]
        return [robot.observe().stereo.value for robot in simulation.robots.values()], poses

    (pairs, poses), (again, as_before), (others, elsewhere) = made(3), made(3), made(4)
    np.testing.assert_array_equal(pairs, again)
    np.testing.assert_array_equal(poses, as_before)
    for one, two in zip(pairs, others, strict=True):
        assert np.any(one != two)
    assert not np.allclose(poses, elsewhere, atol=1e-5)
    errors = np.array(poses) - [
        np.vstack([np.column_stack(camera_pose(settled(PAIR), eye)), [0, 0, 0, 1]])
        for eye in range(4)
    ]
    assert np.abs(errors[0] - errors[2]).max() > 1e-4


def test_pairs_of_heads_as_made_are_their_own_in_whatever_order_they_are_read():
    def pixels(backwards):
        pairs = swinging(simulated(DEFAULT_CAMERA, ("rover1", "rover2"), PAIR), 20)[::7]
        order = pairs[::-1] if backwards else pairs
        values = [pair.value for _, _, pair in order]
        return values[::-1] if backwards else values

    for one, other in zip(pixels(False), pixels(True), strict=True):
        np.testing.assert_array_equal(one, other)


def test_restored_run_has_the_pairs_that_were_under_way():
    simulation = simulated(DEFAULT_CAMERA)
    swinging(simulation, 23)
    saved, runs = simulation.save(), []
    for _ in range(2):
        simulation.restore(saved)
        runs.append([pair for _, _, pair in swinging(simulation, 40)])
    assert [pair.stamp for pair in runs[0]] == [pair.stamp for pair in runs[1]]
    for one, other in zip(runs[0][::9], runs[1][::9], strict=True):
        np.testing.assert_array_equal(one.value, other.value)


def test_head_with_errors_needs_a_seed():
    with pytest.raises(ValueError, match="rover1/stereo_left.*give a seed"):
        StereoRig(MODEL, "rover1/", StereoConfig(realism=DEFAULT_CAMERA))


def test_noise_does_not_depend_on_how_the_head_was_made():
    data, errors = settled(), []
    for realism in (IDEAL_CAMERA, CameraRealism(gain_error=1e-9)):
        both = []
        for noise_db in (None, 30.0):
            config = StereoConfig(noise_db=noise_db, realism=realism)
            head = StereoHead(MODEL, "rover1/", config, np.random.SeedSequence(5))
            both.append(head.poll(data, 0.0).value.astype(float))
        inside = (both[0] > 60) & (both[0] < 195)
        errors.append(np.where(inside, both[1] - both[0], 0.0))
    # Of one generator, but for outlines that the two ways to draw round differently.
    assert np.mean(errors[0] != errors[1]) < 0.01 and errors[0].std() > 1.0
