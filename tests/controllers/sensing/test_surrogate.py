"""Surrogates agree with MuJoCo's sensors within their covariances; failed sensors are named."""

import dataclasses

import numpy as np
import pytest

from controllers.motion.base_tilt import TiltAxis
from controllers.sensing.surrogate import SensorLimits, SurrogateSensing
from controllers.sensing.surrogate_models import TiltModel
from tests.controllers.sensing.surrogate_runs import (
    GRIP,
    PERIOD,
    limits,
    sensing,
    swing,
    tilt_config,
    wrench_model,
)
from twin.robot import MISSING, Channel, Observation, Validity

WRENCH, TILT = "arm_base_wrench", "inclinometer"
FIRST, FAIL = 300, 400
"""Ticks at which the monitors begin and at which sensors fail."""


def nees(error, covariance):
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def measured(value, stamp=0.0):
    return Channel(np.array(value, dtype=float), stamp, Validity.MEASURED)


@pytest.mark.parametrize("inertial", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_wrench_model_agrees_with_mujocos_sensor_within_its_covariance(inertial):
    run, model = swing(ticks=300, inertial=True) if inertial else swing(), wrench_model()
    errors, ratios = [], []
    for seen, true in zip(run.seen, run.wrench, strict=True):
        predicted = model.predict(seen, PERIOD)
        errors.append(predicted.value - true)
        ratios.append(nees(errors[-1], predicted.covariance))
    rms = np.sqrt(np.mean(np.square(errors[20:]), axis=0))
    # Below the transducer's own noise of 0.1 N, and near its 0.01 N m.
    assert np.all(rms[:3] < 0.1) and np.all(rms[3:] < 0.03)
    assert 0.3 < np.mean(ratios[20:]) < 1.6


def test_covariance_of_a_contact_is_that_of_pushes_at_the_hand_along_and_about_each_axis():
    run, model, still = swing(), wrench_model(), np.zeros(4)
    angles = run.seen[250].arm_angles.value
    push, twist = model.config.contact, model.config.contact * model.config.contact_radius
    free = run.arm.inverse_dynamics(angles, still, still)[1]
    pushes = [np.concatenate([push * axis, np.cross(GRIP, push * axis)]) for axis in np.eye(3)]
    pushes += [np.append(np.zeros(3), twist * axis) for axis in np.eye(3)]
    felt = [run.arm.inverse_dynamics(angles, still, still, tip=tip)[1] - free for tip in pushes]
    expected = np.transpose(felt) @ felt
    np.testing.assert_allclose(model.contact_covariance(run.seen[250]), expected, atol=1e-9)


def test_tilt_follows_from_the_wrench_when_the_inclinometer_is_lost():
    run, model = swing(), TiltModel(tilt_config())
    errors, ratios = [], []
    for tick, (seen, true) in enumerate(zip(run.seen, run.tilt, strict=True)):
        model.predict(seen, PERIOD)
        if tick < FAIL:
            model.correct(seen.inclinometer.value)
        else:
            errors.append(model.tilt.value - true)
            ratios.append(nees(errors[-1], model.tilt.covariance))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms < limits()[TILT].noise)
    assert rms[1] < 0.25 * np.std(run.tilt[FAIL:, 1])
    assert np.mean(ratios) < 1.5


def test_good_sensors_are_accepted_throughout():
    run, robot = swing(), sensing()
    for seen in run.seen:
        state = robot.step(seen, PERIOD)
        assert not state.faults and not state.stop
        assert state.observation.arm_base_wrench is seen.arm_base_wrench


def spoilt(seen: Observation, name: str, kind: str, held: Channel) -> Observation:
    channel = getattr(seen, name)
    size = 5.0 if name == WRENCH else 0.05
    broken = {
        "missing": MISSING,
        "not finite": channel._replace(value=np.full_like(channel.value, np.nan)),
        "frozen": channel._replace(value=held.value),
        "off": channel._replace(value=channel.value + size),
    }
    return seen._replace(**{name: broken[kind]})


@pytest.mark.parametrize("name", [WRENCH, TILT])
@pytest.mark.parametrize(
    ("kind", "within"), [("missing", 0.02), ("not finite", 0.02), ("off", 0.1), ("frozen", 0.32)]
)
def test_failed_sensor_is_named_in_time_and_replaced(name, kind, within):
    run, robot, state = swing(), sensing(), None
    held = getattr(run.seen[FAIL], name)
    named, worst = None, 0.0
    for tick, seen in list(enumerate(run.seen))[FIRST : FAIL + 60]:
        state = robot.step(spoilt(seen, name, kind, held) if tick >= FAIL else seen, PERIOD)
        assert not state.stop
        if tick >= FAIL and named is None and state.failed:
            # A frozen reading may be off before it is known to be frozen.
            assert state.failed == {name} and state.faults[name] in (kind, "off")
            named = (tick + 1 - FAIL) * PERIOD
        if named is not None:
            assert getattr(state.observation, name).validity is Validity.PREDICTED
            error = state.wrench.value - run.wrench[tick]
            worst = max(worst, np.abs(error[:3]).max())
            tilt_error = np.abs(state.tilt.value - run.tilt[tick]).max()
            assert tilt_error < np.radians(0.2)
    assert (
        named is not None and named <= within and state is not None and state.faults == {name: kind}
    )
    assert name == TILT or worst < 0.3


def test_spike_is_replaced_at_once_and_forgotten():
    run, robot = swing(), sensing()
    for tick, seen in list(enumerate(run.seen))[FIRST : FAIL + 20]:
        state = robot.step(spoilt(seen, WRENCH, "off", MISSING) if tick == FAIL else seen, PERIOD)
        if tick == FAIL:
            assert state.faults == {WRENCH: "spike"} and not state.failed
            assert np.abs(state.wrench.value - run.wrench[tick])[:3].max() < 0.3
        else:
            assert not state.faults


def test_sensor_that_agrees_again_is_accepted_again():
    run, robot = swing(), sensing()
    failed = {}
    for tick, seen in list(enumerate(run.seen))[FIRST : FAIL + 70]:
        lost = FAIL <= tick < FAIL + 20
        state = robot.step(spoilt(seen, TILT, "missing", MISSING) if lost else seen, PERIOD)
        failed[tick] = TILT in state.failed
    assert [tick for tick in failed if failed[tick]] == list(range(FAIL, FAIL + 49))


def test_task_stops_when_a_surrogate_has_served_too_long():
    run, robot, stop = swing(), sensing(longest=1.0), ""
    for tick, seen in list(enumerate(run.seen))[FIRST : FAIL + 110]:
        state = robot.step(seen._replace(arm_base_wrench=MISSING) if tick >= FAIL else seen, PERIOD)
        assert bool(state.stop) == (tick >= FAIL + 100)
        stop = state.stop
    assert "arm_base_wrench missing: predicted for" in stop


@pytest.mark.slow
def test_contact_is_no_fault_but_without_a_wrench_it_stops_the_task():
    run = swing(ticks=300, pushed=True)
    robot, careful, unaware = sensing(), sensing(), sensing()
    state = unaware.step(run.seen[0], PERIOD)
    for seen in run.seen[1:]:
        assert not robot.step(seen, PERIOD, contact=True).faults
        assert not careful.step(seen, PERIOD, obstacles=True).faults
        state = unaware.step(seen, PERIOD)
    assert WRENCH in state.failed
    lost = run.seen[-1]._replace(arm_base_wrench=MISSING)
    assert "arm_base_wrench missing: component" in robot.step(lost, PERIOD, contact=True).stop
    # Where nothing should be touched, free motion predicts what is lost.
    assert not careful.step(lost, PERIOD, obstacles=True).stop


def test_spike_in_contact_stops_nothing_before_it_counts_as_a_failure():
    run, robot, stops = swing(ticks=300, pushed=True), sensing(), []
    for seen in run.seen[:-1]:
        robot.step(seen, PERIOD, contact=True)
    wrench = run.seen[-1].arm_base_wrench
    for tick in range(6):
        spike = wrench._replace(value=wrench.value + 60.0 + tick, stamp=wrench.stamp + 0.01 * tick)
        state = robot.step(run.seen[-1]._replace(arm_base_wrench=spike), PERIOD, contact=True)
        assert state.faults
        stops.append(bool(state.stop))
    # Failed after 0.05 s.
    assert stops == [False] * 4 + [True] * 2


def test_tilt_surrogate_that_has_driven_too_far_stops_the_task():
    run, robot = swing(), sensing()
    for seen in run.seen[FIRST:FAIL]:
        robot.step(seen, PERIOD)
    stops = []
    for seen in run.seen[FAIL:]:
        fast = seen._replace(wheel_speeds=measured(np.full(4, 3.0)), inclinometer=MISSING)
        stops.append(robot.step(fast, PERIOD).stop)
    assert not stops[0] and "inclinometer missing: component" in stops[-1]


def on_a_slope(seen: Observation, slope: float, speed: float = 0.0) -> Observation:
    """Return what a rover without inclinometer measures on a slope [rad], at a speed [rad/s]."""
    level, steep = (
        wrench_model().predict(seen._replace(inclinometer=measured([angle, 0.0])), PERIOD).value
        for angle in (0.0, slope)
    )
    wrench = measured(seen.arm_base_wrench.value + steep - level, seen.time)
    wheels = measured(np.full(4, speed))
    return seen._replace(arm_base_wrench=wrench, wheel_speeds=wheels, inclinometer=MISSING)


def test_lost_inclinometer_on_a_slope_is_not_taken_for_a_failed_wrench():
    run, slope, most = swing(), 0.0, limits()
    # The task goes on with a tilt that is unsure by 5 degrees.
    most[TILT] = dataclasses.replace(most[TILT], largest=np.radians([5.0, 5.0]))
    robot = SurrogateSensing(wrench_model(), TiltModel(tilt_config()), most)
    for seen in run.seen[FIRST:FAIL]:
        robot.step(seen, PERIOD)
    for tick in range(FAIL, FAIL + 260):
        # Five degrees on half a metre of path, then it is at rest on the slope.
        slope = np.radians(min(0.025 * (tick - FAIL), 5.0))
        speed = 3.0 if tick < FAIL + 200 else 0.0
        state = robot.step(on_a_slope(run.seen[tick], slope, speed), PERIOD)
        assert state.failed == {TILT} and not state.stop
    found = []
    for tick in range(FAIL + 260, FAIL + 290):
        seen = on_a_slope(run.seen[tick], slope)
        off = seen.arm_base_wrench.value + np.array([0.0, 10.0, 0.0, 0.0, 0.0, 0.0])
        seen = seen._replace(arm_base_wrench=measured(off, seen.time))
        found.append(WRENCH in robot.step(seen, PERIOD).failed)
    # A wrench that is really off is still found within a tenth of a second.
    assert all(found[10:])


def test_nothing_replaces_the_arms_own_encoders():
    lost = swing().seen[0]._replace(arm_angles=MISSING)
    state = sensing().step(lost, PERIOD)
    assert "arm_angles missing" in state.stop and np.isnan(state.wrench.value).all()


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="stiffness"):
        TiltAxis(0.1, 1.0, 0.0, (0.0, 0.0))
    with pytest.raises(ValueError, match="one of"):
        SensorLimits(np.ones(6), np.ones(2))
    with pytest.raises(ValueError, match="arm_rates is missing"):
        wrench_model().predict(swing().seen[0]._replace(arm_rates=MISSING), PERIOD)
    with pytest.raises(ValueError, match="dt"):
        wrench_model().predict(swing().seen[0], 0.0)
