"""Both rovers' parts, which a radio with losses and silences keeps together."""

import typing
from collections.abc import Iterator

import numpy as np
import pytest

from controllers.insertion.watching import ArmChoice
from controllers.mission import robot_mission, team
from controllers.mission.belief import MissionBelief
from controllers.mission.config import STAGES, MissionConfig
from controllers.mission.radio import PATIENCE, MissionRadio
from controllers.mission.robot_mission import RobotMission
from controllers.mission.site import MissionRoles
from controllers.mission.stage import MissionStage, StageError
from controllers.mission.team import CameraStations, MissionTeam
from tests.controllers.mission.hand_made import (
    MASTER,
    POSES,
    ROVERS,
    SITE,
    SLAVE,
    HandLink,
    belief_of,
    hand_links,
    localized,
)
from tests.controllers.motion.seen import seen_at
from twin.hardware.emulator.modem import ModemConfig, virtual_links
from twin.robot import Command, Observation

TICK = 0.05


class Work:
    """A stage that takes some time."""

    def __init__(self, name: str, seconds: float) -> None:
        self.name, self._left = name, seconds

    @property
    def done(self) -> bool:
        return self._left <= 0.0

    def step(self, seen: Observation) -> Command | None:
        self._left -= TICK
        return None


def parts_with(
    links: typing.Any, *seconds: tuple[float, float]
) -> tuple[RobotMission, RobotMission]:
    """Return both rovers' parts; each stage takes each rover some time."""

    def stages(index: int) -> Iterator[MissionStage]:
        for number, each in enumerate(seconds):
            yield Work(f"stage {number}", each[index])

    return tuple(
        RobotMission(
            belief_of(name),
            MissionRadio(link, partner),
            index,
            stages(index),
            np.random.default_rng(1),
        )
        for index, (name, partner, link) in enumerate(
            [(MASTER, SLAVE, links[0]), (SLAVE, MASTER, links[1])]
        )
    )  # type: ignore[return-value]


def play(
    parts: tuple[RobotMission, RobotMission],
    seconds: float,
    tick: typing.Callable[[float], None] = lambda now: None,
) -> dict[str, list[float]]:
    """Step both parts; return the times at which each has ended its stages."""
    ends: dict[str, list[float]] = {part.name: [] for part in parts}
    for step in range(round(seconds / TICK)):
        now = TICK * step
        tick(now)
        for part in parts:
            part.step(seen_at(now))
            if len(part.ended) > len(ends[part.name]):
                ends[part.name].append(now)
    return ends


def test_a_stage_ends_for_both_when_both_have_done_their_parts() -> None:
    parts = parts_with(hand_links(), (2.0, 5.0), (4.0, 1.0))
    ends = play(parts, 12.0)
    for first, second in ends.values():
        assert first == pytest.approx(5.0, abs=0.2) and second == pytest.approx(9.0, abs=0.3)
    assert all(part.over and part.ended == ["stage 0", "stage 1"] for part in parts)
    assert all(not part.radio.notices for part in parts)


@pytest.mark.parametrize("begin", [1.0, 6.0, 14.0])
def test_a_mission_goes_on_after_twenty_seconds_of_silence(begin: float) -> None:
    """In the midst of a stage, where one waits for the other, and where one has gone on alone."""
    links = hand_links()
    parts = parts_with(links, (3.0, 9.0), (8.0, 6.0), (2.0, 2.0))

    def silence(now: float) -> None:
        for link in links:
            link.silent = begin <= now < begin + 20.0

    ends = play(parts, 60.0, silence)
    assert all(part.over for part in parts)
    # Each has gone on with its own part: no stage takes longer than the silence and both parts.
    assert max(ends[MASTER]) < 40.0
    for part in parts:
        assert any("not heard" in words for _, words in part.radio.notices)
        assert any("again" in words for _, words in part.radio.notices)
    assert any("waits" in words for part in parts for _, words in part.radio.notices)


def test_a_radio_that_falls_silent_for_good_ends_the_stage_after_the_patience_that_it_states() -> (
    None
):
    links = hand_links()
    parts = parts_with(links, (3.0, 5.0), (200.0, 10.0))
    links_off = 8.0

    def silence(now: float) -> None:
        for link in links:
            link.silent = now >= links_off

    with pytest.raises(StageError, match="stage 1: nothing heard from rover1 for 60 s") as failed:
        play(parts, 150.0, silence)
    assert failed.value.stage == "stage 1"
    assert parts[1].stage.done and not parts[0].stage.done
    assert parts[1].radio.silence == pytest.approx(PATIENCE, abs=2.0)


def test_with_a_fifth_of_the_messages_lost_all_stages_end_within_seconds() -> None:
    clock = [0.0]
    rng = np.random.default_rng(2)
    links = virtual_links([MASTER, SLAVE], lambda: clock[0], rng, ModemConfig(packet_loss=0.2))
    parts = parts_with([links[MASTER], links[SLAVE]], *[(1.0, 3.0), (3.0, 1.0)] * 3)
    ends = play(parts, 60.0, lambda now: clock.__setitem__(0, now))
    for each in ends.values():
        assert len(each) == 6 and max(each) < 6 * 3.0 + 6 * 4.0


def test_the_rovers_have_their_parts_of_all_stages_in_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Stages made by hand: whether each is made only when the one before has ended."""
    made: list[tuple[str, str]] = []

    def stand_in(name: str) -> typing.Callable[..., Work]:
        def make(*args: typing.Any, **named: typing.Any) -> Work:
            belief = next(arg for arg in args if hasattr(arg, "robot"))
            called = next((arg for arg in args if isinstance(arg, str)), name)
            made.append((belief.robot.name, called))
            return Work(called, 0.1)

        make.name = name  # type: ignore[attr-defined]
        return make

    for kind, name in (
        ("SwingArm", "identify"), ("SearchPanel", "search"), ("GoToPlace", ""), ("Wait", ""),
        ("MapSite", "map"), ("GuideInsertion", "insert"), ("InsertCard", "insert"),
    ):  # fmt: skip
        monkeypatch.setattr(team, kind, stand_in(name))
    links = dict(zip((MASTER, SLAVE), hand_links(), strict=True))
    roles = MissionRoles(ROVERS[MASTER], ROVERS[SLAVE])
    both = MissionTeam(roles, SITE, MissionConfig(), np.random.default_rng(0), links)
    assert both.stage == "identify" and len(made) == 2
    for step in range(400):
        now = TICK * step
        both.step({MASTER: seen_at(now), SLAVE: seen_at(now)})
    assert both.over and both.ended == list(STAGES) and both.stage == "insert"
    for name in (MASTER, SLAVE):
        assert [stage for robot, stage in made if robot == name] == list(STAGES)
    assert both.notices == []


def at_its_best_station(monkeypatch: pytest.MonkeyPatch) -> MissionBelief:
    """Return the estimates of a master that stands at its best station, on level ground."""
    best = CameraStations(localized(MASTER), True).best().place
    monkeypatch.setitem(POSES, MASTER, best)
    belief = localized(MASTER)
    ground = belief.navigator.ground.newest
    ground.heights[...] = belief.transform_ground_to_map.translation[2]
    ground.variances[...] = 1e-6
    return belief


def test_a_station_suits_unless_something_hides_the_slot_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief = at_its_best_station(monkeypatch)
    assert CameraStations(belief, True).suits(seen_at(0.0))
    x, y, _ = POSES[MASTER]
    to_map, ground = belief.transform_ground_to_map, belief.navigator.ground.newest
    for share in np.linspace(0.5, 0.6, 5):  # A wall across, between it and the slot.
        for across in np.linspace(-0.6, 0.6, 80):
            away = share * np.array([x, y]) + across * np.array([-y, x])
            place = np.asarray(to_map.apply([*away, 0.0]))[:2]
            row, column = ground.grid.cells_of(place)
            ground.heights[row, column] = to_map.translation[2] + 0.6
    assert not CameraStations(belief, True).suits(seen_at(0.0))
    assert CameraStations(belief, False).suits(seen_at(0.0))  # As if nothing was mapped.


def test_another_station_is_chosen_than_one_that_does_not_suit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    belief = at_its_best_station(monkeypatch)
    stations = CameraStations(belief, True)
    first = stations.best().place
    nothing = ArmChoice(belief.home, 0.0, 0.0, False)
    monkeypatch.setattr(team, "best_angles", lambda *_, **__: nothing)
    assert not stations.suits(seen_at(0.0))
    second = stations.best().place
    assert np.hypot(*np.subtract(first, second)[:2]) > 0.1
    place = belief.place_in_ground()[:2]
    assert np.hypot(*(np.array(second)[:2] - place)) >= 0.15


def test_a_rover_reads_the_others_place_from_its_status(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_mission, "MapExchange", NoMaps)
    links: tuple[HandLink, HandLink] = hand_links()
    parts = parts_with(links, (9.0, 9.0))
    parts[1].belief = localized(SLAVE)
    play(parts, 1.5)
    place = parts[0].belief.partner_place()
    assert place is not None
    np.testing.assert_allclose(place, POSES[SLAVE][:2], atol=2e-3)


class NoMaps:
    """Exchanges nothing."""

    def __init__(self, *args: object) -> None:
        pass

    def step(self, now: float) -> None:
        pass
