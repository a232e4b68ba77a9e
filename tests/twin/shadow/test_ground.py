"""Even ground that a rover drives over, of which its twin takes its own tilt for a part."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin.shadow.ground import EvenGround


def taken(slope, own, heading):
    """What a rover with a small tilt of its own takes the ground to be, by rotations."""
    turned = Rotation.from_euler("z", heading)
    roll, pitch = turned.apply([own[1], -own[0], 0.0])[:2]
    return np.array(slope) + [-pitch, roll]


@pytest.mark.parametrize("turning", [0.002, 0.01])
def test_it_tells_the_slope_from_a_tilt_of_the_rovers_own(turning):
    ground, rng = EvenGround(), np.random.default_rng(1)
    slope, own = np.array([0.1, -0.05]), np.array([0.02, 0.01])
    for tick in range(2000):
        seen = taken(slope, own, turning * tick) + 0.003 * rng.standard_normal(2)
        ground.drive(seen, turning * tick)
    assert ground.slope == pytest.approx(slope, abs=0.0015)
    for heading in (0.0, 1.0, 4.0):
        assert ground.taken(heading) == pytest.approx(taken(slope, own, heading), abs=0.003)


def test_a_rover_that_never_turned_is_taken_to_stand_straight():
    ground, rng = EvenGround(), np.random.default_rng(2)
    for _ in range(2000):
        ground.drive([0.1, -0.05] + 0.003 * rng.standard_normal(2), 0.7)
    assert ground.slope == pytest.approx([0.1, -0.05], abs=0.001)
    assert ground.taken(0.7) == pytest.approx([0.1, -0.05], abs=0.001)


def test_it_forgets_what_lies_far_behind_and_begins_anew():
    ground = EvenGround()
    for slope in (0.1, 0.2):
        for tick in range(30000):
            ground.drive(np.array([slope, 0.0]), 0.01 * tick)
    assert ground.slope == pytest.approx([0.2, 0.0], abs=0.002)
    ground.begin(np.array([0.0, 0.3]))
    assert ground.taken(1.0) == pytest.approx([0.0, 0.3])
