"""Zeros that drift in readings of a rover that drives over hills, made in closed form."""

import numpy as np
import pytest
from scipy.signal import lfilter

from controllers.sensing.tilt_zeros import TiltZeros

TICK, NOISE, BANDWIDTH, MOST = 0.01, 0.05, 6.0, 0.35
LAG = np.exp(-2.0 * np.pi * BANDWIDTH * TICK)


def readings(seconds, seed=1):
    """Tilt and forces on hills; for half of the time the rover skids, which shakes all."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, TICK)
    pitch, roll = 0.1 * np.sin(0.3 * times), 0.08 * np.cos(0.5 * times)
    force = 9.81 * np.column_stack(
        [-np.cos(pitch) * np.sin(roll), np.sin(pitch), np.cos(pitch) * np.cos(roll)]
    )
    skidding = (times % 6.0 < 3.0)[:, None]  # noqa: PLR2004
    force += 1.5 * skidding * lfilter([0.3], [1.0, -0.7], rng.standard_normal(force.shape), axis=0)
    shown = np.column_stack([np.arcsin(force[:, 1] / 9.81), np.zeros(len(times))])
    shown[:, 1] = np.arcsin(-force[:, 0] / 9.81 / np.cos(shown[:, 0]))
    start = LAG * shown[:1]
    shown, _ = lfilter([1.0 - LAG], [1.0, -LAG], shown, axis=0, zi=start)
    # The inclinometer's own place swings otherwise than the accelerometer's while it is shaken.
    shown += 0.03 * skidding * rng.standard_normal(2) + [0.02, -0.01]
    shown += 0.001 * rng.standard_normal(shown.shape)
    return times, shown, force + NOISE * rng.standard_normal(force.shape)


def found(times, tilts, forces):
    zeros = TiltZeros(BANDWIDTH, MOST, NOISE, TICK)
    told = [
        (time, zeros.step(tilt if number % 4 == 0 else None, force))
        for number, (time, tilt, force) in enumerate(zip(times, tilts, forces, strict=True))
    ]
    return [(time, drift) for time, drift in told if drift is not None]


@pytest.mark.parametrize(("axis", "size"), [(0, 0.017), (1, -0.035)])
def test_a_drift_is_found_once_with_its_size(axis, size):
    times, tilts, forces = readings(60.0)
    tilts[times >= 40.0, axis] += size  # noqa: PLR2004
    ((time, drift),) = found(times, tilts, forces)
    assert 40.0 < time < 44.5  # noqa: PLR2004
    assert drift.axis == axis
    assert abs(drift.size - size) < 3.0 * drift.sigma < 0.8 * abs(size)


@pytest.mark.parametrize("seed", range(5))
def test_hills_and_shaking_are_no_drift(seed):
    assert not found(*readings(120.0, seed))


def test_what_is_told_is_what_it_is_held_against_from_then_on():
    times, tilts, forces = readings(90.0)
    for when in (40.0, 70.0):
        tilts[times >= when, 0] += 0.02
    sizes = [drift.size for _, drift in found(times, tilts, forces)]
    assert sizes == pytest.approx([0.02, 0.02], abs=0.004)
