"""How a base tilts under its arm, against MuJoCo."""

import mujoco
import numpy as np
import pytest

from controllers.identification.pitch import NAMES, PitchData, PitchFit, PitchSensors
from controllers.motion.base_tilt import (
    BaseTilt,
    TiltAxis,
    drawn_springs,
    moment_variances,
    roll_axis,
)
from experiments.ch5.insertion_scene import SLAVE, transform
from models.compose import ARM_JOINTS
from models.datasheets import TOLERANCES
from perception.geometry.gravity import GRAVITY
from tests.controllers.insertion.scenes import card_arm, fresh
from twin.describe import describe_rover
from twin.robot import ArmMode, Command
from twin.simulation import Simulation

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def hanging():
    """Postures (4,) of an arm at rest on flat ground, each with the true pose of the chassis."""
    model, data = fresh()
    simulation = Simulation(model, [SLAVE], seed=3, data=data)
    robot = simulation.robots[SLAVE]
    robot.activate()
    home = np.array(robot.observe().arm_angles.value)
    reaching = card_arm().angles_at([0.0, 0.58, 0.09], 0.0, home)
    poses = [home, reaching, np.array([0.8, *home[1:]]), np.array([-0.5, *reaching[1:]])]
    seen, last = [], home
    for pose in poses:
        for tick in range(300):
            part = min(1.0, tick / 150)
            goal = last + part * (pose - last)
            robot.command(Command(np.zeros(4), goal, arm_mode=ArmMode.POSITION))
            simulation.tick()
        last = pose
        seen.append(
            (np.array(robot.observe().arm_angles.value), transform(data, f"{SLAVE}/chassis"))
        )
    simulation.close()
    return seen


def known() -> BaseTilt:
    return BaseTilt(*drawn_springs(describe_rover()), card_arm().mount)


def tilts(hanging):
    """Yield how the base truly moved from the first posture's, and the predicted tilt."""
    arm = card_arm()
    first, level = hanging[0]
    for angles, pose in hanging[1:]:
        yield level.inv() * pose, known().tilt(arm.weight(angles, UP) - arm.weight(first, UP))


def test_a_base_tilts_by_its_spring_stiffness(hanging):
    pitches, rolls = [], []
    for moved, predicted in tilts(hanging):
        true = moved.rotation.as_euler("XYZ")
        assert predicted[0] == pytest.approx(true[0], rel=0.05, abs=np.radians(0.001))
        # The centre joint lets the halves roll against each other: softer than eq. A-1 says, but
        # no softer than one half's own springs.
        assert 0.5 * abs(true[1]) - 1e-5 <= abs(predicted[1]) <= abs(true[1]) + 1e-5
        pitches.append(true[0])
        rolls.append(true[1])
    assert np.abs(pitches).max() > np.radians(0.05)
    assert np.abs(rolls).max() > np.radians(0.2)


def test_a_fixed_point_moves_in_the_robot_frame_by_the_inverse_of_the_tilt(hanging):
    ahead = np.array([0.0, 0.6, 0.1])
    moved, predicted = next(tilts(hanging))  # in pitch alone
    true = moved.inv().apply(ahead) - ahead
    assert np.linalg.norm(true) > 4e-4
    np.testing.assert_allclose(
        known().motion(predicted).inv().apply(ahead) - ahead, true, atol=3e-5
    )


def test_the_tilt_axis_is_a_fixed_line():
    pitch = TiltAxis(0.1, 2.0, 300.0, (0.14, 0.18))
    roll = TiltAxis(0.1, 2.0, 250.0, (0.03, 0.17))
    base = BaseTilt(pitch, roll, [0.01, 0.2, 0.1])
    line = np.array([[-0.3, 0.06, -0.08], [0.5, 0.06, -0.08]])
    np.testing.assert_allclose(base.motion([0.02, 0.0]).apply(line), line, atol=1e-15)
    line = np.array([[0.04, -0.5, -0.07], [0.04, 0.8, -0.07]])
    np.testing.assert_allclose(base.motion([0.0, 0.02]).apply(line), line, atol=1e-15)


def test_a_force_at_the_tilt_axis_tilts_nothing_and_one_above_it_by_its_lever():
    pitch = TiltAxis(0.1, 2.0, 300.0, (0.0, 0.2))
    base = BaseTilt(pitch, pitch, np.zeros(3))
    # The arm is pushed forward by the rover, so the rover is pushed back, and nods up.
    np.testing.assert_allclose(base.tilt([0.0, 3.0, 0.0, 0.0, 0.0, 0.0]), [0.2 * 3.0 / 300.0, 0.0])
    base = BaseTilt(TiltAxis(0.1, 2.0, 300.0, (0.0, 0.0)), pitch, np.zeros(3))
    np.testing.assert_allclose(base.tilt([0.0, 3.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(2))


def redrawn(axis: TiltAxis, rng: np.random.Generator) -> TiltAxis:
    """Return an axis as it may truly be."""
    root = np.linalg.cholesky(axis.covariance + 1e-18 * np.eye(3))
    y, z, stiffness = np.array([*axis.lever, axis.stiffness]) + root @ rng.normal(size=3)
    return TiltAxis(axis.inertia, axis.damping, float(stiffness), (float(y), float(z)))


def test_predicted_tilt_errs_by_the_covariance_of_levers_and_stiffness():
    rng = np.random.default_rng(0)
    mixed = np.array([[4e-4, 1e-4, 0.05], [1e-4, 2e-4, -0.03], [0.05, -0.03, 90.0]])
    pitch = TiltAxis(0.1, 2.0, 300.0, (0.14, 0.18), mixed)
    roll = TiltAxis(0.1, 2.0, 250.0, (0.03, 0.17), 0.7 * mixed)
    change = np.array([2.0, -3.0, 5.0, 0.6, -0.9, 0.2])
    drawn = [
        BaseTilt(redrawn(pitch, rng), redrawn(roll, rng), np.zeros(3)).tilt(change)
        for _ in range(8000)
    ]
    stiffness = np.array([pitch.stiffness, roll.stiffness])
    expected = np.sqrt(moment_variances(pitch, roll, change)) / stiffness
    np.testing.assert_allclose(np.std(drawn, axis=0), expected, rtol=0.04)


def test_drawn_springs_are_as_uncertain_as_four_springs_of_the_tolerance():
    rover, rng = describe_rover(), np.random.default_rng(1)
    pitch, roll = drawn_springs(rover)
    wheels = np.array([(wheel.spring, wheel.centre[1]) for wheel in rover.wheels])
    share = TOLERANCES.spring
    made = rng.uniform(1.0 - share, 1.0 + share, (20_000, 4)) * wheels[:, 0] @ wheels[:, 1] ** 2
    assert np.sqrt(pitch.covariance[2, 2]) == pytest.approx(np.std(made), rel=0.02)
    # Uniform within 30 % is 17 % of each, so half of that of four alike.
    relative = np.sqrt(pitch.covariance[2, 2]) / pitch.stiffness
    assert relative == pytest.approx(share / np.sqrt(3.0) / 2.0, rel=0.02)
    # Roll is by eq. A-1 beside: too stiff by none to a third.
    more = np.hypot(relative, 1.0 / 3.0 / np.sqrt(3.0))
    assert np.sqrt(roll.covariance[2, 2]) / roll.stiffness == pytest.approx(more)


def test_identified_springs_keep_the_covariance_of_the_fit():
    rng = np.random.default_rng(3)
    wrench = np.cumsum(rng.normal(size=(400, 6)), axis=0) * 0.05
    indices = np.arange(4, 400, 4)
    estimate = PitchFit(PitchSensors()).fit(
        PitchData.of(wrench, indices, 1e-3 * rng.normal(size=len(indices)))
    )
    pitch = TiltAxis.of(estimate)
    kept = [NAMES.index(name) for name in ("ry", "rz", "k_pitch")]
    np.testing.assert_array_equal([*pitch.lever, pitch.stiffness], estimate.parameters[kept])
    np.testing.assert_array_equal(pitch.covariance, estimate.covariance[np.ix_(kept, kept)])
    roll = roll_axis(pitch, describe_rover())
    assert roll.covariance[1, 1] == pitch.covariance[1, 1]
    assert roll.covariance[1, 2] / roll.stiffness == pytest.approx(
        pitch.covariance[1, 2] / pitch.stiffness
    )


def test_the_arm_weighs_what_hangs_on_its_sensor():
    """Force and moment that hold it up, summed body by body."""
    model, data = fresh()
    mount, turn = data.site(f"{SLAVE}/arm_base").xpos, data.body(f"{SLAVE}/chassis").xmat
    total = np.zeros(6)
    for body in range(model.nbody):
        if _hangs_on(model, body, f"{SLAVE}/arm_base_link"):
            push = np.array([0.0, 0.0, GRAVITY * model.body_mass[body]])
            total += np.concatenate([push, np.cross(data.xipos[body] - mount, push)])
    angles = [float(data.joint(f"{SLAVE}/{name}_joint").qpos[0]) for name in ARM_JOINTS]
    axes = turn.reshape(3, 3)
    expected = np.concatenate([total[:3] @ axes, total[3:] @ axes])
    np.testing.assert_allclose(card_arm().weight(angles, UP @ axes), expected, atol=1e-6)


def _hangs_on(model: mujoco.MjModel, body: int, link: str) -> bool:
    while body and model.body(body).name != link:
        body = int(model.body_parentid[body])
    return body != 0
