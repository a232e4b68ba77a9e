"""A camera that comes loose, in pairs of a plane whose texture is known everywhere."""

import numpy as np
import pytest

from controllers.sensing.loose_camera import LOOSE_CAMERA, LooseCamera, LooseCameraConfig
from tests.perception.registration.fiducial_views import HEAD
from tests.perception.stereo.test_eye_turn import turned_pair

MADE = np.array([0.001, -0.002, 0.0015])
"""Turn of the right eye of the head as made [rad]."""
CONFIG = LooseCameraConfig(learning=3)
NOTHING = np.zeros((2, HEAD.height, HEAD.width), np.uint8)


@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.001), (0.01, 0.01, 0.01)])
def test_a_turn_is_named_with_its_size_once_two_pairs_show_it(away):
    eyes = LooseCamera(HEAD, CONFIG)
    for seed in range(4):
        assert eyes.step(turned_pair(MADE, seed)) is None
    assert eyes.step(NOTHING) is None
    found = [eyes.step(turned_pair(MADE + away, 4 + number)) for number in range(3)]
    size = float(np.linalg.norm(away))
    if size < CONFIG.smallest:
        assert found == [None] * 3
        return
    assert found[0] is None and found[1] is not None and found[2] is None
    assert found[1].name == LOOSE_CAMERA
    assert abs(found[1].size - size) < 3.0 * found[1].sigma < 0.01  # noqa: PLR2004


def test_one_strange_pair_is_no_loose_camera():
    eyes = LooseCamera(HEAD, CONFIG)
    turns = [0.0, 0.0, 0.0, 0.02, 0.0, 0.02, 0.0]
    assert [eyes.step(turned_pair([turn, 0.0, 0.0])) for turn in turns] == [None] * 7
