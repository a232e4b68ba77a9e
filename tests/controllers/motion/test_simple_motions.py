"""Work at random: within its bounds, and without jumps."""

import numpy as np
import pytest

from controllers.motion.simple_motions import SPEEDS, Work
from twin.connect import connect
from twin.describe import describe_rover
from twin.loop import run

ROBOT = "rover1"


def test_work_keeps_to_its_bounds_without_jumps():
    drawn = describe_rover(ROBOT)
    commands = []

    class Kept(Work):
        def step(self, observations):
            command = super().step(observations)
            commands.append(command[ROBOT])
            return command

    with connect("sim", seed=2) as connection:
        run(connection.robots, [Kept(drawn, np.random.default_rng(3))], connection.clock, [], 20.0)
    wheels = np.array([each.wheels for each in commands])
    angles, rates = (np.array([getattr(c, n) for c in commands]) for n in ("arm", "arm_rates"))
    assert np.abs(wheels).max() <= SPEEDS[1] and np.abs(wheels).max() > SPEEDS[0]
    assert np.abs(np.diff(wheels, axis=0)).max() < 0.05  # noqa: PLR2004
    low, high = drawn.arm.limits.T
    assert np.all(angles >= low) and np.all(angles <= high)
    assert np.ptp(angles, axis=0).min() > 0.2  # noqa: PLR2004
    # Rates are those of the angles.
    assert rates[:-1] == pytest.approx(np.diff(angles, axis=0) / 0.01, abs=0.05)
