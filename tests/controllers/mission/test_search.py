"""Stage ``search``: where the panel may be before anything is seen."""

import numpy as np

from controllers.mission.stages.search import SearchPanel
from tests.controllers.mission.hand_made import SITE, SLAVE, belief_of
from tests.controllers.motion.seen import seen_at


def test_the_panel_may_be_where_a_level_rover_sees_it_from_each_possible_initial_pose():
    belief = belief_of(SLAVE)
    belief.navigator.observe(seen_at(0.0))
    search = SearchPanel(belief, np.random.default_rng(3))._possible_places()
    poses = SITE.draw_initial_poses(SLAVE, len(search.places), np.random.default_rng(3))
    panel = SITE.transform_panel_to_ground
    x, y, z = panel.translation
    face = panel.rotation.apply([0.0, 0.0, 1.0])[:2]
    height = z - belief.robot.centre_height
    for pose, place, normal, frame in zip(poses, search.places, search._normals, search._frames):
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        back = np.array([[cosine, sine], [-sine, cosine]])
        np.testing.assert_allclose(place[:2], back @ ([x, y] - pose[:2]), atol=1e-9)
        np.testing.assert_allclose(place[2], height, atol=1e-9)
        np.testing.assert_allclose(normal, back @ face / np.hypot(*face), atol=1e-9)
        np.testing.assert_allclose(frame[:2], -back @ pose[:2], atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * frame[2]), np.exp(-1j * pose[2]), atol=1e-9)
