"""A lost inclinometer: the weight of the arm gives the tilt, on rocks and while it is pushed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controllers.insertion.team import surrogate_sensing
from controllers.motion.base_tilt import drawn_springs
from controllers.motion.driving import SkidSteer
from models.card_and_slot.stand import TIP
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from tests.controllers.sensing.surrogate_runs import PERIOD, limits, swing, wrench_model
from twin.describe import describe_rover
from twin.robot import MISSING, ArmMode, Command, WheelMode
from twin.simulation import Simulation

ROBOT = "rover1"
LOST, GO, STOP, END = 100, 150, 650, 800
"""Ticks at which the inclinometer is lost, the wheels turn and stop, and the run ends."""
NOISE = np.diag(limits()["arm_base_wrench"].noise ** 2)


def test_weight_of_an_arm_at_rest_gives_the_tilt_of_the_base():
    """The model's own prediction for a tilted base, read with another tilt as the estimate."""
    seen = swing().seen[0]._replace(accelerometer=MISSING, gyro=MISSING)
    tilted = seen.inclinometer.value + np.array([0.05, -0.03])
    true = wrench_model().predict(
        seen._replace(inclinometer=seen.inclinometer._replace(value=tilted)), PERIOD
    )
    model, unsure = wrench_model(), np.full(2, 0.1)
    expected = model.predict(seen, PERIOD, tilt=unsure)
    off = model.tilt_error(seen, expected, true.value, NOISE, unsure, PERIOD)
    assert off is not None
    assert off.value == pytest.approx([0.05, -0.03], abs=2e-3)
    # 0.1 N and 0.05 m/s^2 on an arm of 7.5 N, ten ticks alike.
    unsure = np.sqrt(10.0) * np.hypot(0.1 / 7.46, 0.05 / 9.81)
    assert np.sqrt(np.diag(off.covariance)) == pytest.approx(unsure, rel=0.15)


@pytest.mark.parametrize("force", [(0.0, -3.0, 0.0), (3.0, 0.0, 0.0)])
def test_touch_is_not_taken_for_a_tilt(force):
    seen = swing().seen[0]._replace(accelerometer=MISSING, gyro=MISSING)
    model, unsure = wrench_model(), np.full(2, 0.03)
    expected = model.predict(seen, PERIOD, tilt=unsure)
    # Of the hand, half a metre before the arm's base and a little above.
    pushed = np.concatenate([force, np.cross([0.0, 0.5, 0.1], force)])
    assert model.tilt_error(seen, expected, expected.value + pushed, NOISE, unsure, PERIOD) is None


def drive(seed, weighs, push=0.0):
    """Drive over rocks without an inclinometer; return errors (n, 2) [rad], deviations, states."""
    field = FieldConfig(
        size=(4.8, 4.8), relief=0.02, cell=0.1, rocks=120, rock_radius=(0.02, 0.05), seed=seed,
        texture_pixels=16,
    )  # fmt: skip
    model = make_model(field, [RobotPlacement(ROBOT, card=True, stereo=False)])
    simulation = Simulation(model, [ROBOT], seed=seed, data=settle(model))
    robot, chassis = simulation.robots[ROBOT], simulation.data.body(f"{ROBOT}/chassis")
    wrist = int(model.site_bodyid[model.site(f"{ROBOT}/gripper").id])
    rover = describe_rover(ROBOT, card=True)
    sensing = surrogate_sensing(rover, TIP, drawn_springs(rover))
    robot.activate()
    held = np.array(robot.observe().arm_angles.value)
    errors, deviations, states = [], [], []
    for tick in range(END):
        seen = robot.observe()._replace(accelerometer=MISSING, gyro=MISSING, heading=MISSING)
        if tick >= LOST:
            seen = seen._replace(inclinometer=MISSING)
        # Where contact is announced the weight is not used.
        state = sensing.step(seen, PERIOD, contact=not weighs, obstacles=True)
        if tick >= LOST:
            true = Rotation.from_matrix(chassis.xmat.reshape(3, 3)).as_euler("ZXY")[1:]
            errors.append(state.tilt.value - true)
            deviations.append(np.sqrt(np.diag(state.tilt.covariance)))
            states.append(state)
        forward = 0.06 if GO <= tick < STOP else 0.0
        wheels = SkidSteer.of(describe_rover(ROBOT)).wheel_speeds(forward, 0.0)
        robot.command(Command(wheels, held, WheelMode.SPEED, ArmMode.POSITION))
        if push and tick >= STOP + 50:
            simulation.data.xfrc_applied[wrist, 1] = -push
        simulation.tick()
    simulation.close()
    return np.array(errors), np.array(deviations), states


def test_tilt_is_known_over_rocks_without_an_inclinometer():
    errors, deviations, states = drive(seed=0, weighs=True)
    assert np.degrees(np.abs(errors)).max() < 3.0
    assert np.degrees(deviations[-1]).max() < 0.5
    assert np.abs(errors[-1] / deviations[-1]).max() < 4.0
    assert np.mean((errors / deviations) ** 2) < 1.5
    assert not any(state.stop for state in states)
    assert {name for state in states for name in state.failed} == {"inclinometer"}


def test_without_the_weight_the_tilt_is_lost_and_the_task_stops():
    errors, deviations, states = drive(seed=0, weighs=False)
    # What the ground does in the meantime is chance: the deviation has grown to cover it.
    assert np.degrees(deviations[-1]).min() > 4.0
    assert np.abs(errors / deviations).max() < 4.0
    assert "inclinometer missing: component" in states[-1].stop


@pytest.mark.slow
def test_hand_that_is_pushed_does_not_change_the_tilt():
    errors, _, states = drive(seed=0, weighs=True, push=3.0)
    # The push itself tilts the base, and that is known through the springs.
    before = errors[STOP + 50 - LOST]
    assert np.degrees(np.abs(errors[-50:] - before)).max() < 0.3
    assert not any("arm_base_wrench" in state.failed for state in states)
