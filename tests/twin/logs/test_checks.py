"""What is planted in a log is found and named, and a sound log is let pass."""

import dataclasses

import numpy as np
import pytest

from twin.logs.checks import problems
from twin.logs.log import Log, LogError, Signal

STAMPS = 2.0 + 0.01 * np.arange(500)


def sound(unit="rad", scale=1.0):
    values = scale * np.sin(np.outer(STAMPS, [3.0, 5.0]))
    return Signal("sensor", STAMPS.copy(), values, unit)


def found(signal):
    return problems(Log({"tilt": signal}))


def test_a_sound_log_is_let_pass():
    assert found(sound()) == []
    jitter = np.random.default_rng(1).normal(scale=2e-4, size=len(STAMPS))
    assert found(dataclasses.replace(sound(), stamps=STAMPS + jitter)) == []


def with_nan(signal):
    signal.values[[7, 9, 200], 1] = np.nan


def with_infinity(signal):
    signal.values[7] = np.inf


def back(signal):
    signal.stamps[100:] -= 0.52


def twice(signal):
    signal.stamps[[50, 51, 90]] = signal.stamps[[49, 50, 89]]


def jump(signal):
    signal.stamps[300:] += 1.25


def still(signal):
    signal.values[:] = 0.3


def without_stamp(signal):
    signal.stamps[4] = np.nan


@pytest.mark.parametrize(
    ("plant", "said"),
    [
        (with_nan, "3 of 500 samples are no numbers, first at 2.07 s"),
        (with_infinity, "1 of 500 samples are no numbers, first at 2.07 s"),
        (back, "its clock goes back 1 times, by up to 0.51 s, first at 2.99 s"),
        (twice, "stamps occur again, first at 2.49 s"),
        (jump, "1 gaps, of 1.26 s at most, where 125 samples or so are missing or the clock"),
        (still, "never changes"),
        (without_stamp, "1 stamps are no numbers"),
    ],
)
def test_what_is_planted_is_named_with_its_place(plant, said):
    signal = sound()
    plant(signal)
    lines = found(signal)
    assert any(said in line for line in lines), lines
    assert all(line.startswith("tilt: ") for line in lines)


def test_some_actuators_may_rest_but_not_all():
    rests, moves = (
        dataclasses.replace(sound("V"), role="actuator", values=size * sound("V").values)
        for size in (0.0, 1.0)
    )
    assert problems(Log({"wheel": rests, "elbow": moves})) == []
    lines = problems(Log({"wheel": rests, "other": rests, "tilt": sound()}))
    assert lines == ["wheel, other: no command ever changes"]
    rests.values[0] = np.nan
    assert "wheel: no command ever changes" in problems(Log({"wheel": rests, "tilt": sound()}))


def test_missing_samples_are_counted():
    kept = np.ones(len(STAMPS), bool)
    kept[[100, 101, 102, 103, 250, 251]] = False
    signal = sound()
    signal = dataclasses.replace(signal, stamps=STAMPS[kept], values=signal.values[kept])
    (line,) = found(signal)
    assert "2 gaps, of 0.05 s at most, where 6 samples or so are missing" in line


def test_uneven_sampling_is_told():
    stamps = np.cumsum(np.random.default_rng(1).exponential(0.01, len(STAMPS)))
    lines = found(dataclasses.replace(sound(), stamps=stamps))
    assert any("sampled unevenly" in line for line in lines)


@pytest.mark.parametrize(("unit", "scale"), [("rad", 90.0), ("rad/s", 2000.0), ("m", 2000.0)])
def test_values_that_no_robot_has_put_the_unit_in_doubt(unit, scale):
    (line,) = found(sound(unit, scale))
    assert "is the unit right?" in line


def test_gravity_tells_g_from_metres():
    at_rest = np.tile([0.1, 0.2, 9.8], (len(STAMPS), 1))
    at_rest += np.random.default_rng(1).normal(scale=0.05, size=at_rest.shape)
    assert found(Signal("sensor", STAMPS, at_rest, "m/s^2")) == []
    (line,) = found(Signal("sensor", STAMPS, at_rest / 9.8, "m/s^2"))
    assert "are they in g?" in line


def test_too_few_samples_are_told():
    assert found(Signal("sensor", np.zeros(1), np.zeros((1, 1)))) == [
        "tilt: 1 samples; two or more are needed"
    ]


def test_stamps_and_values_have_to_fit():
    with pytest.raises(LogError, match=r"\(3,\) and values of \(2, 1\)"):
        Signal("sensor", np.zeros(3), np.zeros((2, 1)))
