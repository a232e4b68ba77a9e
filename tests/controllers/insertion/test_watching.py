"""The master's camera goes where MuJoCo's rays reach all markers; no better place is left out."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.watching import (
    Surroundings,
    above_its_foot,
    arm_spheres,
    best_angles,
    hides_itself,
    in_both_images,
    slants,
    target_field,
)
from controllers.kinematics.arm_inverse import standing_views
from controllers.placement.spatial.search import rate_positions
from experiments.ch5.insertion_scene import MASTER, best_station, transform
from tests.controllers.insertion.scenes import (
    ARM,
    EYES,
    PLAN,
    WIDTH,
    arm_at,
    fresh,
    true_parts,
)
from twin.camera import camera_model, camera_pose

DRAWN = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)
"""Groups of geoms that pictures show."""


def sees(model, data, points, body_left_out: int) -> bool:
    """Say whether rays from both eyes reach all points (N, 3), world, within both images."""
    for side in ("left", "right"):
        name = f"{MASTER}/stereo_{side}"
        camera = camera_model(model, name)
        rotation, eye = camera_pose(data, model.camera(name).id)
        local = (points - eye) @ rotation
        if np.any(local[:, 2] < 0.05):
            return False
        u, v = camera.pixels(local).T
        if np.any((u < 0) | (u > camera.width - 1) | (v < 0) | (v > camera.height - 1)):
            return False
        for point in points:
            way = np.linalg.norm(point - eye)
            hit = np.zeros(1, dtype=np.int32)
            direction = (point - eye) / way
            # The head's own hull holds the eye.
            far = mujoco.mj_ray(model, data, eye, direction, DRAWN, 1, body_left_out, hit)
            if far < way - 1e-3:
                return False
    return True


@pytest.fixture(scope="module")
def watched():
    """The scene, what is believed of it (the truth), and all markers in the world."""
    model, data = fresh()
    parts = true_parts(data)
    return model, data, parts, transform(data, f"{MASTER}/chassis").apply(parts.markers())


def visible(watched, angles) -> bool:
    model, data, _, markers = watched
    arm_at(model, data, MASTER, angles)
    return sees(model, data, markers, model.body(f"{MASTER}/stereo_head").id)


def test_chosen_camera_sees_all_four_markers_in_both_images(watched):
    parts = watched[2]
    now = best_station(WIDTH).angles
    choice = best_angles(PLAN, parts, ARM, EYES, now)
    assert choice.rating > 0.0
    assert visible(watched, choice.angles)


def test_no_candidate_that_rays_reach_rates_much_higher(watched):
    """Every pose of the arm that is tried, by MuJoCo's rays and the rating of eq. 4-1."""
    parts, plan, arm = watched[2], PLAN, ARM
    field = target_field(plan, parts)
    choice = best_angles(plan, parts, arm, EYES, best_station(WIDTH).angles)
    views = standing_views(arm, field.target.position, plan.distances, plan.pitches)
    assert len(views.angles) > 50
    places = arm.tool_in_robot(views.angles).translation
    ratings = np.array([v.rating for v in rate_positions(field, plan.lens, places, None)])
    truly = np.array([visible(watched, angles) for angles in views.angles])
    assert truly.any()
    best = max(ratings[truly].max(), choice.rating_now)
    assert choice.rating >= 0.93 * best
    # What is counted as seen and not hidden is so.
    cameras = arm.tool_in_robot(views.angles)
    counted = in_both_images(cameras, parts.markers(), EYES, plan.border)
    assert np.all(truly[counted & (ratings > 0.0)])


def test_markers_in_both_images_are_those_that_mujocos_cameras_project_there(watched):
    model, data, parts, markers = watched
    rng, arm = np.random.default_rng(0), ARM
    now = best_station(WIDTH).angles
    best = best_angles(PLAN, parts, arm, EYES, now).angles
    angles = best + rng.normal(0.0, 0.03, (60, 4))
    found = in_both_images(arm.tool_in_robot(angles), parts.markers(), EYES, 0.0)
    inside = []
    for row in angles:
        arm_at(model, data, MASTER, row)
        fits = True
        for side in ("left", "right"):
            camera = camera_model(model, f"{MASTER}/stereo_{side}")
            rotation, eye = camera_pose(data, model.camera(f"{MASTER}/stereo_{side}").id)
            u, v = camera.pixels((markers - eye) @ rotation).T
            fits &= bool(np.all((u > 0) & (u < camera.width - 1)))
            fits &= bool(np.all((v > 0) & (v < camera.height - 1)))
        inside.append(fits)
    assert 0.1 < np.mean(inside) < 0.9
    np.testing.assert_array_equal(found, inside)


def test_card_alone_is_watched_where_both_cannot_be():
    _, data = fresh()
    parts = true_parts(data)
    far = RigidTransform.from_translation([0.0, 0.0, 1.5]) * parts.slot_pose
    apart = dataclasses.replace(parts, slot_pose=far)
    now, arm = best_station(WIDTH).angles, ARM
    choice = best_angles(PLAN, apart, arm, EYES, now)
    assert choice.rating > 0.0
    camera = arm.tool_in_robot(choice.angles[None])
    card = parts.card_pose.apply(parts.card.points)
    assert not choice.whole and in_both_images(camera, card, EYES, 10.0)[0]
    assert not in_both_images(camera, apart.markers(), EYES, 0.0)[0]


def test_markers_that_were_not_seen_stay_in_view_of_an_arm_that_is_20_mrad_off(watched):
    parts, now = watched[2], best_station(WIDTH).angles
    choice = best_angles(PLAN, parts, ARM, EYES, now, sure=False)
    assert choice.whole and choice.rating > 0.0
    camera = ARM.tool_in_robot(choice.angles[None])
    for off in 0.02 * np.vstack([np.eye(3), -np.eye(3)]):
        turned = camera * RigidTransform.from_rotation(Rotation.from_rotvec(off))
        assert in_both_images(turned, parts.markers(), EYES, PLAN.border)[0]


def test_no_joint_goes_farther_than_asked(watched):
    parts = watched[2]
    best = best_angles(PLAN, parts, ARM, EYES, best_station(WIDTH).angles).angles
    now = best + [0.2, 0.1, 0.0, 0.0]
    near = best_angles(PLAN, parts, ARM, EYES, now, farthest=0.25)
    assert near.rating > 0.0 and 0.0 < np.abs(near.angles - now).max() <= 0.25
    np.testing.assert_array_equal(
        best_angles(PLAN, parts, ARM, EYES, now, farthest=0.0).angles, now
    )


def test_nothing_in_reach_rates_nothing_and_moves_nothing():
    _, data = fresh()
    parts = true_parts(data)
    away = RigidTransform.from_translation([0.0, 9.0, 0.0])
    gone = dataclasses.replace(
        parts, card_pose=away * parts.card_pose, slot_pose=away * parts.slot_pose
    )
    now = best_station(WIDTH).angles
    choice = best_angles(PLAN, gone, ARM, EYES, now)
    assert choice.rating == 0.0 and choice.rating_now == 0.0
    np.testing.assert_array_equal(choice.angles, now)


def test_among_equally_good_views_the_arm_chooses_the_nearest(watched):
    choice = best_angles(PLAN, watched[2], ARM, EYES, best_station(WIDTH).angles)
    again = best_angles(PLAN, watched[2], ARM, EYES, choice.angles)
    np.testing.assert_array_equal(again.angles, choice.angles)
    assert again.rating == pytest.approx(again.rating_now)


def test_arm_above_its_foot_touches_neither_ground_nor_deck_nor_wheels():
    model, data = fresh()
    arm, rng = ARM, np.random.default_rng(3)
    angles = rng.uniform(*arm.limits.T, size=(300, 4))
    names = [model.body(index).name for index in range(model.nbody)]
    links = {names.index(f"{MASTER}/{name}") for name in ("forearm", "wrist", "stereo_head")}
    parts = ("chassis", "rear_chassis", "front_left_wheel", "front_right_wheel")
    below = {0} | {names.index(f"{MASTER}/{name}") for name in parts}
    touches = np.zeros(len(angles), dtype=bool)
    for number, posture in enumerate(angles):
        arm_at(model, data, MASTER, posture)
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            pair = {int(model.geom_bodyid[geom]) for geom in contact.geom}
            touches[number] |= bool(pair & links and pair & below)
    above = above_its_foot(arm, angles)
    assert 0.1 < above.mean() < 0.9 and touches.sum() > 20
    assert not np.any(touches & above)
    assert above_its_foot(arm, np.zeros((0, 4))).shape == (0,)


def sides_of_post(x: float, y: float, top: float) -> np.ndarray:
    """Return points (N, 3) on the sides of an upright post 8 cm wide, robot frame."""
    across, up = np.arange(-0.04, 0.041, 0.01), np.arange(-0.1, top, 0.01)
    faces = [(a, s) for a in across for s in (-0.04, 0.04)]
    return np.array([
        (x + dx, y + dy, z) for dx, dy in [*faces, *((s, a) for a, s in faces)] for z in up
    ])  # fmt: skip


def test_a_view_keeps_off_what_is_mapped_and_sees_past_it(watched):
    """A post where the head is in the best view, and one between that view and the markers."""
    parts, now = watched[2], best_station(WIDTH).angles
    best = best_angles(PLAN, parts, ARM, EYES, now)
    eye = ARM.tool_in_robot(best.angles).translation
    markers = parts.markers()
    for share in (0.1, 0.6):
        x, y, top = eye + share * (markers.mean(axis=0) - eye)
        post = sides_of_post(x, y, top + 0.05)
        choice = best_angles(PLAN, parts, ARM, EYES, now, about=Surroundings.of(post))
        if choice.rating == 0.0:
            np.testing.assert_array_equal(choice.angles, now)
            continue
        assert choice.rating < best.rating
        spheres = arm_spheres(ARM, EYES.baseline, choice.angles[None])[0]
        apart = np.linalg.norm(spheres[:, None, :3] - post, axis=2) - spheres[:, 3:]
        assert apart.min() > 0.03
        camera = ARM.tool_in_robot(choice.angles)
        for eye_place in camera.apply([[0.0, 0.0, 0.0], [EYES.baseline, 0.0, 0.0]]):
            for marker in markers:
                way = eye_place + np.linspace(0.0, 1.0, 200)[:, None] * (marker - eye_place)
                assert np.linalg.norm(way[:, None] - post, axis=2).min() > 0.003
    # What stands beside the view alone is kept off as well, and hides nothing.
    post = sides_of_post(*eye)
    choice = best_angles(PLAN, parts, ARM, EYES, now, about=Surroundings.of(post, post[:0]))
    spheres = arm_spheres(ARM, EYES.baseline, choice.angles[None])[0]
    apart = np.linalg.norm(spheres[:, None, :3] - post, axis=2) - spheres[:, 3:]
    assert 0.0 < choice.rating < best.rating and apart.min() > 0.03
    # Nothing mapped changes nothing.
    empty = best_angles(PLAN, parts, ARM, EYES, now, about=Surroundings.of(np.zeros((0, 3))))
    np.testing.assert_array_equal(empty.angles, best.angles)


def test_arm_spheres_hold_the_eyes_and_the_links(watched):
    angles = np.array([best_station(WIDTH).angles, [0.3, 1.2, -0.5, -1.0]])
    spheres = arm_spheres(ARM, EYES.baseline, angles)
    for row, held in zip(angles, spheres):
        camera = ARM.tool_in_robot(row)
        for point in (*ARM.cover_points(row[None])[0], camera.translation,
                      camera.apply([EYES.baseline, 0.0, 0.0])):  # fmt: skip
            assert np.any(np.linalg.norm(held[:, :3] - point, axis=1) < 1e-9)


def test_postures_whose_arm_hides_a_marker_are_those_that_rays_find(watched):
    """Postures of the whole joint space that have all markers in both images, by MuJoCo's rays."""
    model, data, parts, markers = watched
    rng = np.random.default_rng(4)
    low, high = ARM.limits.T
    target = parts.markers().mean(axis=0)
    angles = rng.uniform(low, high, (60000, 4))
    angles[:, 0] = math.atan2(-target[0], target[1] - ARM.transform_base_to_robot.translation[1])
    cameras = ARM.tool_in_robot(angles)
    angles = angles[in_both_images(cameras, parts.markers(), EYES, 0.0)]
    angles = angles[above_its_foot(ARM, angles)][:150]
    assert len(angles) > 40
    own = [
        model.geom(i).id
        for i in range(model.ngeom)
        if model.body(model.geom_bodyid[i]).name
        in (f"{MASTER}/{link}" for link in ("upper_arm", "forearm"))
    ]
    found, truly = hides_itself(ARM, EYES.baseline, angles, parts.markers()), []
    for row in angles:
        arm_at(model, data, MASTER, row)
        truly.append(any(_ray_meets(model, data, own, side, markers) for side in ("left", "right")))
    truly = np.array(truly)
    assert truly.sum() > 5
    # Links are held by spheres, so that some more count as hidden; none that is hidden does not.
    assert np.all(found[truly])
    assert np.mean(found & ~truly) < 0.25


def _ray_meets(model, data, geoms, side, markers) -> bool:
    """Whether a ray from an eye to a marker meets one of geoms."""
    _, eye = camera_pose(data, model.camera(f"{MASTER}/stereo_{side}").id)
    for marker in markers:
        way = np.linalg.norm(marker - eye)
        for geom in geoms:
            hit = np.zeros(1, dtype=np.int32)
            at, direction = eye.copy(), (marker - eye) / way
            gone = 0.0
            for _ in range(8):
                step = mujoco.mj_ray(model, data, at, direction, None, 1, -1, hit)
                if step < 0.0 or gone + step > way:
                    break
                if hit[0] == geom:
                    return True
                gone += step + 1e-4
                at = eye + gone * direction
    return False


def test_slants_are_those_of_the_steepest_face():
    up, side = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    points, eyes = np.zeros((2, 3)), np.array([[3.0, 0.0, 4.0], [4.0, 0.0, 3.0], [0.0, 0.0, 1.0]])
    found = slants(eyes, points, np.stack([up, side]))
    np.testing.assert_allclose(found, np.arccos([0.6, 0.6, 0.0]))
    np.testing.assert_allclose(slants(eyes, points[:1], up[None]), np.arccos([0.8, 0.6, 1.0]))


def test_no_view_is_chosen_in_which_detectors_take_no_marker(watched):
    """Of a slot that is turned away, the best view is less steep, or there is none."""
    parts, now = watched[2], best_station(WIDTH).angles
    for turn in np.radians([0.0, 30.0, 45.0, 60.0, 80.0]):
        turned = RigidTransform.from_rotation(Rotation.from_euler("x", turn))
        posed = dataclasses.replace(parts, slot_pose=parts.slot_pose * turned)
        choice = best_angles(PLAN, posed, ARM, EYES, now)
        if choice.rating == 0.0 or not choice.whole:
            assert turn > 0.5
            continue
        camera = ARM.tool_in_robot(choice.angles)
        eyes = camera.apply([[0.0, 0.0, 0.0], [EYES.baseline, 0.0, 0.0]])
        assert slants(eyes, posed.markers(), posed.normals()).max() < np.radians(62.0)
