"""Where the card is and what touches it, against MuJoCo."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controllers.insertion.card_arm import inverse, pitch_of, planar, to_plane
from controllers.mapping.localization import tilt_to_level
from experiments.ch5.insertion_scene import SLAVE
from tests.controllers.insertion.scenes import arm_at, card_arm, drawn_angles, fresh, in_robot
from twin.robot import ArmMode, Command, WheelMode
from twin.simulation import Simulation


def test_card_is_where_mujoco_has_it():
    model, data = fresh()
    arm, rng = card_arm(), np.random.default_rng(0)
    for _ in range(8):
        angles = drawn_angles(arm, rng)
        arm_at(model, data, SLAVE, angles)
        true = in_robot(data, SLAVE, f"{SLAVE}/card").as_matrix()
        np.testing.assert_allclose(arm.card_frame(angles), true, atol=1e-9)
        forward = true[:3, 1]
        assert pitch_of(true) == pytest.approx(np.arcsin(forward[2]))


def test_angles_bring_the_card_where_asked_or_are_none():
    arm, rng = card_arm(), np.random.default_rng(1)
    for _ in range(20):
        angles = drawn_angles(arm, rng)
        card = arm.card_frame(angles)
        pitch = float(angles[1:].sum())  # as the arm counts it, beyond a quarter turn too
        np.testing.assert_allclose(arm.angles_at(card[:3, 3], pitch, angles), angles, atol=1e-6)
    assert np.isnan(arm.angles_at([0.0, 2.0, 0.0], 0.0, np.zeros(4))).all()


def test_pose_in_the_plane_and_back():
    rng = np.random.default_rng(2)
    for pose in rng.uniform([-0.1, -0.1, -3.0], [0.1, 0.1, 3.0], (20, 3)):
        np.testing.assert_allclose(to_plane(planar(pose)), [*pose, 0.0, 0.0], atol=1e-12)
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("ZX", [0.2, 0.1]).as_matrix()
    out[:3, 3] = [0.01, 0.02, 0.03]
    np.testing.assert_allclose(to_plane(out), [0.01, 0.02, 0.2, 0.03, 0.1], atol=1e-12)
    np.testing.assert_allclose(inverse(out), np.linalg.inv(out), atol=1e-12)


@pytest.fixture(scope="module")
def pushed():
    """Wrenches that a sensor measured at rest, by the push on the card's edge in its own axes."""
    model, data = fresh()
    simulation = Simulation(model, [SLAVE], seed=3, data=data)
    robot = simulation.robots[SLAVE]
    robot.activate()
    held = np.array(robot.observe().arm_angles.value)
    card = model.body(f"{SLAVE}/card").id
    pushes = np.zeros((4, 6))
    pushes[1, :3], pushes[2, :3], pushes[3] = [2.0, 0, 0], [0, -3.0, 0], [1, -2, 0.5, 0, 0, 0.2]
    measured = []
    for push in pushes:
        samples = []
        for tick in range(160):
            # At the card's leading edge; MuJoCo wants it at the centre of mass, world axes.
            turn, lever = data.xmat[card].reshape(3, 3), data.xpos[card] - data.xipos[card]
            force, moment = turn @ push[:3], turn @ push[3:]
            data.xfrc_applied[card] = [*force, *(moment + np.cross(lever, force))]
            robot.command(Command(np.zeros(4), held, WheelMode.DUTY, ArmMode.POSITION))
            simulation.tick()
            if tick >= 80:
                samples.append(robot.observe())
        measured.append((push, samples))
    simulation.close()
    return measured


def test_push_on_the_card_is_found_from_the_wrench_under_the_arm(pushed):
    arm = card_arm()
    for push, samples in pushed:
        found = np.mean([felt(arm, seen) for seen in samples], axis=0)
        # Eighty samples of 0.1 N and 0.01 N m; half a metre of lever; a tilt of 0.5 mrad noise.
        np.testing.assert_allclose(found[:3], push[:3], atol=0.06)
        np.testing.assert_allclose(found[3:], push[3:], atol=0.04)


def felt(arm, seen):
    up = tilt_to_level(np.asarray(seen.inclinometer.value)).rotation.inv().apply([0.0, 0.0, 1.0])
    return arm.contact(seen.arm_base_wrench.value, seen.arm_angles.value, up)


def test_contact_of_a_free_card_is_nothing_at_any_pose():
    """Against MuJoCo's own statics: the wrench that carries the arm, by its bodies' weights."""
    model, data = fresh()
    arm, rng = card_arm(), np.random.default_rng(4)
    root = model.body(f"{SLAVE}/arm_base_link").id
    moved = model.body(f"{SLAVE}/turret").id
    last = max(i for i in range(model.nbody) if descends(model, i, moved))
    bodies = [root, *(i for i in range(moved, last + 1) if descends(model, i, moved))]
    for _ in range(5):
        angles = drawn_angles(arm, rng)
        arm_at(model, data, SLAVE, angles)
        mujoco.mj_comPos(model, data)
        weights = np.outer(model.body_mass[bodies], -model.opt.gravity)
        levers = data.xipos[bodies] - data.xpos[root]
        turn = data.xmat[root].reshape(3, 3).T
        wrench = [turn @ weights.sum(axis=0), turn @ np.cross(levers, weights).sum(axis=0)]
        chassis = data.body(f"{SLAVE}/chassis").xmat.reshape(3, 3)
        found = arm.contact(np.concatenate(wrench), angles, chassis[2])
        np.testing.assert_allclose(found, 0.0, atol=1e-6)


def descends(model, body: int, root: int) -> bool:
    while body not in (0, root):
        body = model.body_parentid[body]
    return body == root
