"""What acceleration tells an inclinometer, against a sensor on the axis, which feels none."""

import dataclasses

import numpy as np

from controllers.identification.pitch import PitchPrior
from controllers.identification.pitch_model import PitchSensors
from experiments.ch2.rover.acceleration import acceleration_gain

PARAMETERS = np.array([0.072, 0.054, 0.1, 1.5, 317.0])
FINE = PitchSensors(period=0.001, tilt_period=0.04)
INDICES = np.arange(0, 8000, 40)


def swept(sensors):
    """Return forces and moments of a sweep from 1 to 12 Hz."""
    time = np.arange(8000) * sensors.period
    phase = 2.0 * np.pi * (time + 11.0 * time**2 / 16.0)
    wrench = np.zeros((8000, 6))
    wrench[:, 1], wrench[:, 2] = 3.0 * np.sin(phase), 2.0 * np.cos(1.3 * phase)
    wrench[:, 3] = np.sin(0.7 * phase)
    return wrench


def test_on_the_axis_acceleration_tells_nothing_and_above_it_much():
    sure = dataclasses.replace(PitchPrior(), lever_sigma=1e-9)
    on_axis = dataclasses.replace(FINE, tilt_height=-PARAMETERS[2])
    gain = acceleration_gain(PARAMETERS, swept(FINE), INDICES, on_axis, sure)
    np.testing.assert_allclose(gain, 1.0, atol=0.03)
    above = acceleration_gain(PARAMETERS, swept(FINE), INDICES, FINE, PitchPrior())
    assert above.min() > 1.0 and above[0] > 2.0
