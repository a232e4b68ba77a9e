"""Tyres on patches while robots drive: in the simulation, behind boards and in dm_control."""

import dataclasses

import numpy as np
import pytest

from models.compose import RobotPlacement, make_model, make_terrain, settle
from tests.models.scenes import PLAIN
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig
from twin.robot import WHEELS, ArmMode, Command, WheelMode
from twin.simulation import Simulation

FIELD = dataclasses.replace(
    PLAIN, friction_patches=(0.15, 0.9), friction_patch=0.1, relief=0.02, seed=2
)
ROBOT = RobotPlacement(yaw=0.3)


def simulate(model=None):
    model = make_model(FIELD, [ROBOT]) if model is None else model
    return Simulation(model, ["rover1"], data=settle(model, 0.5), seed=1)


def drive(simulation, ticks):
    """Turn and drive with a swinging arm; return the state after each tick."""
    robot, states = simulation.robots["rover1"], []
    robot.activate()
    for _ in range(ticks):
        time = simulation.time
        speeds = np.array([4.0, 2.0, 4.0, 2.0]) * np.cos(0.7 * time)
        arm = np.array([0.0, 0.9, -1.4, 0.1]) + 0.3 * np.sin(4.0 * time)
        robot.command(Command(speeds, arm, WheelMode.SPEED, ArmMode.POSITION))
        simulation.tick()
        states.append(simulation.data.qpos.tobytes() + simulation.data.qacc.tobytes())
    return states


def frictions(model, data, ground):
    """Return what the tyres have and what the ground below them has, (4,) each."""
    geoms = [model.geom(f"rover1/{wheel}_tyre").id for wheel in WHEELS]
    return model.geom_friction[geoms, 0], ground.friction_at(data.geom_xpos[geoms, :2])


def test_tyres_of_a_rover_that_drives_have_the_friction_of_the_patches_below():
    simulation, ground = simulate(), make_terrain(FIELD, [ROBOT])
    met = set()
    for _ in range(150):
        drive(simulation, 1)
        have, wanted = frictions(simulation.model, simulation.data, ground)
        np.testing.assert_array_equal(have, wanted)
        met.update(have)
    assert len(met) > 10


def test_restored_run_goes_on_bit_for_bit_in_any_simulation_of_the_scene():
    simulation = simulate()
    drive(simulation, 40)
    saved = simulation.save()
    first = drive(simulation, 120)
    for other in (simulation, simulate()):
        drive(other, 7)  # Its tyres stand elsewhere.
        other.restore(saved)
        assert drive(other, 120) == first


def test_two_simulations_of_one_model_run_alike_one_after_the_other():
    model = make_model(FIELD, [ROBOT])
    assert drive(simulate(model), 60) == drive(simulate(model), 60)


def test_emulated_boards_and_their_own_begin_have_the_ground_s_friction():
    ground = make_terrain(FIELD, [ROBOT])
    config = SceneConfig.from_json(SceneConfig((ROBOT,), FIELD).to_json())
    scenes = [EmulatedScene(config) for _ in range(2)]
    ends = []
    for scene, ticks in zip(scenes, (60, 5)):
        rover = scene.rovers["rover1"]
        rover.codes[:4] = [20000, 20000, 14000, 14000]
        for _ in range(ticks):
            scene.tick()
    physics = scenes[0].simulation.save().physics
    scenes[1].begin_at(physics)
    for scene in scenes:
        have, wanted = frictions(scene.simulation.model, scene.simulation.data, ground)
        np.testing.assert_array_equal(have, wanted)
        ends.append([contact.friction.tolist() for contact in scene.simulation.data.contact])
        scene.close()
    assert ends[0] == ends[1] and ends[0]


def test_environment_of_dm_control_has_them_and_begins_each_episode_alike():
    pytest.importorskip("dm_control", reason="dm_control has no wheels for Python 3.13")
    from twin.environment import make_environment  # noqa: PLC0415

    environment, ground = make_environment([ROBOT], FIELD), make_terrain(FIELD, [ROBOT])
    action = np.array([0.4, 0.3, 0.4, 0.3, 0.0, 0.0, 0.0, 0.0])
    ends, met = [], set()
    for _ in range(2):
        environment.reset()
        for _ in range(80):
            model, data = environment.physics.model.ptr, environment.physics.data.ptr
            below = frictions(model, data, ground)[1]
            environment.step(action)
            have, _ = frictions(model, data, ground)
            np.testing.assert_array_equal(have, below)  # Of where the tick began.
            met.update(have)
        ends.append(data.qpos.tobytes())
    assert ends[0] == ends[1] and len(met) > 5
