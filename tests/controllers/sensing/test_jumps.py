"""Zeros that jump in readings of an arm that swings, against readings made in closed form."""

import numpy as np
import pytest

from controllers.sensing.jumps import ZeroJumps

TICK, SIGMA = 0.01, (1.1e-4, 0.01)


def readings(seconds, jump, seed=1, stop=None):
    """Angles and rates of four joints that swing; the third is stopped, or its zero jumps."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, TICK)
    own = np.array([1.1, 1.7, 2.3, 0.9])
    angles = 0.5 * np.sin(own * times[:, None])
    rates = 0.5 * own * np.cos(own * times[:, None])
    if stop is not None:
        late = times >= stop
        angles[late, 2], rates[late, 2] = angles[late, 2][0], 0.0
    angles = np.round(angles / 3.8e-4) * 3.8e-4
    angles[times >= 0.5 * seconds, 2] += jump
    return times, angles, rates + SIGMA[1] * rng.standard_normal(rates.shape)


def found(times, angles, rates):
    jumps = ZeroJumps(*SIGMA)
    steps = (
        (time, jumps.step(time, *row)) for time, *row in zip(times, angles, rates, strict=True)
    )
    return [(time, jump) for time, jump in steps if jump is not None]


@pytest.mark.parametrize("size", [0.035, -0.01])
def test_a_jump_is_found_once_and_soon_with_its_size(size):
    ((time, jump),) = found(*readings(4.0, size))
    assert 2.0 < time < 2.1  # noqa: PLR2004
    assert jump.joint == 2  # noqa: PLR2004
    assert abs(jump.size - size) < 3.0 * jump.sigma < 0.3 * abs(size)


def test_a_joint_that_is_stopped_or_read_once_in_a_while_has_not_jumped():
    assert not found(*readings(60.0, 0.0))
    for seed in range(5):
        assert not found(*readings(4.0, 0.0, seed, stop=1.234))
    times, angles, rates = readings(20.0, 0.0)
    angles[700, 1] += 0.1  # One reading that is damaged.
    kept = np.ones(len(times), dtype=bool)
    kept[1000:1100] = False
    assert not found(times[kept], angles[kept], rates[kept])
