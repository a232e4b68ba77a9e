"""The benchmark of placing again, and a rover whose camera ends up looking at the target."""

import json

import mujoco
import numpy as np
import pytest
import scipy.ndimage

from controllers.kinematics.arm_inverse import standing_views
from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.looking import RobotBrief
from controllers.placement.reach.reach import ReachConfig, RoverState, plan_reach
from controllers.placement.task import PlacementError
from experiments.__main__ import main
from experiments.bench.placement import BASE, DECK, FOLDED, TALL, leveled
from experiments.ch3.stereo.scene import StereoScene, StereoSceneConfig
from experiments.ch4.spatial.placement_scene import head_lens, map_scene, panel_targets
from models.clutter import PanelConfig
from models.compose import FieldConfig, RobotPlacement
from perception.voxels.occupancy import State
from twin.camera import StereoConfig
from twin.connect import connect
from twin.describe import body_pose, camera_in_world, describe
from twin.loop import run
from twin.robot import ArmMode, Command


def test_map_of_the_scene_has_its_surfaces_and_no_rovers():
    scene = StereoScene(StereoSceneConfig(seed=0, texture_pixels=64))
    voxels = map_scene(scene, 2, np.random.default_rng(0), resolution=0.02)
    cells, _ = voxels.occupied_cells()
    centres = voxels.grid.centres(cells)
    assert len(centres) > 500
    for name in scene.robot_names:
        middle = scene.data.body(f"{name}/chassis").xpos
        near = np.linalg.norm(centres - middle, axis=1) < 0.1
        assert np.count_nonzero(near & (centres[:, 2] > 0.04)) < 3
    assert voxels.counts()[State.FREE] > 5 * len(cells)


def test_outline_of_a_driving_rover_holds_its_shapes():
    scene = StereoScene(StereoSceneConfig(seed=0, rocks=0, blocks=0, texture_pixels=64))
    model, data = scene.model, scene.data
    for name, angle in zip(JOINTS, ReachConfig().carry, strict=True):
        data.joint(f"rover1/{name}_joint").qpos = angle
    mujoco.mj_kinematics(model, data)
    chassis = model.body("rover1/chassis").id
    level = leveled(body_pose(data, chassis))
    held = 0
    for geom in np.flatnonzero(model.geom_group == 3):
        if model.body_rootid[model.geom_bodyid[geom]] != chassis:
            continue
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        corners = model.geom_aabb[geom, :3] + signs * model.geom_aabb[geom, 3:]
        world = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        low, high = world[:, 2].min(), world[:, 2].max()
        box = BASE if high < DECK else FOLDED
        assert high < TALL and (high < DECK or low > DECK)
        places = level.inv().apply(world)
        for axis in (0, 1):
            # At rest the rover leans by some milliradians.
            assert box[2 * axis] - 0.002 < places[:, axis].min()
            assert places[:, axis].max() < box[2 * axis + 1] + 0.002
        held += 1
    assert held >= 10


def test_targets_are_the_panel_s_markers():
    scene = StereoScene(StereoSceneConfig(seed=0, texture_pixels=64))
    for target in panel_targets(scene):
        assert np.linalg.norm(target.outline, axis=1).min() > 0.018
        np.testing.assert_allclose(target.outline @ target.normal, 0.0, atol=1e-12)
    assert head_lens().near == pytest.approx(0.127)


@pytest.mark.slow
def test_replans_stay_within_a_vision_period_s_order(tmp_path):
    assert main(["bench", "--only", "placement", "--quick", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "bench" / "metrics.json").read_text())
    measured = found["measured"]
    # How fast is for the report to say; that search and re-plan are exact is a fact.
    exact = {
        check["name"]: check["ok"] for check in found["checks"] if "exhaustive" in check["name"]
    }
    assert len(exact) == 2 and all(exact.values())
    assert measured["search_speedup/map"] > 0.0
    assert measured["replan_ratio"] > 0.0


class Follower:
    """Takes an arm along a path."""

    def __init__(self, path, rate=0.4):
        steps = np.abs(np.diff(path, axis=0)).max(axis=1)
        self.times = np.concatenate([[0.0], np.cumsum(steps) / rate])
        self.path, self.seen, self.begun = path, None, None

    def reset(self):
        """Nothing is remembered."""

    def step(self, observations):
        """Follow the path, then stay at its end."""
        self.seen = observations["rover1"]
        self.begun = self.seen.time if self.begun is None else self.begun
        now = self.seen.time - self.begun
        angles = np.array([np.interp(now, self.times, column) for column in self.path.T])
        return {"rover1": Command(arm=angles, arm_mode=ArmMode.POSITION)}


@pytest.mark.slow
def test_simulated_rover_s_camera_ends_up_looking_at_the_target():
    field = FieldConfig(texture_pixels=512, panel=PanelConfig((0.0, 0.7)))
    with connect(
        "sim", robots=[RobotPlacement("rover1")], field=field,
        stereo=StereoConfig(rate=1.0, noise_db=None), seed=0,
    ) as connection:  # fmt: skip
        simulation = connection.simulation
        model, data = simulation.model, simulation.data
        panel = body_pose(data, model.body("panel").id)
        marker = field.panel.markers[1]
        target = panel.apply(field.panel.marker_points[1])
        normal = panel.rotation.apply([0.0, 0.0, 1.0])
        drawn = describe(model, "rover1")
        arm = SerialChain.of_robot(drawn)
        chassis = body_pose(data, model.body("rover1/chassis").id)
        home = np.array([data.joint(f"rover1/{n}_joint").qpos[0] for n in JOINTS])
        state = RoverState(chassis, home)
        pitches = np.linspace(-1.2, 0.2, 30)
        views = standing_views(arm, chassis.inv().apply(target), [0.3], pitches)
        ahead = (chassis.apply(views.positions) - target) @ normal / 0.3
        brief = RobotBrief(arm, home, drawn.body_spheres)

        def in_panel(points):
            return panel.inv().apply(points)[:, 2] < 0.05

        plan = None
        for index in np.argsort(-ahead):
            eye = chassis.apply(views.positions[index])
            try:
                plan = plan_reach(brief, state, None, in_panel, eye, target)
                break
            except PlacementError:
                continue
        assert plan is not None and ahead[index] > 0.9
        follower = Follower(plan.path)
        run(connection.robots, [follower], connection.clock, duration=follower.times[-1] + 4.0)
        image = np.asarray(follower.seen.stereo.value)[0].astype(float)
        truth = camera_in_world(model, data, "rover1/stereo_left")
    # The marker's black centre: the dark patch in the middle of the image.
    middle = (np.array(image.shape) - 1) / 2
    labels, _ = scipy.ndimage.label(scipy.ndimage.median_filter(image, 5) < 40.0)
    row, column = np.round(middle).astype(int)
    assert labels[row, column] > 0
    disc = labels == labels[row, column]
    size = marker.radius * marker.dark / 0.3 * np.array([871.25, 677.34])
    assert np.count_nonzero(disc) == pytest.approx(np.pi * size.prod() * ahead[index], rel=0.1)
    off = np.array(scipy.ndimage.center_of_mass(disc)) - middle
    assert np.abs(off).max() < 4.0
    # By the true pose the axis passes the target as near as the servos hold the joints.
    local = truth.inv().apply(target)
    assert np.hypot(*local[:2]) < 0.002 and local[2] == pytest.approx(0.3, abs=0.002)


JOINTS = ("base_yaw", "shoulder", "elbow", "wrist")
