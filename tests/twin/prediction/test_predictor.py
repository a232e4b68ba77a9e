"""Predictions for logs, against plain steps of MuJoCo and a closed form."""

import mujoco
import numpy as np
import pytest

from tests.experiments.own import hidden
from twin.logs.log import Log, LogError, Signal
from twin.prediction.parameters import explicit, select
from twin.prediction.predictor import ModelPredictor

SLED = """<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body>
  <joint name="slide" type="slide" axis="1 0 0"/><geom size="0.1" mass="2"/>
</body></worldbody><actuator><motor name="push" joint="slide"/></actuator>
<sensor><jointpos name="ruler" joint="slide" noise="0.001"/></sensor></mujoco>"""


def signals(model, stamps, values, times, rows):
    found = {
        model.actuator(index).name: Signal("actuator", stamps, values[:, index : index + 1])
        for index in range(model.nu)
    }
    for index in range(model.nsensor):
        first, count = model.sensor_adr[index], model.sensor_dim[index]
        found[model.sensor(index).name] = Signal("sensor", times, rows[:, first : first + count])
    return Log(found)


@pytest.mark.parametrize("name", hidden.SWINGS)
def test_predicts_what_plain_steps_measure(name):
    spec = mujoco.MjSpec.from_file(hidden.robot(name))
    spec.option.timestep /= hidden.FINE
    model = spec.compile()
    stamps, values = hidden.commands(name, 1.0, np.random.default_rng(2))
    quiet = np.random.default_rng(3)

    def change(hidden_spec):
        for joint in hidden_spec.joints:
            joint.damping[0] *= 1.3
        for sensor in hidden_spec.sensors:
            sensor.noise = 0.0

    times, rows = hidden.measured(name, change, stamps, values, quiet, delay=0.004)
    parameters = select(explicit(spec), ["joint.*.damping", "delay"], {})
    log = signals(model, stamps, values, times, rows)
    predictor = ModelPredictor(spec, parameters, [log])
    coordinates = [np.log(1.3) / 0.3] * model.njnt + [0.004 / parameters[-1].spread]
    found = predictor(np.array([coordinates, np.zeros(len(coordinates))]))
    off = (found - predictor.measured) / predictor.sigma
    # Where dry friction lets a joint come to rest depends on how it came there, until it moves.
    assert np.abs(off[0]).max() < 1.0
    late = np.concatenate(
        [
            np.arange(place.start, place.stop)[predictor.stamps(*key) > 0.7]
            for key, place in predictor.channels.items()
        ]
    )
    assert np.abs(off[0, late]).max() < 0.05
    assert np.abs(off[1]).max() > 10.0
    predictor.close()


@pytest.mark.parametrize("delay", [0.0, 0.0037, 0.02])
def test_held_force_with_a_delay_moves_a_sled_as_a_closed_form_says(delay):
    """F = 3 N from 0.05 s on, and -1 N from 0.2 s on, on 2 kg."""
    stamps, force = np.array([0.0, 0.05, 0.2]), np.array([[0.0], [3.0], [-1.0]])
    times = np.arange(0.0, 0.5, 0.01)
    log = Log(
        {
            "push": Signal("actuator", stamps, force),
            "ruler": Signal("sensor", times, np.zeros((len(times), 1))),
        }
    )
    spec = mujoco.MjSpec.from_string(SLED)
    spec.option.timestep, spec.option.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_RK4
    parameters = select(explicit(spec), ["delay"], {})
    predictor = ModelPredictor(spec, parameters, [log])
    (found,) = predictor(np.array([[delay / parameters[0].spread]]))
    since = [np.maximum(times - start - delay, 0.0) for start in (0.05, 0.2)]
    expected = 0.5 * 1.5 * since[0] ** 2 - 0.5 * 2.0 * since[1] ** 2
    np.testing.assert_allclose(found, expected, atol=1e-6)
    predictor.close()


def test_gain_bias_and_delay_of_a_sensor():
    times = np.arange(0.0, 1.0, 0.01)
    log = Log(
        {
            "push": Signal("actuator", np.zeros(1), np.ones((1, 1))),
            "slide.position": Signal("sensor", times, np.zeros((100, 1)), noise=0.1),
            "slide.velocity": Signal("sensor", times, np.zeros((100, 1)), noise=0.1),
        }
    )
    spec = mujoco.MjSpec.from_string(SLED)
    sensors = {"slide.position": 1, "slide.velocity": 1}
    names = [
        "sensor.slide.velocity.bias:0.1",
        "sensor.slide.velocity.gain",
        "sensor.slide.position.delay",
    ]
    parameters = select(explicit(spec), names, sensors)
    predictor = ModelPredictor(spec, parameters, [log], "moving")
    state = np.zeros((2, 5))
    state[1, :3] = 1.0, -2.0, 1.5  # a bias of 0.1, a gain of e^-0.1, a delay of 30 ms
    plain, changed = predictor(state)
    position, velocity = predictor.channels.values()
    np.testing.assert_allclose(plain[velocity], 0.5 * times, atol=1e-9)
    np.testing.assert_allclose(changed[velocity], np.exp(-0.1) * plain[velocity] + 0.1, atol=1e-12)
    np.testing.assert_allclose(changed[position][3:], plain[position][:-3], atol=1e-12)
    # With semi-implicit steps the place is sum(v dt), of which each v is that after the step.
    np.testing.assert_allclose(plain[position], 0.25 * times * (times + 0.01), atol=1e-9)
    predictor.close()


def test_run_that_begins_moving_takes_place_and_rate_from_its_coordinates():
    times = np.arange(0.0, 0.5, 0.01)
    log = Log(
        {
            "push": Signal("actuator", np.zeros(1), np.zeros((1, 1))),
            "slide.position": Signal("sensor", times, np.full((50, 1), 0.2), noise=0.01),
        }
    )
    predictor = ModelPredictor(mujoco.MjSpec.from_string(SLED), [], [log], "moving")
    assert [name.partition(": ")[2].split(" of")[0] for name in predictor.names] == [
        "place",
        "rate",
    ]
    (found,) = predictor(np.array([[0.5, 0.3]]))
    np.testing.assert_allclose(found, 0.2 + 0.05 + 0.3 * times, atol=1e-9)
    predictor.close()


def test_noise_is_what_the_log_says_else_the_model_else_the_scatter():
    generator = np.random.default_rng(6)
    times = np.arange(0.0, 20.0, 0.01)
    smooth = np.sin(4.0 * times)[:, None]
    scattered = smooth + 0.003 * generator.standard_normal(smooth.shape)

    def sigma(name, values, noise=np.nan):
        log = Log(
            {
                "push": Signal("actuator", np.zeros(1), np.zeros((1, 1))),
                name: Signal("sensor", times, values, noise=noise),
            }
        )
        predictor = ModelPredictor(mujoco.MjSpec.from_string(SLED), [], [log])
        predictor.close()
        return predictor.sigma[0]

    assert sigma("ruler", scattered, 0.02) == 0.02
    assert sigma("ruler", scattered) == 0.001
    assert sigma("slide.position", scattered) == pytest.approx(0.003, rel=0.1)
    assert sigma("slide.position", np.round(smooth, 2)) >= 0.0028
    with pytest.raises(LogError, match="never changes"):
        sigma("slide.position", np.zeros_like(smooth))


@pytest.mark.parametrize(
    ("name", "signal", "message"),
    [
        ("pull", Signal("actuator", np.zeros(1), np.zeros((1, 1))), "no actuator 'pull'.* push"),
        ("tape", Signal("sensor", np.zeros(1), np.zeros((1, 1))), "no sensor 'tape'.* ruler"),
        ("ruler", Signal("sensor", np.zeros(1), np.zeros((1, 3))), "3 numbers in the log, 1 in"),
        ("hinge.position", Signal("sensor", np.zeros(1), np.zeros((1, 1))), "no joint 'hinge'"),
        ("ruler", Signal("sensor", np.zeros(1), np.full((1, 1), np.nan)), "no sample is a number"),
    ],
)
def test_signal_of_nothing_in_the_model_is_refused(name, signal, message):
    with pytest.raises(LogError, match=message):
        ModelPredictor(mujoco.MjSpec.from_string(SLED), [], [Log({name: signal})])


HANGING = """<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body name="platform">
  <joint name="heave" type="slide" axis="0 0 1" stiffness="400" damping="60"/>
  <geom size="0.1" mass="3" contype="0" conaffinity="0"/>
  <body name="bob"><joint name="hinge" axis="0 1 0" damping="0.02"/>
    <geom size="0.03" pos="0 0 -0.4" mass="1" contype="0" conaffinity="0"/></body>
</body></worldbody><actuator><motor name="twist" joint="hinge"/></actuator>
<sensor><jointpos name="encoder" joint="hinge" noise="0.001"/></sensor></mujoco>"""
"""A pendulum below a platform on a spring, of which nothing is measured."""


@pytest.mark.parametrize("name", ["encoder", "hinge.position"])
def test_measured_joint_is_held_while_all_else_comes_to_rest(name):
    spec = mujoco.MjSpec.from_string(HANGING)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = -4.0 * 9.81 / 400.0, 1.2
    times, rows = np.arange(0.0, 1.0, 0.01), []
    for _ in times:
        rows.append([data.qpos[1]])
        mujoco.mj_step(model, data, 10)
    signal = Signal("sensor", times, np.array(rows), noise=0.001)
    twist = Signal("actuator", np.zeros(1), np.zeros((1, 1)))
    predictor = ModelPredictor(spec, [], [Log({"twist": twist, name: signal})], "held")
    found = predictor(np.zeros((1, 0)))[0]
    np.testing.assert_allclose(found, predictor.measured, atol=1e-4)
    assert np.ptp(found) > 1.0
    predictor.close()
