"""Stage ``search``: where the panel may be before anything is seen."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mapping.localization import CameraPose
from controllers.mapping.panel_search import Cloud
from controllers.mission.behaviours import Driven
from controllers.mission.radio import MissionRadio, Status
from controllers.mission.stages import search
from controllers.mission.stages.search import SearchPanel, _is_enough  # pyright: ignore
from tests.controllers.mission.hand_made import (
    MASTER,
    SITE,
    SLAVE,
    at_once,
    belief_of,
    hand_links,
    localized,
)
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
            search = stage.search
            search.sight(Cloud(search.places[:1], search._normals[:1], search._frames[:1]))
        assert stage._gives_way() == waits
        assert radio.near == near and radio.sighted == sighted[0]


def test_a_far_view_tells_the_attitude_where_its_worst_axis_does():
    axes = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    for worst, tells in ((0.010, True), (0.015, False)):
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = axes @ np.diag(np.square([0.001, worst, 0.002])) @ axes.T
        far = RigidTransform.from_translation([0.0, 0.0, 3.0])
        assert _is_enough(CameraPose(far, covariance)) == tells


def test_places_of_a_panel_seen_from_far_scatter_as_its_pose_does():
    """The camera looks along the frame's y from (0, 0, 0.5) at a panel 3 m ahead that faces it."""
    belief = belief_of(SLAVE)
    stage = SearchPanel(belief, radio_of(), True, np.random.default_rng(3))
    camera = RigidTransform.from_components([0.0, 0.0, 0.5], Rotation.from_euler("x", -0.5 * np.pi))
    panel = RigidTransform.from_components(
        [0.2, 3.0, 0.3], Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    )
    sigma = np.array([0.02, 0.03, 0.01, 0.01, 0.02, 0.04])
    seen = stage._seen_places(camera, CameraPose(panel.inv() * camera, np.diag(sigma**2)), 200)
    np.testing.assert_allclose(seen.places.mean(axis=0), panel.translation, atol=0.02)
    np.testing.assert_allclose(seen.normals.mean(axis=0), [0.0, -1.0], atol=0.01)
    # A twist in the panel's frame turns about its middle, which only shifts move.
    np.testing.assert_allclose(seen.places.std(axis=0), sigma[[3, 5, 4]], rtol=0.2)
    assert np.arctan2(seen.normals[:, 0], -seen.normals[:, 1]).std() == pytest.approx(0.03, rel=0.2)
    # The ground frame lies where the drawing has it from the panel.
    to_ground = SITE.transform_panel_to_ground.inv()
    origins = seen.frames[:, :2] - seen.places[:, :2]
    expected = panel.rotation.apply(to_ground.apply([0.0, 0.0, 0.0]))[:2]
    np.testing.assert_allclose(origins.mean(axis=0), expected, atol=0.02)


def test_a_sighting_localizes_a_rover_from_near_or_where_it_tells_the_attitude():
    for distance, turn, enough in (
        (1.8, 0.05, True),
        (2.0, 0.05, False),
        (3.0, 0.005, True),
    ):
        away = RigidTransform.from_translation([0.0, 0.0, distance])
        covariance = np.diag([turn**2] * 3 + [1e-6] * 3)
        assert _is_enough(CameraPose(away, covariance)) == enough


@pytest.mark.parametrize("far", [False, True])
def test_a_rover_that_is_to_map_the_site_comes_near_it(monkeypatch, far):
    belief = localized(MASTER)
    navigator = belief.navigator
    slot = np.asarray(belief.transform_ground_to_map.translation)[:2]
    begin = slot + [2.5 if far else 1.2, 0.0]
    navigator.odometry._pose = RigidTransform.from_translation([*begin, 0.1])  # pyright: ignore
    navigator.odometry._at = navigator.odometry._pasts[-1]  # pyright: ignore
    goals = []

    def drive(seen, navigator, arm, goal):
        goals.append(goal()[0])
        return Driven(seen, True)
        yield

    monkeypatch.setattr(search, "drive", drive)
    monkeypatch.setattr(search, "faced", at_once)
    monkeypatch.setattr(search, "posed", at_once)
    monkeypatch.setattr(navigator, "take", lambda seen, at_rest: None)
    monkeypatch.setattr(navigator, "lengths_to", lambda p: np.linalg.norm(p - begin, axis=1))
    stage = SearchPanel(belief, radio_of(), True, np.random.default_rng(3))
    with pytest.raises(StopIteration):
        next(stage._come_near(seen_at(0.1)))
    assert len(goals) == far
    for goal in goals:
        assert np.linalg.norm(goal - slot) == pytest.approx(1.3, abs=1e-9)
        assert np.linalg.norm(goal - begin) == pytest.approx(1.2, abs=0.05)
