"""Weighings into inclinometer constants, and the procedure that leads a person through them."""

import dataclasses
import datetime
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from models.datasheets import DEGREE
from perception.geometry.gravity import GRAVITY
from twin.hardware.calibration.calibration import calibration_path, read_calibration
from twin.hardware.calibration.procedure import (
    ProcedureConfig,
    ProcedureError,
    run_procedure,
    tilt_procedure,
)
from twin.hardware.calibration.tilt_fit import (
    Sample,
    Weighing,
    fit_tilt,
    fitted_line,
    sample,
    tilt_of_up,
    two_point_line,
    up_of_tilt,
    weighed_tilts,
)
from twin.sensor_bank import tilt as tilt_of_orientation

pytestmark = pytest.mark.virtual_time

TODAY = datetime.date(2026, 12, 1)
ROBOT = read_calibration(calibration_path("rover1"))
SENSORS = (ROBOT.inclinometer.pitch, ROBOT.inclinometer.roll)
CONFIG = ProcedureConfig()
ARM_WEIGHT = CONFIG.arm_mass * GRAVITY
tilts = st.tuples(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2))


class Bench:
    """A robot as statics has it: it sags by a fixed compliance under the weight."""

    def __init__(self, sensors=SENSORS, compliance=0.0014, noise=0.0, weight=0.5, seed=0):
        self.sensors, self.compliance, self.weight = sensors, compliance, weight * GRAVITY
        self.noise, self.rng = noise, np.random.default_rng(seed)
        self.tilt, self.hung, self.bias = np.zeros(2), False, np.array([0.3, -0.2, 5.0])

    def measure(self):
        load = self.weight * self.hung
        tilt = self.tilt - np.array([1.0, 0.2]) * self.compliance * load
        force = (ARM_WEIGHT + load) * up_of_tilt(tilt) + self.bias
        volts = [sensor.volts(angle) for sensor, angle in zip(self.sensors, tilt)]
        return sample(
            np.array(volts) + self.rng.normal(0.0, 1e-4 + self.noise / 50, (50, 2)),
            force + self.rng.normal(0.0, 1e-4 + self.noise, (200, 3)),
        )

    def weigh(self, tilt):
        self.tilt = np.array(tilt)
        self.hung = False
        before = self.measure()
        self.hung = True
        return Weighing(before, self.measure())


def follow(bench, config=CONFIG, upset=None, answers=None):
    """Run the procedure with a person who does what is said; `upset` changes single samples."""
    output_lines, count = [], iter(range(1000))

    def show(text):
        output_lines.append(text)
        if "take the weight off" in text:
            number = int(text.split()[1]) - 1
            bench.tilt, bench.hung = np.array(config.tilts[number]), False
        if text.startswith("Hang"):
            bench.hung = True

    def measure():
        index, reading = next(count), bench.measure()
        return upset(index, reading) if upset else reading

    def ask(_):
        return next(answers) if answers else ""

    result = run_procedure(tilt_procedure(ROBOT, config, TODAY), measure, ask, show)
    return result, output_lines


@settings(deadline=None)
@given(tilts)
def test_vertical_of_a_tilt_gives_the_tilt_back(tilt):
    up = up_of_tilt(tilt)
    assert np.linalg.norm(up) == pytest.approx(1.0)
    np.testing.assert_allclose(tilt_of_up(up), tilt, atol=1e-9)


@settings(deadline=None)
@given(st.integers(0, 2**31))
def test_tilt_of_the_vertical_is_the_contracts_pitch_and_roll(seed):
    rotation = Rotation.random(rng=np.random.default_rng(seed))
    x, y, z, w = rotation.as_quat()
    seen = rotation.inv().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(tilt_of_up(seen), tilt_of_orientation(w, x, y, z)[:2], atol=1e-9)


def test_sag_turns_the_added_force_by_the_ratio_of_the_weights_times_the_sag():
    bench = Bench()
    weighing = bench.weigh((0.0, 0.0))
    sag = -bench.compliance * bench.weight
    raw = weighed_tilts([weighing], None, ARM_WEIGHT)[0]
    assert raw[0] == pytest.approx(sag * (1 + ARM_WEIGHT / bench.weight), rel=5e-3)
    slopes = [sensor.volts_per_radian for sensor in SENSORS]
    clean = weighed_tilts([weighing], slopes, ARM_WEIGHT)[0]
    np.testing.assert_allclose(clean, [sag, 0.2 * sag], atol=1e-4)


def test_heavier_weight_does_not_lessen_the_error_by_sag():
    errors = []
    for weight in (0.25, 0.5, 1.0):
        bench = Bench(weight=weight)
        raw = weighed_tilts([bench.weigh((0.0, 0.0))], None, ARM_WEIGHT)[0, 0]
        errors.append(raw + bench.compliance * bench.weight)
    np.testing.assert_allclose(errors, errors[0], rtol=0.02)
    assert abs(errors[0]) > 0.5 * DEGREE


def test_constants_are_recovered_without_noise_and_spoilt_by_sag_if_it_stays_in():
    bench = Bench()
    weighings = [bench.weigh(tilt) for tilt in CONFIG.tilts]
    for two_point in (False, True):
        lines = fit_tilt(weighings, ARM_WEIGHT, two_point=two_point)
        for line, sensor in zip(lines, SENSORS):
            assert line.zero_volts == pytest.approx(sensor.zero_volts, abs=2e-4)
            assert line.volts_per_radian == pytest.approx(sensor.volts_per_radian, rel=1e-3)
    spoilt, _ = fit_tilt(weighings, ARM_WEIGHT, without_sag=False)
    assert spoilt.zero_volts - SENSORS[0].zero_volts > 0.015


def test_line_and_its_standard_errors_agree_with_numpys():
    rng = np.random.default_rng(3)
    angles = rng.uniform(-0.3, 0.3, 9)
    volts = 2.4 + 2.0 * angles + rng.normal(0.0, 0.01, 9)
    line = fitted_line(angles, volts)
    (slope, zero), covariance = np.polyfit(angles, volts, 1, cov=True)
    assert (line.volts_per_radian, line.zero_volts) == pytest.approx((slope, zero))
    assert (line.slope_error, line.zero_error) == pytest.approx(np.sqrt(np.diag(covariance)))


def test_two_points_are_the_outermost_and_need_two_tilts():
    line = two_point_line([0.1, -0.2, 0.3], [2.5, 2.0, 3.0])
    assert line.volts_per_radian == pytest.approx(2.0) and line.zero_volts == pytest.approx(2.4)
    assert math.isnan(line.slope_error)
    for fit in (two_point_line, fitted_line):
        with pytest.raises(ValueError, match="two different tilts"):
            fit([0.1, 0.1, 0.1], [2.0, 2.1, 2.2])


def test_person_is_led_to_a_calibration_of_today():
    result, output_lines = follow(Bench(noise=0.1, seed=4))
    section = result.calibration.inclinometer
    assert section.calibrated_on == TODAY and "5 tilts" in section.source
    for new, old in ((section.pitch, SENSORS[0]), (section.roll, SENSORS[1])):
        assert new.pin == old.pin
        assert new.zero_volts == pytest.approx(old.zero_volts, rel=0.005)
        assert new.volts_per_radian == pytest.approx(old.volts_per_radian, rel=0.02)
    unchanged = dataclasses.replace(result.calibration, inclinometer=ROBOT.inclinometer)
    assert unchanged == ROBOT
    assert len(result.weighings) == 5
    assert (
        "raise its front by 12 degrees" in output_lines[2]
        and "raise its right side" in output_lines[8]
    )
    assert f"pitch: zero at {section.pitch.zero_volts:.4f} +-" in output_lines[-1]
    assert "mV/degree" in output_lines[-1]


def test_standard_errors_cover_the_truth():
    covered = []
    for seed in range(60):
        bench = Bench(noise=0.1, seed=seed)
        lines = fit_tilt([bench.weigh(tilt) for tilt in CONFIG.tilts], ARM_WEIGHT)
        for line, sensor in zip(lines, SENSORS):
            covered.append(abs(line.zero_volts - sensor.zero_volts) < 3.18 * line.zero_error)
            slope = abs(line.volts_per_radian - sensor.volts_per_radian)
            covered.append(slope < 3.18 * line.slope_error)
    # 3.18 is Student's 95 % point at the 3 degrees of freedom of five readings.
    assert 0.90 < np.mean(covered) < 0.99


def refused(upset, match, bench=None, config=CONFIG):
    """One bad weighing is reported, repeated and replaced."""
    result, output_lines = follow(bench or Bench(), config, upset)
    problems = [text for text in output_lines if text.startswith("Not taken")]
    assert len(problems) == 1 and match in problems[0]
    assert len(result.weighings) == len(config.tilts)


def shifted(at, **changes):
    """Change one sample by adding to its fields."""

    def upset(index, reading):
        if index != at:
            return reading
        return dataclasses.replace(
            reading, **{name: getattr(reading, name) + value for name, value in changes.items()}
        )

    return upset


def test_implausible_weighings_are_refused_and_asked_for_again():
    refused(shifted(1, force=np.array([0, 0, -4.905])), "hardly shows", Bench(noise=0.1))
    refused(shifted(3, force=np.array([0, 0, 1.0])), "where the weight is 4.9")
    refused(shifted(3, force=np.array([0, 1.0, -0.35])), "linear range")
    refused(shifted(2, volts_error=0.01), "moved")
    refused(shifted(4, volts=np.array([math.nan, 0.0])), "no number")
    refused(shifted(9, force=np.array([0, math.inf, 0.0])), "no number")


def test_same_tilt_twice_is_refused():
    bench = Bench()
    slipped = bench.weigh(CONFIG.tilts[0])

    def upset(index, reading):
        return {2: slipped.before, 3: slipped.after}.get(index, reading)

    refused(upset, "too close")


def test_tilts_that_never_change_end_the_procedure():
    with pytest.raises(ProcedureError, match="tilt 2 failed 5 times.*too close"):
        follow(Bench(), upset=lambda index, reading: _level(index))


def _level(index):
    weighing = Bench().weigh((0.0, 0.0))
    return weighing.after if index % 2 else weighing.before


def test_tilt_in_one_axis_only_is_refused():
    config = ProcedureConfig(tilts=((0.0, 0.0), (0.2, 0.0), (-0.2, 0.0)))
    with pytest.raises(ProcedureError, match=r"roll: the tilts span \d\.\d degrees, needs 12"):
        follow(Bench(), config)


def test_wrong_input_and_slipping_readings_are_not_made_a_calibration():
    flat = tuple(dataclasses.replace(sensor, volts_per_radian=0.5) for sensor in SENSORS)
    with pytest.raises(ProcedureError, match="far from the usual 33; is the right input wired"):
        follow(Bench(flat))
    swapped = (SENSORS[1], SENSORS[0])
    result, _ = follow(Bench(swapped))  # axes of nearly one sensitivity: indistinguishable
    assert result.pitch.zero_volts == pytest.approx(2.406, abs=1e-3)
    bent = shifted(3, volts=np.array([0.12, 0.0]))
    with pytest.raises(ProcedureError, match="off their line"):
        follow(Bench(), upset=lambda i, r: bent(i, shifted(2, volts=np.array([0.12, 0.0]))(i, r)))


def test_person_may_stop_at_any_step():
    for step in range(10):
        answers = iter([""] * step + [" Q "])
        with pytest.raises(ProcedureError, match="stopped"):
            follow(Bench(), answers=answers)


def test_reversed_force_sensor_is_noticed():
    def upset(_, reading):
        return dataclasses.replace(reading, force=-reading.force)

    with pytest.raises(ProcedureError, match="linear range"):
        follow(Bench(), upset=upset)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"tilts": ((0.0, 0.0), (0.1, 0.1))}, "at least 3"),
        ({"tilts": ((0.0, 0.0), (0.1, 0.1), (0.4, 0.0))}, "linear range"),
        ({"weight": 0.0}, "weight"),
        ({"attempts": 0}, "attempts"),
    ],
)
def test_impossible_procedure_is_refused(changes, match):
    with pytest.raises(ValueError, match=match):
        ProcedureConfig(**changes)


def test_sample_of_a_constant_has_no_error():
    still = sample(np.ones((4, 2)), np.zeros((4, 3)))
    assert isinstance(still, Sample) and not np.any(still.volts_error)
