"""Stage ``meet``: where the master points its camera, and what the slave derives from guidance."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.guidance import Guidance
from controllers.insertion.marker_guide import MarkerGuide
from controllers.mapping.localization import tilt_to_level
from controllers.mission.belief import drawn_turn_share
from controllers.mission.exchange import CardMet, SlotPose, TurnShare
from controllers.mission.stages.meet import FindCard, GuidedSlave, TurnInView, turn_share
from perception.geometry.se3 import transport_covariance
from tests.controllers.mission.hand_made import (
    HOME,
    MASTER,
    ROVERS,
    SHARE,
    SITE,
    SLAVE,
    TILT,
    HandLink,
    KinematicRover,
    belief_of,
    exchange_with,
    transform_robot_to_ground,
)
from twin.robot import Command, Observation

CARD = CardArm(ROVERS[SLAVE], SITE.insertion.tip).transform_card_to_robot(HOME)
CAMERA_ARM = camera_arm(ROVERS[MASTER])[0]
CENTRE = [0.0, -SITE.insertion.card_length / 2.0, 0.0]
SLIGHT = 1e-8 * np.eye(6)


class Meeting:
    """A slave that turns, and a master that measures it exactly.

    Args:
        turns: Whether the slave turns.
        left: Turn to the left over that of rolling wheels.
        right: Turn to the right over that of rolling wheels.
    """

    def __init__(self, turns: bool = True, left: float = SHARE, right: float = SHARE) -> None:
        self.belief = belief_of(SLAVE)
        self.slot = self.belief.transform_slot_to_level
        self.exchange, links = exchange_with(SLAVE)
        self.link: HandLink = links[SLAVE]
        self.rover = KinematicRover(SLAVE, left=left, right=right)
        self.stage = TurnInView(self.belief, self.exchange, turns)

    def view(self) -> Guidance:
        """Return exact guidance of the present pose."""
        slot = self.rover.pose.inv() * self.slot
        return Guidance(self.rover.seen.time, True, True, CARD.inv() * slot, SLIGHT)

    def run(self, until: float, every: int = 0) -> None:
        """Step until a time [s], with a view after each so many ticks."""
        while self.rover.seen.time < until - 1e-6 and not self.stage.done:
            self.rover.step(self.stage)
            if every and self.rover.ticks % every == 0:
                self.link.incoming.append(self.view())

    def rest(self) -> None:
        """Step until the arm is at rest and views count."""
        self.run(2.0)
        assert not self.rover.drives


def test_slave_turns_left_and_back_and_learns_the_share_of_both_turns() -> None:
    meeting = Meeting(left=0.6, right=0.8)
    rolled, drives = [0.0], []
    while not meeting.stage.done and meeting.rover.seen.time < 60.0:
        drove = meeting.rover.drives
        meeting.run(meeting.rover.seen.time + 0.01, every=7)
        drives.append(meeting.rover.drives)
        if drove and not drives[-1]:
            rolled.append(meeting.rover.rolled)
    assert meeting.stage.done
    left, right = np.abs(np.diff(rolled))
    assert len(rolled) == 3
    drawn = drawn_turn_share(ROVERS[SLAVE])
    np.testing.assert_allclose(np.array(rolled[1:]) * drawn.share, [0.35, 0.0], atol=0.02)
    # The views are exact; the variance of one turn is 0.2^2 / 2.
    share, scatter = (0.6 * left + 0.8 * right) / (left + right), 0.2**2 / 2.0
    information = np.array([2.0 / scatter, drawn.deviation**-2])
    posted = meeting.exchange.read(SLAVE, TurnShare)
    assert posted is not None and posted == meeting.belief.turn_share
    mean = information @ [share, drawn.share] / information.sum()
    assert posted.share == pytest.approx(mean, abs=1e-4)
    deviation = math.sqrt(1.0 / information.sum() + scatter)
    assert posted.deviation == pytest.approx(deviation, rel=1e-4)


def test_slot_is_where_the_turn_leaves_it_though_the_share_is_not_known_yet() -> None:
    meeting = Meeting(left=SHARE - 0.1, right=SHARE - 0.1)
    while not meeting.rover.drives:
        meeting.run(meeting.rover.seen.time + 0.01, every=7)
    while meeting.rover.drives:
        meeting.run(meeting.rover.seen.time + 0.01)
    belief = meeting.belief
    true = meeting.rover.pose.inv() * meeting.slot
    error = (true * belief.transform_slot_to_level.inv()).as_exp_coords()
    assert error[2] == pytest.approx(0.1 * meeting.rover.rolled, abs=0.005)
    assert error[2] > 0.05
    assert error @ np.linalg.solve(belief.slot_covariance, error) < 1.5


@pytest.mark.parametrize("sliding", [0.06, 10.0])
def test_share_of_turns_errs_by_its_deviation(sliding: float) -> None:
    """Measured turns and skidding as they may be, again and again, of robots unlike as drawn."""
    rng, rolled = np.random.default_rng(0), np.array([0.0, 0.5, 0.0])
    variances, scatter, squares = np.square([0.02, 0.03, 0.01]), 0.05, []
    for _ in range(4000):
        shares = 0.65 + scatter * rng.normal(size=3)
        yaws = np.concatenate([[0.0], np.cumsum(shares[:2] * np.diff(rolled))])
        drawn = TurnShare(0.65 + sliding * rng.normal(), sliding)
        yaws += np.sqrt(variances) * rng.normal(size=3)
        found = turn_share(yaws, variances, rolled, drawn)
        squares.append([(found.share - shares[2]) ** 2, found.deviation**2])
    off, expected = np.mean(squares, axis=0)
    before, between, after = variances
    measured = before + 4.0 * between + after
    true = 1.5 * scatter**2 + measured
    if sliding > 1.0:
        assert off == pytest.approx(true, rel=0.06)
        # What the first and the last yaw add to the scatter of two turns is counted once more.
        assert expected == pytest.approx(true + 3.0 * (before + after), rel=0.06)
    else:
        # Ideally sliding^2 and the mean turn's variance, each by its information, and the scatter.
        mean = 1.0 / (sliding**-2 + 1.0 / (measured + scatter**2 / 2.0))
        assert off == pytest.approx(mean + scatter**2, rel=0.1)
        assert off < expected < 1.6 * off


def test_turn_that_seems_to_go_the_wrong_way_lowers_the_share() -> None:
    rolled, variances = np.array([0.0, 0.5, 0.0]), np.full(3, 1e-8)
    found = turn_share(np.array([0.0, -0.1, -0.3]), variances, rolled, TurnShare(0.5, 1e6))
    # Of turns by -0.1 and -0.2: the shares are -0.2 and 0.4.
    assert found.share == pytest.approx(0.1, abs=1e-9)


def test_four_like_tyres_turn_by_the_share_as_drawn() -> None:
    """Brute force: the rate at which the friction of tyres that slide has no moment."""
    robot = ROVERS[SLAVE]
    track, base = robot.half_track, robot.half_wheelbase
    corners = np.array([[x, y] for x in (-track, track) for y in (-base, base)])
    rates = np.linspace(0.2, 0.8, 60001)
    # The wheels roll as for a turn of 1 rad/s: left backward, right forward.
    rolls = np.column_stack([np.zeros(4), np.sign(corners[:, 0]) * track])
    across = np.column_stack([-corners[:, 1], corners[:, 0]])
    slides = rates[:, None, None] * across - rolls
    pulls = -slides / np.linalg.norm(slides, axis=2, keepdims=True)
    moments = (corners[:, 0] * pulls[..., 1] - corners[:, 1] * pulls[..., 0]).sum(axis=1)
    assert drawn_turn_share(robot).share == pytest.approx(rates[np.abs(moments).argmin()], abs=1e-4)


def test_slave_does_not_turn_before_three_views_have_met_the_card() -> None:
    meeting = Meeting()
    meeting.rest()
    for views in range(3):
        assert not meeting.rover.drives
        assert (meeting.exchange.read(SLAVE, CardMet) is not None) == (views > 0)
        meeting.link.incoming.append(meeting.view())
        for _ in range(20):
            meeting.rover.step(meeting.stage)
    assert meeting.rover.drives
    speeds = meeting.rover.command.wheels
    np.testing.assert_allclose(speeds, speeds[1] * np.array([-1.0, 1.0, -1.0, 1.0]), atol=1e-12)
    assert speeds[1] > 0.0


def test_views_before_a_second_of_rest_and_views_without_a_card_do_not_count() -> None:
    # The arm is at home from the start: it is at rest after 0.6 s, and views count after 1.6 s.
    meeting = Meeting()
    meeting.rest()
    for time, pose in ((1.55, True), (0.5, True), (1.95, False)):
        view = meeting.view()
        seen = view.transform_slot_to_card if pose else None
        meeting.link.incoming = [Guidance(time, pose, True, seen, SLIGHT)] * 3
        meeting.rover.step(meeting.stage)
        assert meeting.exchange.read(SLAVE, CardMet) is None and not meeting.rover.drives
    view = meeting.view().transform_slot_to_card
    meeting.link.incoming = [Guidance(1.65, True, True, view, SLIGHT)]
    meeting.rover.step(meeting.stage)
    assert meeting.exchange.read(SLAVE, CardMet) is not None


def test_slave_that_is_not_detected_ends_after_15_s_with_the_drawn_pose() -> None:
    meeting = Meeting()
    drawn, covariance = meeting.belief.transform_slot_to_level, meeting.belief.slot_covariance
    meeting.run(15.5)
    assert not meeting.stage.done and not meeting.rover.turned
    meeting.run(15.8)
    assert meeting.stage.done and not meeting.rover.turned
    posted = meeting.exchange.read(SLAVE, SlotPose)
    assert posted is not None and not posted.met
    assert posted.transform_slot_to_robot is drawn and posted.covariance is covariance
    np.testing.assert_array_equal(posted.tilt, TILT)
    assert meeting.exchange.read(SLAVE, TurnShare) is None
    assert meeting.exchange.read(SLAVE, CardMet) is None


def test_slave_that_does_not_turn_posts_the_measured_pose_in_its_frame() -> None:
    meeting = Meeting(turns=False)
    shift = RigidTransform.from_components([0.02, -0.03, 0.01], Rotation.from_euler("z", 0.1))
    meeting.slot = shift * meeting.slot
    sigmas = np.diag(np.square([0.01, 0.02, 0.03, 0.004, 0.005, 0.006]))
    meeting.rest()
    view = meeting.view()
    meeting.link.incoming = [
        Guidance(view.time, True, True, view.transform_slot_to_card, sigmas)
    ] * 3
    meeting.rover.step(meeting.stage)
    assert meeting.stage.done and not meeting.rover.drives
    posted = meeting.exchange.read(SLAVE, SlotPose)
    assert posted is not None and posted.met
    for found in (posted.transform_slot_to_robot, meeting.belief.transform_slot_to_level):
        np.testing.assert_allclose(found.as_matrix(), meeting.slot.as_matrix(), atol=1e-12)
    for found in (posted.covariance, meeting.belief.slot_covariance):
        np.testing.assert_allclose(found, transport_covariance(CARD, sigmas), atol=1e-15)
    np.testing.assert_array_equal(posted.tilt, TILT)
    assert meeting.exchange.read(SLAVE, TurnShare) is None
    assert meeting.belief.turn_share == drawn_turn_share(ROVERS[SLAVE])


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize(("share", "met"), [(0.97, True), (1.03, False)])
def test_pose_beyond_the_gate_of_all_three_covariances_is_not_the_card(
    axis: int, share: float, met: bool
) -> None:
    meeting = Meeting()
    prior, measured = 0.03**2, 0.04**2
    # What else a turn may change: 0.05 rad, 0.05 m and, in height, 0.02 m.
    turn = np.square([0.05, 0.05, 0.05, 0.05, 0.05, 0.02])[axis]
    meeting.belief.slot_covariance = prior * np.eye(6)
    meeting.stage = TurnInView(meeting.belief, meeting.exchange, turns=True)
    meeting.rest()
    error = np.zeros(6)
    error[axis] = share * math.sqrt(30.0 * (turn + prior + measured))
    slot = RigidTransform.from_exp_coords(error) * meeting.slot
    covariance = transport_covariance(CARD.inv(), measured * np.eye(6))
    meeting.link.incoming = [Guidance(2.0, True, True, CARD.inv() * slot, covariance)]
    meeting.rover.step(meeting.stage)
    assert (meeting.exchange.read(SLAVE, CardMet) is not None) == met
    assert (meeting.belief.slot_covariance[0, 0] != prior) == met


def guided_slave() -> tuple[GuidedSlave, HandLink]:
    exchange, links = exchange_with(MASTER)
    return GuidedSlave(belief_of(MASTER), SLAVE, exchange, CARD), links[MASTER]


def off_axis(angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the angles between the optical axis of the left camera and a point."""
    x, y, z = CAMERA_ARM.tool_in_robot(angles).apply(point, inverse=True)
    return np.array([math.atan2(x, z), math.atan2(y, z)])


def card_in_master() -> RigidTransform:
    """Return the card's pose in the tilted master's frame, with both rovers where drawn."""
    ground, slave = transform_robot_to_ground(MASTER), transform_robot_to_ground(SLAVE)
    return tilt_to_level(TILT).inv() * ground.inv() * slave * CARD


def test_guide_of_the_master_begins_with_the_slot_in_its_tilted_frame() -> None:
    slave, _ = guided_slave()
    card, angles = card_in_master(), HOME + 0.1
    guide = slave.guide(card, TILT, angles, placed=False)
    slot, covariance = slave.belief.slot_in_robot(TILT)
    assert guide.transform_card_to_robot is card
    np.testing.assert_allclose(
        guide.transform_slot_to_robot.as_matrix(), slot.as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(guide.slot_covariance, covariance)
    np.testing.assert_array_equal(guide.begin(), angles)
    assert guide.config.plan is None
    assert guide.config.card is SITE.insertion.card and guide.config.slot is SITE.insertion.slot
    assert slave.guide(card, TILT, angles, placed=True).config.plan is not None


class Guides:
    """Stands for the detection in each pair.

    Attributes:
        view: Guidance of each step; None without a new pair.
        card: Measured pose of the card.
        used: Guides that were stepped.
    """

    def __init__(self) -> None:
        self.view: Guidance | None = None
        self.card: RigidTransform | None = None
        self.used: list[MarkerGuide] = []


@pytest.fixture
def guides(monkeypatch: pytest.MonkeyPatch) -> Guides:
    guides = Guides()

    def step(self: MarkerGuide, seen: Observation) -> tuple[Command, Guidance | None]:
        guides.used.append(self)
        if guides.card is not None:
            self.transform_card_to_robot = guides.card
        return Command(), guides.view

    monkeypatch.setattr(MarkerGuide, "step", step)
    return guides


def test_master_centres_the_card_as_drawn_and_then_turns_in_four_directions(
    guides: Guides,
) -> None:
    slave, link = guided_slave()
    stage, rover = FindCard(slave), KinematicRover(MASTER)
    goals = []
    # A direction gets 3 s.
    for second in (2.9, 5.8, 8.7, 11.8, 14.8, 30.0):
        while rover.seen.time < second:
            rover.step(stage)
        goals.append(rover.command.arm.copy())
    np.testing.assert_allclose(off_axis(goals[0], card_in_master().apply(CENTRE)), 0.0, atol=1e-4)
    np.testing.assert_array_equal(goals[0][1:-1], HOME[1:-1])
    low, high = CAMERA_ARM.limits.T
    turns = [(0.0, -0.25), (0.0, 0.25), (0.25, 0.0), (-0.25, 0.0), (-0.25, 0.0)]
    for goal, (yaw, wrist) in zip(goals[1:], turns, strict=True):
        expected = np.clip(goals[0] + [yaw, 0.0, 0.0, wrist], low, high)
        np.testing.assert_allclose(goal, expected, atol=1e-12)
    assert link.sent == [None] * rover.ticks and not rover.drives
    assert stage.done
    first = guides.used[0]
    np.testing.assert_allclose(
        first.transform_card_to_robot.as_matrix(), card_in_master().as_matrix(), atol=1e-12
    )


def test_master_does_not_search_on_once_the_slave_has_recognised_its_card(guides: Guides) -> None:
    slave, _ = guided_slave()
    stage, rover = FindCard(slave), KinematicRover(MASTER)
    slave.exchange.post(SLAVE, CardMet())
    while rover.seen.time < 6.0:
        rover.step(stage)
    np.testing.assert_allclose(
        off_axis(rover.command.arm, card_in_master().apply(CENTRE)), 0.0, atol=1e-4
    )


def test_master_centres_a_detected_card_before_it_sends_guidance(guides: Guides) -> None:
    slave, link = guided_slave()
    stage, rover = FindCard(slave), KinematicRover(MASTER)
    while not guides.used:
        rover.step(stage)
    before = rover.command.arm.copy()
    # A view without the card is sent as it is.
    guides.view = Guidance(1.0, False, True)
    rover.step(stage)
    assert link.sent[-1] is guides.view
    guides.card = RigidTransform.from_translation([0.1, 0.05, 0.02]) * card_in_master()
    guides.view = Guidance(1.1, True, True, RigidTransform.identity(), SLIGHT)
    rover.step(stage)
    assert link.sent[-1] is None
    detected = len(guides.used)
    rover.step(stage)
    assert len(guides.used) == detected and link.sent[-1] is None
    sent = [rover.step(stage) and link.sent[-1] for _ in range(200)]
    np.testing.assert_allclose(
        off_axis(rover.command.arm, guides.card.apply(CENTRE)), 0.0, atol=1e-4
    )
    assert np.abs(rover.command.arm - before).max() > 0.02
    # At rest at its new goal it sends each view.
    assert sent[-1] is guides.view and sent[0] is None


@pytest.mark.parametrize("end", [0, 1])
def test_master_searches_within_the_limits_of_its_joints(guides: Guides, end: int) -> None:
    slave, _ = guided_slave()
    stage, rover = FindCard(slave), KinematicRover(MASTER)
    rover.step(stage)
    stage._ahead = CAMERA_ARM.limits[:, end] * [1.0, 0.0, 0.0, 1.0] + HOME * [0.0, 1.0, 1.0, 0.0]
    low, high = CAMERA_ARM.limits.T
    while rover.seen.time < 20.0:
        rover.step(stage)
        assert np.all(rover.command.arm >= low) and np.all(rover.command.arm <= high)
