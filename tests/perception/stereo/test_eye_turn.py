"""How an eye is turned, in pairs of a plane whose texture is known everywhere."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.registration.checks import RegistrationError
from perception.stereo.eye_turn import find_eye_turn
from tests.perception.registration.fiducial_views import HEAD
from tests.perception.stereo.textured_plane import TexturedPlane

RIGHT = [HEAD.baseline, 0.0, 0.0]


def turned_pair(turn, seed=3):
    """A pair whose right eye is turned by a rotation vector [rad], in its own frame."""
    rng = np.random.default_rng(seed)
    plane = TexturedPlane(rng)
    right = RigidTransform.from_components(RIGHT, Rotation.from_rotvec(turn))
    eyes = plane.pair(RigidTransform.identity(), rng)[0], plane.pair(right, rng)[0]
    return np.stack(eyes)


@pytest.mark.parametrize(
    "turn", [(0.0, 0.0, 0.0), (0.017, 0.0, 0.0), (0.0, 0.03, 0.0), (-0.005, 0.01, -0.03)]
)
def test_a_turn_is_found_about_each_axis_within_what_it_says(turn):
    found = find_eye_turn(turned_pair(turn), HEAD)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.turn - turn) < 3.0 * np.hypot(sigma, 2e-4)), found
    # Turning about the vertical moves rows by what is far from the middle alone.
    assert sigma[0] < 1e-3 and sigma[2] < 1e-3 and sigma[1] < 5e-3  # noqa: PLR2004


def test_eyes_that_see_nothing_alike_are_refused():
    pair, other = turned_pair(np.zeros(3)), turned_pair(np.zeros(3), seed=4)
    with pytest.raises(RegistrationError, match="expected 20"):
        find_eye_turn(np.stack([pair[0], other[1]]), HEAD)
    with pytest.raises(RegistrationError, match="an eye sees fewer than 20 points"):
        find_eye_turn(np.stack([pair[0], np.zeros_like(pair[0])]), HEAD)
