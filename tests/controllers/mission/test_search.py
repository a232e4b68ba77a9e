"""Stage ``search``: where the panel may be before anything is seen."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mapping.localization import CameraPose
from controllers.mission.radio import MissionRadio, Status
from controllers.mission.stages.search import SearchPanel, _tells_attitude  # pyright: ignore
from tests.controllers.mission.hand_made import SITE, SLAVE, belief_of, hand_links
from tests.controllers.motion.seen import seen_at


def radio_of() -> MissionRadio:
    return MissionRadio(hand_links()[0], "rover1")


def test_the_panel_may_be_where_a_level_rover_sees_it_from_each_possible_initial_pose():
    belief = belief_of(SLAVE)
    belief.navigator.observe(seen_at(0.0))
    search = SearchPanel(belief, radio_of(), True, np.random.default_rng(3))._possible_places()
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


def test_of_two_rovers_near_the_panel_one_gives_way_while_it_hears_that_the_other_is():
    for first, near, heard, sighted, waits in (
        (False, True, True, (False, False), True),
        (True, True, True, (False, False), False),
        (False, False, True, (False, False), False),
        (False, True, False, (False, False), False),
        (False, True, True, (True, True), True),
        (False, True, True, (True, False), False),
        (True, True, True, (False, True), True),
        (True, True, False, (False, True), False),
    ):
        belief, radio = belief_of(SLAVE), radio_of()
        belief.navigator.observe(seen_at(0.0))
        stage = SearchPanel(belief, radio, first, np.random.default_rng(3))
        stage.search = stage._possible_places()
        panel = stage.search.places[0] if near else stage.search.places[0] + 9.0
        stage.search.places[:] = panel
        belief.navigator.odometry._pose = RigidTransform.from_translation(  # pyright: ignore
            stage.search.places[0] - [1.0, 0.0, 0.0] if near else np.zeros(3)
        )
        radio.begin_tick(0.0)
        radio.begin_tick(0.0 if heard else 10.0)
        radio.partner = Status(1, near=True, sighted=sighted[1])
        if sighted[0]:
            stage.search.sight(stage.search.places[0], stage.search._normals[0])
        assert stage._gives_way() == waits
        assert radio.near == near and radio.sighted == sighted[0]


def test_a_far_view_tells_the_attitude_where_its_worst_axis_does():
    axes = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    for worst, tells in ((0.010, True), (0.015, False)):
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = axes @ np.diag(np.square([0.001, worst, 0.002])) @ axes.T
        assert _tells_attitude(CameraPose(RigidTransform.identity(), covariance)) == tells
