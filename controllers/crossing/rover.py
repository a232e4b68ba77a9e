"""One rover's part in crossing a field, stage after stage; stages of both end together."""

from collections.abc import Iterator, Mapping
from typing import Protocol

from twin.robot import Command, Observation


class StageError(RuntimeError):
    """A stage cannot do its part; it ends the crossing.

    Args:
        stage: Name of the stage.
        reason: Why, in words.
    """

    def __init__(self, stage: str, reason: str) -> None:
        super().__init__(f"{stage}: {reason}")
        self.stage, self.reason = stage, reason


class FieldStage(Protocol):
    """One rover's part of a stage."""

    name: str

    @property
    def done(self) -> bool:
        """Whether the rover has completed its part of the stage."""
        ...

    def step(self, seen: Observation) -> Command | None:
        """Process an observation and return the next command; None for none."""
        ...


class FieldRover:
    """One rover's part, which uses its own observations alone.

    Args:
        name: Name of the rover.
        stages: Stages of the rover, each created when the previous one has ended.

    Attributes:
        name: Name of the rover.
        stage: Present stage.
        ended: Names of the completed stages.
        over: Whether the last stage has ended.
    """

    def __init__(self, name: str, stages: Iterator[FieldStage]) -> None:
        self.name, self.ended, self.over = name, list[str](), False
        self._stages = stages
        self.stage = next(stages)

    def step(self, seen: Mapping[str, Observation], goes_on: bool) -> Command | None:
        """Continue the present stage, or begin the next.

        Args:
            seen: Observation of each rover, of which only its own is read.
            goes_on: Whether both rovers have completed their parts of the stage.
        """
        if goes_on and not self.over:
            self.ended.append(self.stage.name)
            following = next(self._stages, None)
            self.over = following is None
            self.stage = following or self.stage
        return self.stage.step(seen[self.name])
