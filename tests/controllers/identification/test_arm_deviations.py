"""What is unknown of an arm, against closed forms and arms that are built differently."""

import dataclasses

import numpy as np
import pytest

from controllers.identification.arm_deviations import (
    ArmAsMade,
    ArmDeviations,
    calibrate,
    deviation_columns,
    leaning,
    loaded,
)
from controllers.identification.arm_sensing import ArmRecord
from controllers.kinematics.rigid_motion import (
    LEVEL,
    FrameMotion,
    inertial_parameters,
    wrench_regressor,
)
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.gravity import GRAVITY
from twin.describe import describe_rover
from twin.description import RigidBody

BOX = RigidBody(0.2, np.array([0.01, 0.12, -0.015]), np.diag([2e-4, 1e-4, 3e-4]))
LOADS = np.array([100.0, 100.0, 200.0, 5.0, 5.0, 5.0])
DEVIATIONS = ArmDeviations(
    mass=0.03,
    centre=6e-3,
    length=1e-3,
    encoder=3e-3,
    play=8e-4,
    usual_play=3e-3,
    tilt=4e-4,
    zero=0.003 * LOADS,
    drift=0.003 * LOADS,
    warm_up=600.0,
    matrix=0.006 * LOADS[:, None] / LOADS,
)
NO_PLAY = dataclasses.replace(DEVIATIONS, usual_play=0.0)
TICKS = 60


@pytest.fixture(scope="module")
def arm():
    return SerialChain.of_robot(describe_rover())


def at_rest(angles):
    """A level arm that keeps still for a while."""
    still, count = np.zeros((TICKS, 3)), TICKS
    up = np.tile([0.0, 0.0, GRAVITY], (count, 1))
    return ArmRecord(
        100.0 + 0.01 * np.arange(count),
        np.tile(angles, (count, 1)),
        np.zeros((count, 4)),
        np.zeros((count, 4)),
        FrameMotion(up, still, still),
        np.zeros((count, 6)),
    )


def moving(rng):
    record = at_rest(np.zeros(4))
    rows = rng.normal(size=(3, TICKS, 4)) * np.array([0.5, 1.0, 3.0])[:, None, None]
    return dataclasses.replace(record, angles=rows[0], rates=rows[1], accelerations=rows[2])


def test_loaded_arm_feels_its_own_wrench_and_the_payloads(arm):
    record = moving(np.random.default_rng(0))
    motion = record.angles, record.rates, record.accelerations, record.base
    payload = inertial_parameters(BOX)
    apart = arm.inverse_dynamics(*motion)[1]
    apart += wrench_regressor(arm.last_link_motion(*motion)) @ payload
    np.testing.assert_allclose(
        loaded(arm, payload).inverse_dynamics(*motion)[1], apart, rtol=1e-9, atol=1e-9
    )


def test_links_lean_down_in_their_gears_and_up_behind_the_shoulder(arm):
    forward = leaning(at_rest([0.0, 0.0, 0.0, 0.0]), arm)
    np.testing.assert_allclose(forward[:, 1:3], -1.0, atol=1e-3)
    np.testing.assert_allclose(forward[:, 0], 0.0, atol=1e-6)
    behind = leaning(at_rest([0.0, np.pi, 0.0, 0.0]), arm)
    np.testing.assert_allclose(behind[:, 1:3], 1.0, atol=1e-3)
    usual = ArmAsMade.drawn(arm, DEVIATIONS).motion(at_rest([0.0, 0.0, 0.0, 0.0]))
    assert usual.angles[0, 1] == pytest.approx(-DEVIATIONS.usual_play, rel=1e-3)


def test_a_payload_in_front_pulls_an_upright_wrist_over_to_the_other_side_of_its_play(arm):
    record = at_rest([0.0, np.pi / 2, 0.0, 0.0])
    ahead = RigidBody(0.3, np.array([0.0, 0.12, -0.1]), 1e-4 * np.eye(3))
    held = loaded(arm, inertial_parameters(ahead))
    # Its own cameras are behind it.
    assert leaning(record, arm)[0, 3] > 0.9
    assert leaning(record, held)[0, 3] < -0.9


def test_first_columns_are_the_weight_of_the_flange_and_of_its_moved_centre(arm):
    columns = deviation_columns(at_rest([0.3, 1.0, -0.5, 0.2]), arm, np.zeros(10), NO_PLAY)
    weight = arm.base.mass * GRAVITY
    x, y, _ = arm.base.centre
    heavier = DEVIATIONS.mass * weight * np.array([0.0, 0.0, 1.0, y, -x, 0.0])
    np.testing.assert_allclose(columns[0, :, 0], heavier, atol=1e-9)
    # Its centre moved ahead: the weight's moment about x.
    moved = [0.0, 0.0, 0.0, DEVIATIONS.centre * weight, 0.0, 0.0]
    np.testing.assert_allclose(columns[0, :, 2], moved, atol=1e-9)


def test_last_columns_are_zero_drift_and_cross_talk_of_the_sensor(arm):
    record = at_rest([0.3, 1.0, -0.5, 0.2])
    columns = deviation_columns(record, arm, np.zeros(10), NO_PLAY)[:, :, -48:]
    still = np.zeros(4)
    load = arm.inverse_dynamics(record.angles[0], still, still, LEVEL)[1]
    warm = 1.0 - np.exp(-record.times / DEVIATIONS.warm_up)
    for row in range(6):
        zero, drift, *crossed = np.moveaxis(columns[:, :, 8 * row : 8 * row + 8], 2, 0)
        np.testing.assert_allclose(zero[:, row], DEVIATIONS.zero[row])
        np.testing.assert_allclose(drift[:, row], DEVIATIONS.drift[row] * warm)
        felt = DEVIATIONS.matrix[row] * load
        np.testing.assert_allclose(np.array(crossed)[:, 0, row], felt, atol=1e-12)
        others = np.delete(columns[:, :, 8 * row : 8 * row + 8], row, axis=1)
        np.testing.assert_array_equal(others, 0.0)


def test_columns_add_up_to_what_a_differently_made_arm_feels(arm):
    """An arm with all bodies heavier, turned joints and a tilted base, to first order."""
    record, payload = moving(np.random.default_rng(1)), inertial_parameters(BOX)
    small = dataclasses.replace(NO_PLAY, mass=1e-4, encoder=1e-5, tilt=1e-5)
    columns = deviation_columns(record, arm, payload, small)

    def heavier(body):
        return RigidBody(1.0001 * body.mass, body.centre, 1.0001 * body.inertia)

    joints = tuple(dataclasses.replace(j, body=heavier(j.body)) for j in arm.joints)
    made = dataclasses.replace(arm, base=heavier(arm.base), joints=joints)
    pitch = 1e-5
    up = np.tile([0.0, np.sin(pitch), np.cos(pitch)], (TICKS, 1)) * GRAVITY
    base = dataclasses.replace(record.base, specific_force=up)
    other = record.angles + [1e-5, 0.0, 1e-5, 0.0], record.rates, record.accelerations, base
    motion = record.angles, record.rates, record.accelerations, record.base
    change = loaded(made, payload).inverse_dynamics(*other)[1]
    change -= loaded(arm, payload).inverse_dynamics(*motion)[1]
    bodies = 4 + 7 * np.arange(len(arm))  # Flange, then each link's body and joint.
    turned = 4 + 7 * len(arm) + 2 * np.array([0, 2])
    tilted = 4 + 9 * len(arm)
    chosen = columns[:, :, [0, *bodies, *turned, tilted]].sum(axis=2)
    np.testing.assert_allclose(chosen, change, atol=2e-3 * np.abs(change).max())


def test_sensor_undone_gives_the_wrench_that_it_was_shown(arm):
    rng = np.random.default_rng(3)
    drawn = ArmAsMade.drawn(arm, DEVIATIONS)
    made = dataclasses.replace(drawn, unknowns=rng.normal(size=drawn.unknowns.shape))
    record, true = at_rest(np.zeros(4)), rng.normal(size=(TICKS, 6))
    shown = dataclasses.replace(record, wrench=made.sensed(true, record.times))
    assert np.abs(shown.wrench - true).max() > 0.1
    np.testing.assert_allclose(made.felt(shown), true, atol=1e-9)


def test_calibration_explains_an_unseen_motion_of_an_arm_that_was_made_differently(arm):
    """Ten times as well as the drawing, from a swing with the sensor's noise."""
    drawn = ArmAsMade.drawn(arm, DEVIATIONS)
    noise = np.array([0.1] * 3 + [0.01] * 3)
    ratios = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        made = dataclasses.replace(drawn, unknowns=rng.normal(size=drawn.unknowns.shape))

        def shown(angles, made=made):
            """What encoders and wrench sensor show; the angles change at an even rate."""
            count = len(angles)
            still = np.zeros((count, 3))
            up = np.tile([0.0, 0.0, GRAVITY], (count, 1))
            nothing = np.zeros((count, 6))
            base = FrameMotion(up, still, still)
            times, rest = 50.0 + 0.01 * np.arange(count), np.zeros((count, 4))
            record = ArmRecord(times, angles, rest, rest, base, nothing)
            moved = made.motion(record)
            motion = moved.angles, moved.rates, moved.accelerations, moved.base
            wrench = made.sensed(made.bodies.inverse_dynamics(*motion)[1], times)
            return dataclasses.replace(record, wrench=wrench)

        phases = np.linspace(0.0, 2.0 * np.pi, 2000)[:, None] * [3.0, 2.0, 5.0, 7.0]
        swung = shown(np.array([0.0, 1.3, -0.7, 0.0]) + [1.4, 0.6, 0.7, 1.0] * np.sin(phases))
        noisy = swung.wrench + noise * rng.normal(size=swung.wrench.shape)
        found = calibrate(dataclasses.replace(swung, wrench=noisy), 99, noise, drawn)
        unseen = shown(rng.uniform([-1.0, 0.7, -1.2, -0.8], [1.0, 1.8, 0.0, 0.8], (TICKS, 4)))
        left = [
            unseen.wrench
            - each.sensed(
                each.bodies.inverse_dynamics(
                    *(getattr(each.motion(unseen), n) for n in ("angles", "rates")),
                    unseen.accelerations,
                    each.motion(unseen).base,
                )[1],
                unseen.times,
            )
            for each in (drawn, found)
        ]
        ratios.append([np.linalg.norm(part / noise) for part in left])
    before, after = np.mean(ratios, axis=0)
    assert after < 0.1 * before
