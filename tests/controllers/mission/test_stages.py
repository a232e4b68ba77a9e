"""Stages ``identify`` and ``insert``: what starts, holds and ends them."""

import math
import types
import typing

import numpy as np
import pytest

from controllers.identification import rover_identifier
from controllers.identification.pitch import PitchPrior
from controllers.identification.rover_identifier import RoverIdentifierConfig
from controllers.insertion.camera_station import camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import InsertionStage
from controllers.insertion.guidance import KIND, Guidance
from controllers.insertion.marker_guide import MarkerGuide
from controllers.insertion.team import ARM_REACH
from controllers.mapping.localization import tilt_to_level
from controllers.mission.belief import MissionBelief
from controllers.mission.radio import PATIENCE, SILENT, MissionRadio, SlotPose, Status
from controllers.mission.stage import StageError
from controllers.mission.stages.identify import SwingArm
from controllers.mission.stages.insert import GuideInsertion, InsertCard
from controllers.motion.base_tilt import drawn_springs
from tests.controllers.mission.hand_made import (
    HOME,
    MASTER,
    ROVERS,
    SITE,
    SLAVE,
    TILT,
    HandLink,
    KinematicRover,
    Stage,
    belief_of,
    hand_links,
    localized,
    transform_robot_to_ground,
)
from twin.robot import Command, Observation

CAMERA_ARM = camera_arm(ROVERS[MASTER])[0]
CARD = CardArm(ROVERS[SLAVE], SITE.insertion.tip).transform_card_to_robot(HOME)
VIEW = Guidance(1.0, True, True)


def off_axis(angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the angles between the optical axis of the left camera and a point."""
    x, y, z = CAMERA_ARM.tool_in_robot(angles).apply(point, inverse=True)
    return np.array([math.atan2(x, z), math.atan2(y, z)])


class Radioed:
    """A stage with its rover's radio, and what the other rover sends."""

    def __init__(self, name: str, partner: str) -> None:
        own, self.other = hand_links()
        self.link: HandLink = own
        self.radio = MissionRadio(own, partner)
        self.radio.stage = "insert"
        self.rover = KinematicRover(name)
        self.status: Status | None = Status(5)

    def step(self, stage: Stage) -> Command:
        """Step the stage; the other rover sends its status ten times a second."""
        if self.rover.ticks % 10 == 0 and self.status is not None:
            self.other.send_latest(self.status.pack())
        self.radio.begin_tick(0.01 * self.rover.ticks)
        return self.rover.step(stage)


@pytest.fixture
def guided(monkeypatch: pytest.MonkeyPatch) -> list[MarkerGuide]:
    """Return a list that gets each stepped guide; each step yields the same guidance."""
    guided: list[MarkerGuide] = []

    def step(self: MarkerGuide, seen: Observation) -> tuple[Command, Guidance]:
        guided.append(self)
        return Command(np.ones(4), HOME), VIEW

    monkeypatch.setattr(MarkerGuide, "step", step)
    return guided


def test_master_aims_between_card_and_slot_and_guides_once_both_arms_are_ready(
    guided: list[MarkerGuide], monkeypatch: pytest.MonkeyPatch
) -> None:
    aimed: list[np.ndarray] = []

    def begin(self: MarkerGuide) -> np.ndarray:
        aimed.append(self._goal.copy())
        return self._goal

    monkeypatch.setattr(MarkerGuide, "begin", begin)
    belief, made = localized(MASTER), Radioed(MASTER, SLAVE)
    stage = GuideInsertion(belief, made.radio, CARD)
    for _ in range(50):  # Nobody knows where the card is.
        made.step(stage)
    assert not aimed and not made.radio.ready
    upright = transform_robot_to_ground(SLAVE)
    slot = upright.inv() * SITE.insertion.transform_slot_to_ground
    made.status = Status(5, False, SlotPose(slot, 1e-6 * np.eye(6)))
    fastest, ready = 0.0, []
    for _ in range(550):
        fastest = max(fastest, np.abs(made.step(stage).arm_rates).max())
        ready.append(made.radio.ready)
    ground = transform_robot_to_ground(MASTER)
    to_slot = ground.inv() * SITE.insertion.transform_slot_to_ground
    middle = 0.5 * (to_slot.translation + (ground.inv() * upright * CARD).translation)
    middle = tilt_to_level(TILT).inv().apply(middle)
    np.testing.assert_allclose(off_axis(aimed[0], middle), 0.0, atol=2e-3)
    assert fastest == pytest.approx(0.5) and ready[-1]
    assert not guided and not made.link.sent and stage.done and stage.sent is None
    made.status = Status(5, True, SlotPose(slot, 1e-6 * np.eye(6)))
    for _ in range(11):
        command = made.step(stage)
    np.testing.assert_array_equal(command.wheels, np.ones(4))
    assert made.link.sent[-1] == VIEW.pack() and len(guided) and stage.sent == VIEW
    assert guided[0].config.plan is not None


class Inserter:
    """Stands for the slave's part of the insertion."""

    def __init__(self) -> None:
        self.inserter = types.SimpleNamespace(stage=InsertionStage.WAIT, reason="")
        self.steps = 0

    def step(self, seen: Observation) -> Command:
        self.steps += 1
        return Command(np.ones(4), HOME + 0.1)


def begun_insertion() -> tuple[InsertCard, Inserter, Radioed]:
    """Return a slave's stage that has begun to insert."""
    made, belief = Radioed(SLAVE, MASTER), localized(SLAVE)
    stage, hand = InsertCard(belief, made.radio), Inserter()
    stage.slave = typing.cast(typing.Any, hand)
    made.status = Status(5, True)
    while not made.radio.ready:
        made.step(stage)
    return stage, hand, made


def test_slave_inserts_once_its_arm_is_home_and_the_master_is_ready() -> None:
    made, belief = Radioed(SLAVE, MASTER), localized(SLAVE)
    stage, hand = InsertCard(belief, made.radio), Inserter()
    # The card's support is the pitching base, by the springs of its wheels.
    wheels = np.array([(wheel.spring, wheel.centre[1]) for wheel in ROVERS[SLAVE].wheels])
    stiffness = wheels[:, 0] @ wheels[:, 1] ** 2 / ARM_REACH**2
    assert stage.slave.inserter.config.guide.stiffness == pytest.approx(stiffness)
    np.testing.assert_allclose(
        stage.slave.inserter.belief.slot_in_start, belief.slot_in_level()[0].as_matrix(), atol=1e-9
    )
    stage.slave = typing.cast(typing.Any, hand)
    made.rover = KinematicRover(SLAVE, HOME + [0.4, 0.0, 0.0, 0.0])
    for _ in range(200):
        made.other.send_latest(VIEW.pack())
        made.step(stage)
    np.testing.assert_allclose(made.rover.command.arm, HOME, atol=1e-12)
    assert not made.radio.ready and not hand.steps and not stage.done
    made.status = Status(5, True)
    for _ in range(12):
        made.step(stage)
    assert made.radio.ready and hand.steps
    hand.inserter.stage = InsertionStage.DONE
    assert stage.done


def test_slave_stands_still_while_it_hears_nothing_and_goes_on_afterwards() -> None:
    stage, hand, made = begun_insertion()
    made.step(stage)
    made.status = None
    for _ in range(round(100 * (SILENT + 0.2))):
        made.step(stage)
    before = hand.steps
    for _ in range(1500):
        command = made.step(stage)
        assert not command.wheels.any()
        np.testing.assert_allclose(command.arm, HOME + 0.1)
    assert hand.steps == before
    made.status = Status(5, True)
    for _ in range(12):
        made.step(stage)
    assert hand.steps > before


def test_slave_whose_card_is_guided_by_force_needs_no_radio() -> None:
    stage, hand, made = begun_insertion()
    hand.inserter.stage = InsertionStage.INSERT
    made.status = None
    before = hand.steps
    for _ in range(1000):
        made.step(stage)
    assert hand.steps == before + 1000


def test_slave_that_hears_nothing_for_too_long_or_fails_ends_the_stage_with_the_reason() -> None:
    stage, hand, made = begun_insertion()
    made.status = None
    with pytest.raises(StageError, match="insert: nothing heard from rover1"):
        for _ in range(round(100 * (PATIENCE + 1.0))):
            made.step(stage)
    stage, hand, made = begun_insertion()
    hand.inserter.stage, hand.inserter.reason = InsertionStage.FAILED, "target not seen"
    with pytest.raises(StageError, match="insert: target not seen"):
        for _ in range(2):
            made.step(stage)


def test_guidance_is_a_kind_of_its_own() -> None:
    assert VIEW.pack()[0] == KIND != Status(0).pack()[0]


class FakeIdentifier:
    """Swings for three ticks, then fits for four; ends each fit with the next doubts."""

    def __init__(self, config: RoverIdentifierConfig, doubts: list[tuple[str, ...]]) -> None:
        self.config, self.swings, self.fits, self.repeated = config, 0, 0, 0
        self.fit = types.SimpleNamespace(estimate=types.SimpleNamespace(doubts=self._doubt))
        self._doubts = doubts

    def _doubt(self, prior: PitchPrior) -> tuple[str, ...]:
        return self._doubts.pop(0)

    @property
    def done(self) -> bool:
        return self.swings == 3

    def step(self, seen: dict[str, Observation]) -> dict[str, Command]:
        self.swings += 1
        return {SLAVE: Command(np.full(4, float(self.swings)))}

    def conclude(self) -> bool:
        self.fits += 1
        return self.fits % 4 == 0

    def hold(self) -> dict[str, Command]:
        return {SLAVE: Command(arm=np.full(4, 0.5))}

    def repeat(self) -> bool:
        self.repeated += 1
        if self.repeated > 1:
            return False
        self.swings = 0
        return True


def identify_with(
    doubts: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
) -> tuple[MissionBelief, FakeIdentifier, int]:
    """Return belief, identifier and ticks of a stage whose fits end with these doubts."""
    made: list[FakeIdentifier] = []

    def make(config: RoverIdentifierConfig, rng: np.random.Generator) -> FakeIdentifier:
        made.append(FakeIdentifier(config, doubts))
        return made[-1]

    monkeypatch.setattr(rover_identifier, "RoverIdentifier", make)
    belief = belief_of(SLAVE)
    stage, ticks = SwingArm(belief, np.random.default_rng(0)), 0
    while not stage.done:
        command = stage.step(Observation(0.01 * ticks))
        # A robot without a command would stop: the arm is held while the fit goes on.
        assert (command.wheels.size == 0) == np.array_equal(command.arm, np.full(4, 0.5))
        ticks += 1
    np.testing.assert_array_equal(stage.step(Observation(0.01 * ticks)).arm, np.full(4, 0.5))
    (identifier,) = made
    assert identifier.config.robot == SLAVE
    return belief, identifier, ticks


def test_identification_swings_then_holds_the_arm_while_it_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief, identifier, ticks = identify_with([()], monkeypatch)
    assert ticks == 3 + 4 and identifier.fits == 4
    assert belief.pitch is belief.identification is identifier.fit.estimate
    assert belief.doubts == ()


def test_identification_that_is_doubted_is_repeated_gently(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief, identifier, ticks = identify_with([("chi squared is 2.0",), ()], monkeypatch)
    assert ticks == 2 * (3 + 4) and belief.pitch is identifier.fit.estimate
    assert belief.doubts == ()
    assert identifier.repeated == 1


def test_robot_that_cannot_identify_itself_keeps_to_the_drawing_and_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    doubts = [("chi squared is 2.0",), ("chi squared is 1.5",)]
    belief, identifier, _ = identify_with(doubts, monkeypatch)
    assert belief.pitch is None and belief.identification is identifier.fit.estimate
    assert belief.doubts == ("chi squared is 1.5",)
    assert belief.springs() == drawn_springs(belief.robot)
