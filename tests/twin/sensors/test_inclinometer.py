"""An inclinometer senses specific force: against closed forms of what swings, and of filters."""

import math

import mujoco
import numpy as np
import pytest
import scipy.signal

from models.datasheets import INCLINOMETER
from perception.geometry.gravity import GRAVITY
from twin.describe import describe_rover
from twin.robot import Validity
from twin.sensor_bank import SensorBank, tilt, wire
from twin.sensors import CHANNELS, IDEAL, ChannelSpec, SensorSuite, channel_widths

PERIOD = 0.01
RANGE, BANDWIDTH = math.radians(20.0), 6.0
HEIGHT = 0.1
ROVER = describe_rover("rover")
INDEX = CHANNELS.index("inclinometer")


def swinging(frequency, axis):
    """A body on a torsion spring about its centre of gravity, the sensor above it."""
    inertia = 0.1
    stiffness = inertia * (2 * np.pi * frequency) ** 2
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.001" integrator="RK4"/>
        <worldbody><body name="rover/chassis">
          <joint axis="{axis}" stiffness="{stiffness}"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
          <site name="imu" pos="0 0 {HEIGHT}"/>
        </body></worldbody>
        <sensor>
          <framequat name="rover/orientation" objtype="site" objname="imu"/>
          <accelerometer name="rover/inclinometer" site="imu" nsample="10"/>
        </sensor></mujoco>"""
    )
    return model, mujoco.MjData(model)


def readings(model, data, spec, ticks):
    """Step the body, and return the inclinometer's values (n, 2) and stamps (n,)."""
    suite = SensorSuite("tilt", {"inclinometer": spec})
    widths, rng = channel_widths(ROVER), np.random.default_rng(0)
    bank = SensorBank(suite, PERIOD, rng, widths, wire(model, ROVER))
    values, stamps = [], []
    for _ in range(ticks):
        mujoco.mj_step(model, data, 10)
        bank.sample(data.time, data.sensordata, data.history)
        channel = list(bank.channels(data.time))[INDEX]
        assert channel.validity is Validity.MEASURED
        values.append(channel.value)
        stamps.append(channel.stamp)
    return np.array(values), np.array(stamps)


@pytest.mark.parametrize("component, axis", [(0, "1 0 0"), (1, "0 1 0")])
@pytest.mark.parametrize("frequency", [1.0, 4.0, 10.0])
def test_swinging_body_shows_its_tilt_and_forty_times_that_at_ten_hertz(frequency, component, axis):
    """theta + h omega^2 theta / g, through a first-order low pass of 6 Hz."""
    model, data = swinging(frequency, axis)
    data.qpos[0] = amplitude = math.radians(0.1)
    spec = ChannelSpec(force_range=RANGE, bandwidth=BANDWIDTH)
    values, stamps = readings(model, data, spec, 400)
    late = stamps > 1.0
    omega = 2 * np.pi * frequency
    apparent = amplitude * (1.0 + HEIGHT * omega**2 / GRAVITY)
    passed = 1.0 / (1.0 + 1j * frequency / BANDWIDTH)
    wanted = apparent * np.real(passed * np.exp(1j * omega * stamps[late]))
    np.testing.assert_allclose(values[late, component], wanted, atol=0.01 * abs(passed) * apparent)
    np.testing.assert_allclose(values[late, 1 - component], 0.0, atol=1e-6)


def test_masses_stop_before_the_filter():
    """Half a degree at 10 Hz looks like 21: beyond the range it is cut, not averaged away."""
    model, data = swinging(10.0, "1 0 0")
    data.qpos[0] = amplitude = math.radians(1.0)
    spec = ChannelSpec(force_range=RANGE, bandwidth=BANDWIDTH)
    values, stamps = readings(model, data, spec, 200)
    fine = np.arange(0.0, stamps[-1] + 1e-5, 1e-4)
    omega = 2 * np.pi * 10.0
    sine = np.sin(amplitude * np.cos(omega * fine))
    sine += HEIGHT * omega**2 * amplitude * np.cos(omega * fine) / GRAVITY
    cut = np.arcsin(np.clip(sine, -np.sin(RANGE), np.sin(RANGE)))
    assert np.abs(sine).max() > 2 * np.sin(RANGE)
    pole = 2 * np.pi * BANDWIDTH
    _, filtered, _ = scipy.signal.lsim(([pole], [1.0, pole]), cut, fine, X0=[cut[0] / pole])
    late = stamps > 0.5
    wanted = np.interp(stamps[late], fine, filtered)
    np.testing.assert_allclose(values[late, 0], wanted, atol=0.02 * np.abs(wanted).max())


def inclined(pitch, roll):
    """A weightless body at rest at a pitch and a roll."""
    quaternion, about_x, about_y = np.empty(4), np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(about_x, np.array([1.0, 0.0, 0.0]), pitch)
    mujoco.mju_axisAngle2Quat(about_y, np.array([0.0, 1.0, 0.0]), roll)
    mujoco.mju_mulQuat(quaternion, about_x, about_y)
    turn = " ".join(str(part) for part in quaternion)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.001"/><worldbody>
        <body name="rover/chassis" gravcomp="1"><freejoint/><geom size="0.1"/>
        <site name="imu" quat="{turn}"/></body></worldbody>
        <sensor><framequat name="rover/orientation" objtype="site" objname="imu"/>
        <accelerometer name="rover/inclinometer" site="imu" nsample="10"/></sensor></mujoco>"""
    )
    return model, quaternion


@pytest.mark.parametrize("pitch, roll", [(0.2, 0.0), (0.0, -0.25), (0.15, 0.2), (-0.3, 0.1)])
def test_at_rest_it_shows_pitch_and_roll(pitch, roll):
    model, quaternion = inclined(pitch, roll)
    values, _ = readings(model, mujoco.MjData(model), ChannelSpec(force_range=RANGE), 3)
    assert tilt(*quaternion.tolist())[:2] == pytest.approx((pitch, roll))
    np.testing.assert_allclose(values[-1], [pitch, roll], atol=1e-9)


@pytest.mark.parametrize("force_range", [RANGE, None])
def test_on_a_slope_it_shows_its_scale_zero_and_cross_axis(force_range):
    pitch, roll = 0.12, -0.2
    model, _ = inclined(pitch, roll)
    spec = ChannelSpec(
        bias=(0.01, -0.02),
        scale=(1.05, 0.9),
        cross=((0.0, 0.04), (-0.03, 0.0)),
        force_range=force_range,
        bandwidth=BANDWIDTH,
    )
    values, _ = readings(model, mujoco.MjData(model), spec, 3)
    wanted = [1.05 * pitch + 0.04 * roll + 0.01, 0.9 * roll - 0.03 * pitch - 0.02]
    np.testing.assert_allclose(values, [wanted] * 3, atol=1e-9)


def test_masses_stop_before_scale_and_cross_axis():
    model, _ = inclined(0.6, 0.1)
    spec = ChannelSpec(scale=0.5, cross=((0.0, 0.0), (0.1, 0.0)), force_range=RANGE)
    values, _ = readings(model, mujoco.MjData(model), spec, 2)
    # The roll's axis feels gravity along a body that is pitched further than the pitch's stop.
    roll = math.asin(math.cos(0.6) * math.sin(0.1) / math.cos(RANGE))
    np.testing.assert_allclose(values[-1], [0.5 * RANGE, 0.5 * roll + 0.1 * RANGE], atol=1e-9)


def test_one_that_shows_the_orientation_is_not_shaken():
    model, data = swinging(10.0, "1 0 0")
    data.qpos[0] = math.radians(0.1)
    values, stamps = readings(model, data, ChannelSpec(), 50)
    wanted = math.radians(0.1) * np.cos(2 * np.pi * 10.0 * stamps)
    # The orientation is that of the step before.
    np.testing.assert_allclose(values[:, 0], wanted, atol=0.1 * math.radians(0.1))


def test_robot_without_its_accelerometer_has_no_inclinometer():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><geom size="0.1"/><site name="imu"/></body></worldbody>
        <sensor><framequat name="rover/orientation" objtype="site" objname="imu"/></sensor>
        </mujoco>"""
    )
    data = mujoco.MjData(model)
    for spec, validity in (
        (ChannelSpec(force_range=RANGE), Validity.MISSING),
        (ChannelSpec(), Validity.MEASURED),
    ):
        suite = SensorSuite("tilt", {**IDEAL.channels, "inclinometer": spec})
        widths, rng = channel_widths(ROVER), np.random.default_rng(0)
        bank = SensorBank(suite, PERIOD, rng, widths, wire(model, ROVER))
        mujoco.mj_step(model, data)
        bank.sample(data.time, data.sensordata, data.history)
        assert list(bank.channels(data.time))[INDEX].validity is validity


def test_datasheet_is_that_of_the_maker():
    assert math.degrees(INCLINOMETER.linear_range) == pytest.approx(20.0)
    assert INCLINOMETER.bandwidth == 6.0


def test_range_of_specific_force_must_be_positive():
    with pytest.raises(ValueError, match="force_range must be positive, got -1"):
        ChannelSpec(force_range=-1.0)
