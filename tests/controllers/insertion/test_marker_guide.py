"""Poses measured in rendered pairs are true within their covariance, or reported as missing."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion import marker_guide
from controllers.insertion.marker_guide import MarkerGuide, MarkerGuideConfig
from controllers.insertion.watching import best_angles, in_both_images
from experiments.ch5.insertion_scene import MASTER, SLAVE, best_station
from tests.controllers.insertion.scenes import (
    ARM,
    DRAWING,
    EYES,
    PLAN,
    WIDTH,
    arm_at,
    fresh,
    true_parts,
)
from twin.camera import StereoConfig, StereoRig
from twin.optics.realism import DEFAULT_CAMERA
from twin.robot import MISSING, ArmMode, Channel, Observation, Validity, WheelMode

PRIOR = np.diag([4.5e-3**2] * 3 + [1.7e-3**2] * 3)
ROUGH = RigidTransform.from_exp_coords([0.02, -0.01, 0.02, 0.004, -0.003, 0.004])
"""By how much the card is not where it was believed to be."""


class Eyes:
    """The master's camera on a scene whose state is set."""

    def __init__(self, seed: int = 0):
        self.model, self.data = fresh()
        self.rng = np.random.default_rng(seed)
        self.rig = StereoRig(self.model, f"{MASTER}/", StereoConfig())
        self.angles = best_station(WIDTH).angles

    def place(self, offset) -> None:
        """Move the slave, and the camera to where it sees both parts best."""
        joint = self.model.body(f"{SLAVE}/chassis").jntadr[0]
        address = self.model.jnt_qposadr[joint]
        self.data.qpos[address : address + 2] += offset[:2]
        mujoco.mj_forward(self.model, self.data)
        parts = true_parts(self.data)
        choice = best_angles(PLAN, parts, ARM, EYES, self.angles)
        self.angles = choice.angles
        arm_at(self.model, self.data, MASTER, self.angles)
        mujoco.mj_forward(self.model, self.data)

    def marker_guide(self, prior_error=True) -> MarkerGuide:
        parts = true_parts(self.data)
        error = self.rng.multivariate_normal(np.zeros(6), PRIOR) if prior_error else np.zeros(6)
        slot = RigidTransform.from_exp_coords(error).inv() * parts.slot_pose
        config = MarkerGuideConfig(DRAWING.card, DRAWING.slot, DRAWING.marker_diameter, None)
        card = ROUGH * parts.card_pose
        return MarkerGuide(config, ARM, EYES, (slot, PRIOR), card, self.angles)

    def observe(self, stamp: float = 0.0, pair=None) -> Observation:
        image = self.rig.capture(self.data, (self.rng, self.rng)) if pair is None else pair
        return Observation(
            stamp,
            arm_angles=Channel(np.array(self.angles), stamp, Validity.MEASURED),
            stereo=Channel(image, stamp, Validity.MEASURED),
        )

    def hide(self, body: str) -> None:
        """Take the paint off a body's markers."""
        for index in range(2):
            self.model.geom(f"{body}_marker{index}").rgba[3] = 0.0


@pytest.fixture
def eyes():
    made = Eyes()
    paint = made.model.geom_rgba.copy()
    yield made
    made.model.geom_rgba[:] = paint


def square(eyes: Eyes, guidance) -> float:
    """Squared error of the measured pose, whitened by its covariance."""
    parts = true_parts(eyes.data)
    true = parts.card_pose.inv() * parts.slot_pose
    error = (true * guidance.transform_slot_to_card.inv()).as_exp_coords()
    return float(error @ np.linalg.solve(guidance.covariance, error))


def test_reported_pose_is_consistent_with_its_covariance(eyes):
    squares, places = [], []
    offsets = [(0.0, 0.0), (0.006, 0.03), (-0.014, 0.03), (0.008, 0.03), (0.006, 0.02),
               (-0.01, 0.01), (0.004, -0.16), (0.0, -0.05)]  # fmt: skip
    for offset in offsets:
        eyes.place(offset)
        command, guidance = eyes.marker_guide().step(eyes.observe())
        assert guidance is not None and guidance.card_seen and guidance.slot_seen
        squares.append(square(eyes, guidance))
        parts = true_parts(eyes.data)
        true = parts.card_pose.inv() * parts.slot_pose
        measured = guidance.transform_slot_to_card
        places.append(np.abs(measured.inv().translation - true.inv().translation)[:2].max())
    # The mean of eight squares of six degrees of freedom has a deviation of 1.2.
    assert 1.5 < np.mean(squares) < 11.0
    assert np.median(places) < 1e-3


def test_hidden_slot_is_where_the_map_has_it_with_the_maps_covariance(eyes):
    eyes.place((0.0, 0.0))
    eyes.hide("slot")
    marker_guide = eyes.marker_guide()
    _, guidance = marker_guide.step(eyes.observe())
    assert guidance is not None and guidance.card_seen and not guidance.slot_seen
    assert square(eyes, guidance) < 16.8  # 1 % of six degrees of freedom
    seen = eyes.marker_guide()
    np.testing.assert_array_equal(marker_guide.slot_covariance, PRIOR)
    eyes.model.geom("slot_marker0").rgba[3] = eyes.model.geom("slot_marker1").rgba[3] = 1.0
    _, whole = seen.step(eyes.observe())
    assert whole is not None and whole.slot_seen
    assert np.linalg.det(whole.covariance) < 1e-3 * np.linalg.det(guidance.covariance)


def test_slot_once_seen_is_remembered_when_it_is_hidden(eyes):
    eyes.place((0.0, 0.0))
    marker_guide = eyes.marker_guide()
    marker_guide.step(eyes.observe())
    eyes.hide("slot")
    _, guidance = marker_guide.step(eyes.observe(0.25))
    assert guidance is not None and not guidance.slot_seen
    assert square(eyes, guidance) < 16.8
    assert guidance.covariance[3:, 3:].trace() < PRIOR[3:, 3:].trace()


def test_hidden_card_gives_no_pose(eyes):
    eyes.place((0.0, 0.0))
    eyes.hide(f"{SLAVE}/card")
    _, guidance = eyes.marker_guide().step(eyes.observe())
    assert guidance is not None and guidance.slot_seen and not guidance.card_seen
    assert guidance.transform_slot_to_card is None


def test_card_alone_is_followed_by_short_ways_once_it_nears_the_edge(eyes):
    eyes.place((0.0, 0.0))
    eyes.hide("slot")
    guide = eyes.marker_guide(prior_error=False)
    guide.config = dataclasses.replace(guide.config, plan=PLAN)
    guide.transform_slot_to_robot = (
        RigidTransform.from_translation([0.0, 0.0, 1.5]) * guide.transform_slot_to_robot
    )
    guide.step(eyes.observe())
    guide._place(sure=False)
    settled = guide._goal
    guide._place(sure=False)
    np.testing.assert_array_equal(guide._goal, settled)
    camera, aside = ARM.tool_in_robot(settled[None]), guide.transform_card_to_robot
    while in_both_images(camera, aside.apply(DRAWING.card.points), EYES, 40.0)[0]:
        step = camera[0].rotation.apply([0.005, 0.0, 0.0])
        aside = RigidTransform.from_translation(step) * aside
    guide.transform_card_to_robot = aside
    guide._place(sure=False)
    assert 0.0 < np.abs(guide._goal - settled).max() <= guide.config.aside
    followed = ARM.tool_in_robot(guide._goal[None])
    assert in_both_images(followed, aside.apply(DRAWING.card.points), EYES, 45.0)[0]


@pytest.mark.parametrize("kind", ["black", "white", "noise"])
def test_pair_that_shows_nothing_gives_no_pose(eyes, kind):
    shape = eyes.rig.capture(eyes.data, (eyes.rng, eyes.rng)).shape
    rng = np.random.default_rng(1)
    pair = {
        "black": np.zeros(shape, np.uint8),
        "white": np.full(shape, 255, np.uint8),
        "noise": rng.integers(0, 256, shape, dtype=np.uint8),
    }[kind]
    marker_guide = eyes.marker_guide()
    before = marker_guide.transform_slot_to_robot.as_matrix()
    _, guidance = marker_guide.step(eyes.observe(pair=pair))
    assert guidance is not None and guidance.transform_slot_to_card is None
    assert not guidance.card_seen and not guidance.slot_seen
    np.testing.assert_array_equal(marker_guide.transform_slot_to_robot.as_matrix(), before)


def test_frozen_camera_gives_no_pose_though_its_stamps_go_on(eyes):
    eyes.place((0.0, 0.0))
    marker_guide = eyes.marker_guide()
    pair = eyes.rig.capture(eyes.data, (eyes.rng, eyes.rng))
    _, first = marker_guide.step(eyes.observe(0.0, pair))
    _, frozen = marker_guide.step(eyes.observe(0.25, pair.copy()))
    _, alive = marker_guide.step(eyes.observe(0.5))
    assert [g.card_seen for g in (first, frozen, alive)] == [True, False, True]
    assert frozen.transform_slot_to_card is None


def test_each_stereo_pair_gives_one_message_and_a_missing_pair_none(eyes):
    marker_guide = eyes.marker_guide()
    seen = eyes.observe(0.0, np.zeros((2, 492, 510), np.uint8))
    assert marker_guide.step(seen)[1] is not None
    assert marker_guide.step(seen)[1] is None
    assert marker_guide.step(seen._replace(stereo=MISSING))[1] is None


def test_camera_stays_without_a_plan_and_nothing_moves_without_joint_angles(eyes):
    marker_guide = eyes.marker_guide()
    seen = eyes.observe(0.0, np.zeros((2, 492, 510), np.uint8))
    command, _ = marker_guide.step(seen)
    np.testing.assert_array_equal(command.arm, eyes.angles)
    np.testing.assert_array_equal(command.wheels, 0.0)
    assert command.arm_mode is ArmMode.POSITION and command.wheel_mode is WheelMode.SPEED
    command, guidance = marker_guide.step(seen._replace(arm_angles=MISSING))
    assert guidance is None and command.arm_mode is ArmMode.DUTY
    np.testing.assert_array_equal([*command.arm, *command.wheels], 0.0)


def test_camera_moves_to_its_goal_no_faster_than_the_rate_limit(eyes):
    eyes.place((0.0, 0.0))
    goal = eyes.angles + [0.3, -0.1, 0.2, 0.05]
    made = eyes.marker_guide()
    marker_guide = MarkerGuide(
        dataclasses.replace(made.config, rate=0.5), ARM, EYES,
        (made.transform_slot_to_robot, PRIOR), made.transform_card_to_robot, goal,
    )  # fmt: skip
    # Before anything is seen it stays.
    blind = eyes.observe(-1.0, np.zeros((2, 492, 510), np.uint8))
    for _ in range(3):
        np.testing.assert_array_equal(marker_guide.step(blind)[0].arm, eyes.angles)
    seen = eyes.observe()
    commands = [marker_guide.step(seen)[0] for _ in range(70)]
    wanted = [command.arm for command in commands]
    rates = [command.arm_rates for command in commands[1:]]
    np.testing.assert_allclose(rates, np.diff(wanted, axis=0) / 0.01, atol=1e-9)
    np.testing.assert_allclose(wanted[-1], goal)
    steps = np.abs(np.diff(wanted, axis=0))
    assert steps.max() < 0.5 * 0.01 + 1e-12
    # All joints arrive at once, after 0.3 rad at 0.5 rad/s.
    assert np.ptp(np.argmax(np.isclose(wanted, goal), axis=0)) <= 1


def test_of_a_card_that_no_view_shows_the_first_one_shows_the_slot_and_where_it_will_come(eyes):
    made = eyes.marker_guide(prior_error=False)
    slot, start = made.transform_slot_to_robot, eyes.angles + [0.6, 0.0, 0.0, 0.0]
    away = RigidTransform.from_rotation(Rotation.from_euler("x", np.pi))
    config = dataclasses.replace(made.config, plan=PLAN)
    for card in (made.transform_card_to_robot, made.transform_card_to_robot * away):
        goal = MarkerGuide(config, ARM, EYES, (slot, PRIOR), card, start).begin()
        aligned = slot * RigidTransform.from_translation([0.0, -0.2, 0.0])
        parts = dataclasses.replace(true_parts(eyes.data), card_pose=aligned, slot_pose=slot)
        camera = ARM.tool_in_robot(goal[None])
        assert in_both_images(camera, parts.markers(), EYES, PLAN.border).all()
        assert np.abs(goal - start).max() > 0.1


@pytest.mark.parametrize("rating, moves", [(1.1, 0), (1.2, 1)])
def test_camera_leaves_its_place_only_for_one_that_is_clearly_better(
    eyes, monkeypatch, rating, moves
):
    """A seventh or more: where markers are seen nearly as well nothing is worth a move."""
    eyes.place((0.0, 0.0))
    made = eyes.marker_guide()
    config = dataclasses.replace(made.config, plan=PLAN)
    slot, card = made.transform_slot_to_robot, made.transform_card_to_robot
    guide = MarkerGuide(config, ARM, EYES, (slot, PRIOR), card, eyes.angles)
    goal = eyes.angles + [0.1, 0.0, 0.0, 0.0]
    found = dataclasses.replace(
        best_angles(PLAN, true_parts(eyes.data), ARM, EYES, eyes.angles),
        angles=goal, rating=rating * 4.0, rating_now=4.0,
    )  # fmt: skip
    monkeypatch.setattr(marker_guide, "best_angles", lambda *_: found)
    guide.step(eyes.observe(0.0))
    for tick in range(3):
        command, _ = guide.step(eyes.observe(2.0 + tick))
    # It chooses at most once a second, here in each of four steps.
    assert guide.moves == 4 * moves
    assert np.any(command.arm != eyes.angles) == bool(moves)
    assert np.abs(command.arm_rates).max() <= config.rate + 1e-9


def guide_of_prior(eyes, prior=PRIOR, **changes) -> MarkerGuide:
    """A guide whose prior of the slot is the truth."""
    made = eyes.marker_guide(prior_error=False)
    slot, card = made.transform_slot_to_robot, made.transform_card_to_robot
    config = dataclasses.replace(made.config, **changes)
    return MarkerGuide(config, ARM, EYES, (slot, prior), card, eyes.angles)


def guidance_of_late_pair(eyes, guide, late):
    """Return what a guide whose arm turns says of the start's pair, which arrives late [s]."""
    seen, begun = eyes.observe(0.0), np.array(eyes.angles)
    for tick in range(round(late / 0.01) + 1):
        time = 0.01 * tick
        angles = begun + np.array([0.125 / max(late, 0.01), 0.0, 0.0, 0.0]) * time
        stereo = seen.stereo if time >= late - 1e-9 else MISSING
        turned = Channel(angles, time, Validity.MEASURED)
        _, guidance = guide.step(Observation(time, arm_angles=turned, stereo=stereo))
        assert (guidance is None) == (stereo is MISSING)
    return guidance


@pytest.mark.parametrize("late", [0.0, 0.25, 1.15, 2.9])
def test_pair_that_is_late_belongs_to_the_joint_angles_of_its_stamp(eyes, late):
    """The arm turns by 125 mrad; the pair is of before, when the slot was seen."""
    eyes.place((0.0, 0.0))
    guide, true = guide_of_prior(eyes), true_parts(eyes.data)
    guidance = guidance_of_late_pair(eyes, guide, late)
    assert guidance.card_seen and guidance.slot_seen
    # A mispaired camera would put the slot 125 mrad times half a metre aside.
    for found, wanted in (
        (guide.transform_slot_to_robot, true.slot_pose),
        (guide.transform_card_to_robot, true.card_pose),
    ):
        assert np.linalg.norm(found.translation - wanted.translation) < 4e-3


def test_pair_older_than_the_joint_angles_gives_no_pose(eyes):
    eyes.place((0.0, 0.0))
    guide = guide_of_prior(eyes, memory=0.5)
    before = guide.transform_slot_to_robot
    guidance = guidance_of_late_pair(eyes, guide, 0.52)
    assert (guidance.time, guidance.card_seen, guidance.slot_seen) == (0.0, False, False)
    assert guide.transform_slot_to_robot is before


def test_joint_angles_between_two_ticks_are_interpolated(eyes, monkeypatch):
    used = []
    real = marker_guide.find_bodies
    monkeypatch.setattr(marker_guide, "find_bodies", lambda *a: used.append(a) or real(*a))
    guide, pair = guide_of_prior(eyes), eyes.rig.capture(eyes.data, (eyes.rng, eyes.rng))
    begun, rate = np.array(eyes.angles), np.array([0.3, -0.2, 0.1, 0.0])
    for tick in range(4):
        time = 0.01 * tick
        last = tick == 3
        stereo = Channel(pair, 0.013, Validity.MEASURED) if last else MISSING
        angles = Channel(begun + rate * time, time, Validity.MEASURED)
        guide.step(Observation(time, arm_angles=angles, stereo=stereo))
    (_, _, _, _, _, (_, slot)) = used[0]
    camera = ARM.tool_in_robot(begun + rate * 0.013)
    expected = camera.inv() * true_parts(eyes.data).slot_pose
    np.testing.assert_allclose(
        slot.transform_body_to_camera.as_matrix(), expected.as_matrix(), atol=1e-9
    )


def test_images_of_markers_move_less_than_the_allowed_blur_while_the_camera_moves(eyes):
    """Against the projection of the markers at each commanded posture; half a radian a second
    blurs them by four pixels or more."""
    eyes.place((0.0, 0.0))
    exposure, blur = 1.0 / 60.0, 0.8
    goal = eyes.angles + [0.1, -0.08, 0.1, 0.05]
    ways = []
    for allowed in (blur, 1e9):
        made = guide_of_prior(eyes, exposure=exposure, blur=allowed)
        guide = MarkerGuide(
            made.config, ARM, EYES, (made.transform_slot_to_robot, PRIOR),
            made.transform_card_to_robot, goal,
        )  # fmt: skip
        seen = eyes.observe()
        wanted = np.array([guide.step(seen)[0].arm for _ in range(300)])
        assert np.abs(np.diff(wanted, axis=0)).max() <= 0.5 * 0.01 + 1e-12
        markers = true_parts(eyes.data).markers()
        pixels = np.array(
            [EYES.pixels(ARM.tool_in_robot(angles).inv().apply(markers)) for angles in wanted]
        )
        ways.append(np.linalg.norm(np.diff(pixels, axis=0), axis=-1).max() * exposure / 0.01)
        np.testing.assert_allclose(wanted[-1], goal, atol=1e-9)
    # The guide knows the markers' places to some millimetres.
    assert ways[0] < 1.1 * blur
    assert ways[1] > 4.0


@pytest.mark.parametrize("turned", [0.0, 0.3])
def test_errors_of_arm_and_head_enter_by_as_much_as_the_camera_has_moved(eyes, turned):
    """Against drawn mountings and zeros: of a camera that stays, nothing is left of them."""
    eyes.place((0.0, 0.0))
    deviations = np.repeat([3e-3, 1e-3, 4e-3], [3, 3, 4])
    arm = dataclasses.replace(
        ARM,
        joints=tuple(dataclasses.replace(joint, zero_sigma=4e-3) for joint in ARM.joints),
        mount_covariance=np.diag(np.square(deviations[:6])),
    )
    made = guide_of_prior(eyes, np.zeros((6, 6)))
    config = dataclasses.replace(made.config, wander=(0.0, 0.0))
    slot = made.transform_slot_to_robot
    guide = MarkerGuide(config, arm, EYES, (slot, PRIOR), slot, eyes.angles)
    guide.step(eyes.observe())
    guide.slot_covariance = np.zeros((6, 6))
    angles = eyes.angles + turned * np.array([1.0, 0.5, -0.5, 0.0])
    before, camera = ARM.tool_in_robot(eyes.angles), ARM.tool_in_robot(angles)
    _, stated, _ = guide._slot_before(angles)
    seen = before.inv() * guide.transform_slot_to_robot
    rng, drawn = np.random.default_rng(3), []
    for _ in range(4000 if turned else 10):
        *mounting, yaw, shoulder, elbow, wrist = rng.standard_normal(10) * deviations
        mount, zeros = RigidTransform.from_exp_coords(mounting), [yaw, shoulder, elbow, wrist]
        now, then = (ARM.tool_in_robot(at + zeros) * mount for at in (angles, eyes.angles))
        true = now.inv() * then * seen
        drawn.append((true * (camera.inv() * before * seen).inv()).as_exp_coords())
    drawn = np.array(drawn)
    if not turned:
        np.testing.assert_allclose(stated, 0.0, atol=1e-20)
        np.testing.assert_allclose(drawn, 0.0, atol=1e-12)
        return
    found, sigma = drawn.T @ drawn / len(drawn), np.sqrt(np.diag(stated))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(found / scale, stated / scale, atol=0.15)


def test_pose_of_a_head_as_made_is_consistent_with_what_its_calibration_states(eyes):
    """Heads drawn by their calibration's deviations, each with its own card and slot in view."""
    squares, found = [], 0
    cameras = dataclasses.replace(DEFAULT_CAMERA, latency=1e-2)
    for seed in range(8):
        eyes.place(((-1) ** seed * 4e-3, 0.02))
        config = StereoConfig(realism=cameras)
        eyes.rig = StereoRig(eyes.model, f"{MASTER}/", config, np.random.SeedSequence(seed))
        made = eyes.marker_guide()
        geometry = dataclasses.replace(EYES, calibration=cameras.calibration)
        guide = MarkerGuide(
            made.config, ARM, geometry, (made.transform_slot_to_robot, PRIOR),
            made.transform_card_to_robot, eyes.angles,
        )  # fmt: skip
        _, guidance = guide.step(eyes.observe())
        assert guidance is not None
        if guidance.transform_slot_to_card is not None and guidance.slot_seen:
            found += 1
            squares.append(square(eyes, guidance))
    assert found >= 7
    assert 1.5 < np.mean(squares) < 11.0
