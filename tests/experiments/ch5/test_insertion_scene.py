"""The scene of the insertion is that of the thesis, and cameras are placed as configured."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from controllers.insertion.camera_station import (
    FARTHEST,
    GAP,
    NEAREST,
    STEEPEST,
    base_placement,
    is_clear,
    random_camera_station,
)
from controllers.insertion.card_arm import CARD_IN_WRIST
from controllers.insertion.marker_guide import MarkerGuide, MarkerGuideConfig
from controllers.insertion.watching import in_both_images
from experiments.ch5.insertion_scene import (
    MASTER,
    SLAVE,
    InsertionScene,
    begin_with_camera_at,
    best_station,
    card_in_slot,
    compile_insertion,
    contact_force,
    insertion_drawing,
    is_seated,
    transform,
)
from models.card_and_slot.stand import CARD_AXES, SLOT_HEIGHT, TIP
from models.compose import ARM_JOINTS, FLAT, RobotPlacement, make_model, settle
from models.datasheets import CARD_AND_SLOT, ROVER
from tests.controllers.insertion.scenes import (
    ARM,
    DRAWING,
    EYES,
    MASTER_ROVER,
    PLAN,
    START,
    WIDTH,
    arm_at,
    fresh,
    true_parts,
)
from twin.camera import camera_model, camera_pose

WIDTHS = CARD_AND_SLOT.slot_widths


@pytest.fixture
def placed():
    """Card and slot with their frames made one."""
    model, data = fresh()
    return model, data


def test_slot_is_upright_and_the_card_is_inserted_forward(placed):
    model, data = placed
    slot = transform(data, "slot")
    np.testing.assert_allclose(slot.translation, [0.0, 0.0, SLOT_HEIGHT], atol=1e-9)
    # Across is down, ahead is world's y, the faces look along x to the master.
    np.testing.assert_allclose(slot.rotation.as_matrix(), CARD_AXES, atol=1e-9)
    np.testing.assert_allclose(slot.rotation.apply([0.0, 0.0, 1.0]), [1.0, 0.0, 0.0], atol=1e-9)
    assert data.body(f"{MASTER}/chassis").xpos[0] > 0.5
    assert np.linalg.det(CARD_AXES) == pytest.approx(1.0)


def test_card_pose_at_the_wrist_agrees_with_the_slaves_model(placed):
    model, data = placed
    relative = transform(data, f"{SLAVE}/wrist").inv() * transform(data, f"{SLAVE}/card")
    np.testing.assert_allclose(relative.translation, [0.0, TIP, 0.0], atol=1e-9)
    np.testing.assert_allclose(relative.rotation.as_matrix(), CARD_IN_WRIST, atol=1e-9)
    np.testing.assert_array_equal(CARD_IN_WRIST, CARD_AXES)


def test_only_the_master_has_cameras(placed):
    model, _ = placed
    names = {model.camera(index).name for index in range(model.ncam)}
    assert {f"{MASTER}/stereo_left", f"{MASTER}/stereo_right"} <= names
    assert not any(name.startswith(SLAVE) for name in names)


def test_true_pose_of_a_card_in_the_slot(placed):
    model, data = placed
    pose = card_in_slot(data)
    # The slave is about 0.62 m before the mouth, its card as far ahead as the arm reaches.
    wrist = data.body(f"{SLAVE}/wrist").xpos
    tip = wrist + data.body(f"{SLAVE}/card").xmat.reshape(3, 3)[:, 1] * TIP
    np.testing.assert_allclose(pose[:3], [SLOT_HEIGHT - tip[2], tip[1], tip[0]], atol=1e-9)
    # Across is down: the slave's yaw to the left is a turn against it.
    assert pose[4] == pytest.approx(-START[2], abs=5e-3)


@pytest.mark.parametrize(
    ("index", "off", "seated"),
    [
        (0, 0.95e-3, True), (0, -1.05e-3, False),
        (1, -0.9e-3, True), (1, -1.1e-3, False),
        (2, 0.9e-3, True), (2, 1.1e-3, False),
        (3, 0.017, True), (3, 0.018, False),
        (4, -0.043, True), (4, -0.044, False),
        (5, 0.017, True), (5, -0.018, False),
    ],
)  # fmt: skip
def test_a_seated_card_lacks_neither_depth_nor_offset_nor_angle(index, off, seated):
    card = np.array([0.0, 0.04, 0.0, 0.0, 0.0, 0.0])
    card[index] += off
    assert is_seated(card, CARD_AND_SLOT.card_width + 1.6e-3) == seated


@pytest.mark.parametrize(
    ("width", "guides"), [(WIDTH, False), (CARD_AND_SLOT.card_width + 1.6e-3, True)]
)
def test_force_on_the_card_is_that_of_its_contacts(width, guides):
    field = dataclasses.replace(FLAT, texture_pixels=16, slope=(0.2, -0.15))
    scene = InsertionScene(width, START, best_station(width).place, field, guides)
    model = compile_insertion(scene)
    data = settle(model, 1.0)
    assert not contact_force(data).any()
    card = data.body(f"{SLAVE}/card")
    model.body("slot").pos[:] = card.xpos - [0.0, 5e-4, 5e-3]  # An edge is in a wall.
    mujoco.mj_forward(model, data)
    total, wrench = np.zeros(3), np.zeros(6)
    plate = model.geom(f"{SLAVE}/card_plate").id
    for index, contact in enumerate(data.contact):
        if plate in contact.geom:
            mujoco.mj_contactForce(model, data, index, wrench)
            sign = 1.0 if contact.geom[1] == plate else -1.0
            total += sign * contact.frame.reshape(3, 3).T @ wrench[:3]
    assert np.linalg.norm(total) > 1.0
    np.testing.assert_allclose(card.xmat.reshape(3, 3) @ contact_force(data), total, atol=1e-9)


def test_masters_camera_starts_at_the_best_view_of_the_visibility_map():
    station = best_station(WIDTH)
    model = compile_insertion(InsertionScene(WIDTH, START, station.place, FLAT))
    before = settle(model, 0.2)
    parts = true_parts(before)
    config = MarkerGuideConfig(parts.card, parts.slot, CARD_AND_SLOT.marker_diameter, PLAN)
    slot = parts.slot_pose, 1e-6 * np.eye(6)
    arm, head = ARM, EYES
    marker_guide = MarkerGuide(config, arm, head, slot, parts.card_pose, station.angles)
    angles = marker_guide.begin()
    camera = arm.tool_in_robot(angles[None])
    assert in_both_images(camera, parts.card_pose.apply(parts.card.points), head, 5.0)[0]
    begin_with_camera_at(model, angles)
    after = settle(model, 0.2)
    for name, angle in zip(ARM_JOINTS, angles, strict=True):
        assert after.joint(f"{MASTER}/{name}_joint").qpos[0] == pytest.approx(angle, abs=0.03)
        slave = f"{SLAVE}/{name}_joint"
        assert after.joint(slave).qpos[0] == pytest.approx(before.joint(slave).qpos[0], abs=1e-6)


@pytest.mark.parametrize("width", [0.0, -0.1, math.nan])
def test_impossible_slot_is_refused(width):
    scene = InsertionScene(width, START, (1.0, 0.0, 1.5), FLAT)
    with pytest.raises(ValueError, match="width"):
        compile_insertion(scene)


@pytest.mark.parametrize("width", WIDTHS)
def test_best_station_puts_all_markers_in_both_images(width):
    station = best_station(width)
    assert is_clear(station) and station.distance >= NEAREST
    model = make_model(FLAT, [RobotPlacement(MASTER, station.place[:2], station.place[2])])
    data = mujoco.MjData(model)
    arm_at(model, data, MASTER, station.angles)
    for side in ("left", "right"):
        name = f"{MASTER}/stereo_{side}"
        camera = camera_model(model, name)
        rotation, eye = camera_pose(data, model.camera(name).id)
        # The level scene's ground is that of the model: the chassis is at its height.
        eye = eye + [0.0, 0.0, ROVER.centre_height - data.body(f"{MASTER}/chassis").xpos[2]]
        local = (insertion_drawing(width).parts(GAP).markers() - eye) @ rotation
        u, v = camera.pixels(local).T
        assert np.all(local[:, 2] > 0.0)
        assert np.all((u > 5) & (u < camera.width - 6) & (v > 5) & (v < camera.height - 6))


def test_random_stations_are_reproducible_and_within_bounds():
    arm, rng = ARM, np.random.default_rng(5)
    markers = DRAWING.parts(GAP).markers()
    target = 0.5 * (markers.max(axis=0) + markers.min(axis=0))
    distances, slants = [], []
    for _ in range(10):
        station = random_camera_station(MASTER_ROVER, DRAWING, rng)
        assert is_clear(station)
        limits = arm.limits
        assert np.all((station.angles >= limits[:, 0]) & (station.angles <= limits[:, 1]))
        assert NEAREST <= station.distance <= FARTHEST and 0.0 <= station.slant <= STEEPEST + 1e-9
        # Where the camera truly is, by the arm on the place.
        camera = arm.tool_in_robot(station.angles)
        x, y, yaw = station.place
        c, s = math.cos(yaw), math.sin(yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        place = turn @ camera.translation + [x, y, ROVER.centre_height]
        assert np.linalg.norm(place - target) == pytest.approx(station.distance, abs=1e-6)
        aim = turn @ camera.rotation.apply([0.0, 0.0, 1.0])
        away = (target - place) / station.distance
        assert math.acos(min(aim @ away, 1.0)) < math.radians(25.0)
        distances.append(station.distance)
        slants.append(station.slant)
    assert np.ptp(distances) > 0.3 and np.ptp(slants) > 0.4
    first = random_camera_station(MASTER_ROVER, DRAWING, np.random.default_rng(7))
    again = random_camera_station(MASTER_ROVER, DRAWING, np.random.default_rng(7))
    assert first.place == again.place
    np.testing.assert_array_equal(first.angles, again.angles)


def test_place_that_the_arm_cannot_take_is_none():
    target = np.array([0.0, 0.0, 0.3])
    too_steep, too_high, good = (
        base_placement(np.array(camera), target, ARM, ROVER.centre_height)
        for camera in ([0.01, 0.0, 0.8], [0.6, 0.0, 2.0], [0.6, 0.0, 0.35])
    )
    assert too_steep is None and too_high is None and good is not None
