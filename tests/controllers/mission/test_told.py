"""What a rover does once its twin has named a change."""

import numpy as np
import pytest

from controllers.mission import robot_mission
from controllers.mission.radio import MissionRadio, Status
from controllers.mission.robot_mission import RobotMission
from controllers.mission.stage import StageError
from controllers.sensing.consequences import Consequence
from controllers.sensing.diagnosis import UNKNOWN, Finding
from tests.controllers.mission.hand_made import MASTER, SLAVE, belief_of, hand_links
from tests.controllers.motion.seen import seen_at
from twin.robot import Command

ANEW, STAGE = Command(np.full(4, 0.5)), Command(np.zeros(4))


class Stage:
    """A stage whose part is done when it is told."""

    def __init__(self, name="approach"):
        self.name, self.done = name, False

    def step(self, seen):
        return STAGE


class Anew:
    """An identification that takes three ticks."""

    def __init__(self, belief, rng):
        self.left = 3

    @property
    def done(self):
        return self.left == 0

    def step(self, seen):
        self.left -= 1
        return ANEW


@pytest.fixture
def rover(monkeypatch):
    monkeypatch.setattr(robot_mission, "SwingArm", Anew)
    links = hand_links()
    stages = [Stage(), Stage("insert")]
    part = RobotMission(
        belief_of(SLAVE), MissionRadio(links[0], MASTER), 2, iter(stages), np.random.default_rng(1)
    )
    links[1].send(Status(1).pack())  # The other rover has completed its part.
    return part, stages


def speeds(part):
    """Largest speed and turning rate of the next drive."""
    navigator = part.belief.navigator
    navigator.observe(seen_at(0.01))
    navigator.follow(navigator.place + [[0.0, 0.5], [0.0, 1.0]], None)
    drive = navigator._drive
    return drive._config.speed, drive._config.turn


@pytest.mark.parametrize(
    ("name", "size", "consequence"),
    [
        ("drag front_left", 0.2, Consequence.GO_ON),
        ("drag front_left", 1.5, Consequence.SLOWER),
        ("grip rear_right", -0.5, Consequence.SLOWER),
        (UNKNOWN, 0.0, Consequence.SLOWER),
    ],
)
def test_it_goes_on_as_before_or_at_half_its_speeds(rover, name, size, consequence):
    part, _ = rover
    before = speeds(part)
    for _ in range(2):  # Told twice it does not halve them twice.
        assert part.told(Finding(name, size, 0.02, 9.0)) is consequence
    share = 0.5 if consequence is Consequence.SLOWER else 1.0
    assert speeds(part) == pytest.approx((share * before[0], share * before[1]))
    assert part.step(seen_at(0.01)) is STAGE and part.stage.name == "approach"


@pytest.mark.parametrize(
    ("name", "size", "why"),
    [
        ("blocked front_left", 1.0, "front left is blocked"),
        ("supply elbow", 0.8, "the motor of elbow has lost torque"),
    ],
)
def test_it_stops_with_what_changed(rover, name, size, why):
    part, _ = rover
    with pytest.raises(StageError, match=f"approach: {why}"):
        part.told(Finding(name, size, 0.02, 9.0))


@pytest.mark.parametrize(("name", "size"), [("load base", 1.0), ("spring rear_left", -0.5)])
def test_what_moves_its_pitch_dynamics_lets_it_identify_them_anew_before_the_next_stage(
    rover, name, size
):
    part, stages = rover
    assert part.step(seen_at(0.01)) is STAGE
    part.told(Finding(name, size, 0.02, 9.0))
    # The stage is completed first, and no other one begins meanwhile.
    assert part.step(seen_at(0.02)) is STAGE
    stages[0].done = True
    for tick in range(3):
        assert part.step(seen_at(0.03 + 0.01 * tick)) is ANEW
        assert part.stage is stages[0] and part.ended == []
    assert part.step(seen_at(0.06)) is STAGE
    assert part.stage is stages[1] and part.ended == ["approach"]
    # While a card is inserted nothing is identified.
    part.told(Finding(name, size, 0.02, 9.0))
    stages[1].done = True
    assert part.step(seen_at(0.07)) is STAGE and part._anew is None
