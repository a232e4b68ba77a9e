"""Both rovers of a mission, joined by their message exchange."""

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from controllers.insertion.card_arm import CardArm
from controllers.mission.belief import MissionBelief
from controllers.mission.exchange import Exchange, MapBegun
from controllers.mission.robot_mission import MissionStage, RobotMission
from controllers.mission.site import MissionRoles, SiteDrawing
from controllers.mission.stages.find import FindPanel
from controllers.mission.stages.identify import SwingArm
from controllers.mission.stages.insert import GuideInsertion, InsertCard
from controllers.mission.stages.map import MapTogether
from controllers.mission.stages.meet import FindCard, GuidedSlave, TurnInView
from controllers.mission.stages.place import PlaceCamera, choose_station
from controllers.mission.stages.rest import Rest
from twin.link import Link
from twin.robot import Command, Observation

OMITTABLE = ("identification", "mapping", "placement")
"""Parts that an ablation can leave out of a mission."""


@dataclasses.dataclass(frozen=True)
class MissionConfig:
    """Configuration of a mission.

    Attributes:
        without: Part of `OMITTABLE` that is left out; empty for none.
        scans: Number of views of the master alone, and of each robot when both have met.
    """

    without: str = ""
    scans: tuple[int, int] = (4, 3)


class MissionTeam:
    """Runs both robots' parts; a `twin.robot.Controller`.

    Args:
        roles: Descriptions of both robots.
        site: Drawing of the site.
        config: Configuration of the mission.
        rng: Random generator for the excitations and for candidate views.
        links: Each robot's end of the radio, by robot name.

    Attributes:
        master: Part of the robot with the camera.
        slave: Part of the robot that holds the card.
    """

    def __init__(
        self,
        roles: MissionRoles,
        site: SiteDrawing,
        config: MissionConfig,
        rng: np.random.Generator,
        links: Mapping[str, Link],
    ) -> None:
        exchange = Exchange(links)
        identify, explore = rng.spawn(2)
        swings = identify.spawn(2)
        master = MissionBelief.initial(roles.master, roles.slave, site)
        slave = MissionBelief.initial(roles.slave, roles.master, site)
        guiding = _master_stages(master, roles, exchange, config, (swings[0], explore))
        holding = _slave_stages(slave, roles, exchange, config, swings[1])
        self.master = RobotMission(master, roles.slave.name, exchange, guiding)
        self.slave = RobotMission(slave, roles.master.name, exchange, holding)

    def reset(self) -> None:
        """Do nothing: each mission has a new team."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Let both robots post their state, then step each."""
        parts = (self.master, self.slave)
        for part in parts:
            part.report(observations[part.name])
        commands = {part.name: part.step(observations[part.name]) for part in parts}
        return {name: command for name, command in commands.items() if command is not None}

    @property
    def over(self) -> bool:
        """Whether the last stage has ended."""
        return self.master.over and self.slave.over

    @property
    def ended(self) -> list[str]:
        """Names of the stages that both robots have completed."""
        return [name for name, _ in zip(self.master.ended, self.slave.ended)]


def _master_stages(
    belief: MissionBelief,
    roles: MissionRoles,
    exchange: Exchange,
    config: MissionConfig,
    sources: tuple[np.random.Generator, np.random.Generator],
) -> Iterator[MissionStage]:
    """Yield the stages of the robot with the camera; generators are for excitation and views."""
    swing, explore = sources
    assert roles.slave.arm is not None
    arm = CardArm(roles.slave, belief.site.insertion.tip)
    card = arm.transform_card_to_robot(roles.slave.arm.home)
    slave = GuidedSlave(belief, roles.slave.name, exchange, card)
    if config.without != "identification":
        yield SwingArm(belief, swing)
    if config.without != "mapping":
        yield FindPanel(belief, config.scans[0], explore)
    if belief.map is not None:
        exchange.post(belief.robot.name, MapBegun())
    yield FindCard(slave)
    belief.receive(exchange, slave.name)
    if belief.map is not None:
        yield MapTogether.begin(belief, roles.slave, exchange, config.scans[1], explore)
    placed = config.without != "placement"
    if placed:
        yield PlaceCamera(belief, choose_station(belief))
    yield GuideInsertion(slave, placed)


def _slave_stages(
    belief: MissionBelief,
    roles: MissionRoles,
    exchange: Exchange,
    config: MissionConfig,
    rng: np.random.Generator,
) -> Iterator[MissionStage]:
    """Yield the stages of the robot that holds the card; the generator is for the excitation."""
    partner = roles.master.name
    if config.without != "identification":
        yield SwingArm(belief, rng)
    if config.without != "mapping":
        yield Rest(belief, FindPanel.name)
    yield TurnInView(belief, exchange, turns=config.without != "identification")
    if exchange.read(partner, MapBegun) is not None:
        yield MapTogether(belief, exchange)
    if config.without != "placement":
        yield Rest(belief, PlaceCamera.name)
    yield InsertCard(belief, partner, exchange)
