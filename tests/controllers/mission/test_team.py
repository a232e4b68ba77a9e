"""Both robots' lists of stages, by what the mission goes without."""

import math
import types
import typing

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import CameraStation
from controllers.mission import team
from controllers.mission.exchange import Exchange
from controllers.mission.site import MissionRoles
from controllers.mission.team import MissionConfig
from tests.controllers.mission.hand_made import MASTER, ROVERS, SLAVE, HandLink, belief_of
from twin.robot import Command, Observation

ALL = ["identify", "find", "meet", "map", "place", "insert"]
LEFT_OUT = {
    "": [],
    "identification": ["identify"],
    "mapping": ["find", "map"],
    "placement": ["place"],
}


@pytest.mark.parametrize("without", LEFT_OUT)
def test_both_robots_have_the_same_stages_less_what_is_left_out(
    monkeypatch: pytest.MonkeyPatch, without: str
) -> None:
    config, rng = MissionConfig(without), np.random.default_rng(0)
    roles = MissionRoles(ROVERS[MASTER], ROVERS[SLAVE])
    exchange = Exchange(typing.cast(typing.Any, {MASTER: HandLink(), SLAVE: HandLink()}))
    master, slave = belief_of(MASTER), belief_of(SLAVE)
    shared = types.SimpleNamespace(transform_target_to_world=RigidTransform.identity())
    station = CameraStation((0.8, -0.4, math.pi / 2), np.zeros(4), 0.5, 0.0)
    monkeypatch.setattr(team, "choose_station", lambda belief: station)
    monkeypatch.setattr(
        team.MapTogether, "begin", lambda *_: types.SimpleNamespace(name="map", done=True)
    )
    guiding = team._master_stages(master, roles, exchange, config, (rng, rng))
    holding = team._slave_stages(slave, roles, exchange, config, rng)
    names: list[tuple[str, str]] = []
    while (stage := next(guiding, None)) is not None:
        if stage.name == "find":
            master.map = typing.cast(typing.Any, shared)
        exchange.mapper = typing.cast(typing.Any, types.SimpleNamespace())
        other = next(holding)
        names.append((stage.name, other.name))
        if stage.name == "meet":
            assert (typing.cast(typing.Any, other)._turns != []) == (without != "identification")
        if stage.name == "insert":
            assert typing.cast(typing.Any, stage)._placed == (without != "placement")
    assert next(holding, None) is None
    expected = [name for name in ALL if name not in LEFT_OUT[without]]
    assert names == [(name, name) for name in expected]


class Part:
    """One robot's part, which notes in what order it is called."""

    def __init__(self, name: str, calls: list[str], command: Command | None) -> None:
        self.name, self.over, self._calls, self._command = name, False, calls, command
        self.ended = ["one", "two"] if name == MASTER else ["one"]

    def report(self, seen: Observation) -> None:
        self._calls.append(f"{self.name} reports {seen.time}")

    def step(self, seen: Observation) -> Command | None:
        self._calls.append(f"{self.name} steps {seen.time}")
        return self._command


def test_both_robots_report_before_either_steps() -> None:
    both, calls, command = team.MissionTeam.__new__(team.MissionTeam), [], Command()
    both.master = typing.cast(typing.Any, Part(MASTER, calls, command))
    both.slave = typing.cast(typing.Any, Part(SLAVE, calls, None))
    assert both.step({MASTER: Observation(1.0), SLAVE: Observation(2.0)}) == {MASTER: command}
    assert set(calls[:2]) == {f"{MASTER} reports 1.0", f"{SLAVE} reports 2.0"}
    assert set(calls[2:]) == {f"{MASTER} steps 1.0", f"{SLAVE} steps 2.0"}
    # A stage has ended when both have ended it.
    assert both.ended == ["one"] and not both.over
