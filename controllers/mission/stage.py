"""A stage of a mission: what every stage has, and how one ends that cannot do its part."""

from typing import Protocol

from twin.robot import Command, Observation


class StageError(RuntimeError):
    """A stage cannot do its part; it ends the mission.

    Args:
        stage: Name of the stage.
        reason: Why, in words.
    """

    def __init__(self, stage: str, reason: str) -> None:
        super().__init__(f"{stage}: {reason}")
        self.stage, self.reason = stage, reason


class MissionStage(Protocol):
    """One rover's part of a stage."""

    name: str

    @property
    def done(self) -> bool:
        """Whether the rover has completed its part of the stage."""
        ...

    def step(self, seen: Observation) -> Command | None:
        """Process an observation and return the next command; None for none."""
        ...
