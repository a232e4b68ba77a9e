"""One robot's part of a mission: stages in sequence, each using the estimates of earlier ones.

A stage ends when both robots have completed their parts of it.
"""

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from controllers.mission.belief import MissionBelief
from controllers.mission.exchange import ArmPosture, Exchange, StagesDone
from twin.robot import Command, Observation


class MissionStage(Protocol):
    """One robot's part of a stage."""

    name: str

    @property
    def done(self) -> bool:
        """Whether the robot has completed its part of the stage."""
        ...

    def step(self, seen: Observation) -> Command | None:
        """Process an observation and return the next command; None for none."""
        ...


class RobotMission:
    """One robot's part of a mission, which uses its own observations alone.

    Args:
        belief: Estimates of the robot.
        partner: Name of the other robot.
        exchange: Message exchange between the robots.
        stages: Stages of the robot, each created when the previous one has ended.

    Attributes:
        belief: Estimates of the robot.
        stage: Present stage.
        ended: Names of the completed stages.
        over: Whether the last stage has ended.
    """

    def __init__(
        self,
        belief: MissionBelief,
        partner: str,
        exchange: Exchange,
        stages: Iterator[MissionStage],
    ) -> None:
        self.belief = belief
        self.ended: list[str] = []
        self.over = False
        self._partner, self._exchange, self._stages = partner, exchange, stages
        self.stage = next(stages)

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.belief.robot.name

    def report(self, seen: Observation) -> None:
        """Post the arm's posture, and whether the robot's part of this stage is completed.

        Args:
            seen: Observation of the robot.
        """
        channel = seen.arm_angles
        angles = np.asarray(channel.value, dtype=float) if channel.usable else None
        self._exchange.post(self.name, ArmPosture(angles))
        if self.stage.done:
            self._exchange.post(self.name, StagesDone(len(self.ended) + 1))

    def step(self, seen: Observation) -> Command | None:
        """Continue the present stage, or begin the next; to be called after `report` of both.

        Args:
            seen: Observation of the robot.
        """
        other = self._exchange.read(self._partner, StagesDone)
        done = other is not None and other.count > len(self.ended)
        if self.stage.done and done and not self.over:
            self.ended.append(self.stage.name)
            following = next(self._stages, None)
            self.over = following is None
            self.stage = following or self.stage
        return self.stage.step(seen)
