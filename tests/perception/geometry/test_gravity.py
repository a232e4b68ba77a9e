"""Tilt in specific forces, against closed form."""

import numpy as np
import pytest

from perception.geometry.gravity import apparent_tilt


def felt(pitch, roll):
    """Specific force of what stands still (1, 3)."""
    axes = -np.cos(pitch) * np.sin(roll), np.sin(pitch), np.cos(pitch) * np.cos(roll)
    return 9.81 * np.array([axes])


def test_tilt_of_masses_at_rest_is_that_of_the_body():
    assert apparent_tilt(felt(0.1, -0.05))[0] == pytest.approx([0.1, -0.05], abs=1e-6)


def test_masses_stop_at_the_largest_tilt():
    assert apparent_tilt(felt(0.5, -0.45), 0.35)[0] == pytest.approx([0.35, -0.35], abs=1e-6)
