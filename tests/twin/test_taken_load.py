"""A gripper takes its box while the scene runs."""

import mujoco
import numpy as np
import pytest

from models.compose import FLAT, RobotPlacement, make_model
from models.configuration import PayloadConfig
from perception.geometry.gravity import GRAVITY
from twin.hardware.emulator.scene import SceneConfig, simulate
from twin.robot import ArmMode, Command
from twin.sensors import IDEAL
from twin.taken_load import TakenLoad

BOX = PayloadConfig(0.3, (0.01, 0.0, 0.0), taken=1.0)
HELD = RobotPlacement(payload=PayloadConfig(0.3, (0.01, 0.0, 0.0)))
DERIVED = ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0")


def test_box_weighs_nothing_before_and_all_that_follows_is_as_compiled_after():
    model, compiled = make_model(FLAT, [HELD]), make_model(FLAT, [HELD])
    empty = make_model(FLAT, [RobotPlacement()])
    load = TakenLoad(model, RobotPlacement(payload=BOX))
    assert model.body_subtreemass[0] == pytest.approx(empty.body_subtreemass[0], rel=1e-12)
    load.weigh(0.99)
    assert model.body("rover1/payload").mass[0] == 0.0
    load.weigh(1.0)
    for name in DERIVED:
        np.testing.assert_allclose(getattr(model, name), getattr(compiled, name), rtol=1e-9)


def test_wrench_under_the_arm_shows_the_weight_from_its_time_on_and_not_after_a_restore():
    scene = SceneConfig((RobotPlacement(payload=BOX),))
    simulation = simulate(scene, IDEAL)
    robot = simulation.robots["rover1"]
    robot.activate()
    home = robot.observe().arm_angles.value
    robot.command(Command(arm=home, arm_mode=ArmMode.POSITION))
    lifted = []
    simulation.settle(0.9)
    saved = simulation.save()
    for _ in range(2):
        simulation.restore(saved)
        for seconds in (0.0, 1.5):
            simulation.settle(seconds)
            simulation.tick()
            lifted.append(robot.observe().arm_base_wrench.value[2])
    simulation.close()
    assert lifted[1] - lifted[0] == pytest.approx(0.3 * GRAVITY, rel=0.02)
    assert lifted[2:] == lifted[:2]


def test_a_time_before_zero_is_refused():
    with pytest.raises(ValueError, match="payload taken"):
        PayloadConfig(0.1, taken=-1.0)


def test_a_load_that_is_held_from_the_start_changes_nothing():
    model = make_model(FLAT, [HELD])
    masses = model.body_mass.copy()
    TakenLoad(model, HELD)
    np.testing.assert_array_equal(model.body_mass, masses)
    assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "rover1/payload") > 0
