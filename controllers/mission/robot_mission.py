"""One rover's part of a mission: stages in sequence, each using the estimates of earlier ones.

A stage ends when both rovers have completed their parts of it, as far as the radio says so.
"""

from collections.abc import Iterator

from controllers.mission.belief import MissionBelief
from controllers.mission.map_exchange import MapExchange
from controllers.mission.radio import MissionRadio
from controllers.mission.stage import MissionStage
from controllers.mission.stages.give_way import GiveWay
from controllers.mission.stages.insert import InsertCard
from twin.robot import Command, Observation

_MOST_WAYS = 4  # Number of times that a rover gives way.
_TAKEN = "place"  # Stage after which it does so no more: one of both has taken its place.


class RobotMission:
    """One rover's part of a mission, which uses its own observations and its radio alone.

    Args:
        belief: Estimates of the rover.
        radio: The rover's end of the radio.
        number: Number of the rover in its messages, 0 to 255.
        stages: Stages of the rover, each created when the previous one has ended.

    Attributes:
        belief: Estimates of the rover.
        radio: The rover's end of the radio.
        stage: Present stage.
        ended: Names of the completed stages.
        over: Whether the last stage has ended.
    """

    def __init__(
        self,
        belief: MissionBelief,
        radio: MissionRadio,
        number: int,
        stages: Iterator[MissionStage],
    ) -> None:
        self.belief, self.radio = belief, radio
        self.ended: list[str] = []
        self.over = False
        self._number, self._stages = number, stages
        self._maps: MapExchange | None = None
        self._gives_way: GiveWay | None = None
        self._ways = 0
        self.stage = next(stages)

    @property
    def name(self) -> str:
        """Name of the rover."""
        return self.belief.robot.name

    def step(self, seen: Observation) -> Command | None:
        """Continue the present stage, or begin the next.

        Args:
            seen: Observation of the rover.

        Raises:
            StageError: If the stage cannot do its part, or the other rover is silent for too long.
        """
        radio = self.radio
        radio.stage = self.stage.name
        radio.begin_tick(seen.time)
        self.belief.partner = radio.partner.slot
        if self.stage.done and not self.over and self._way is None:
            self._end_stage()
        if self.stage.name != InsertCard.name:  # From then on the line is for guidance.
            self._exchange_maps(seen.time)
        command = self._command(seen)
        radio.stage = self.stage.name
        radio.blocked = self.belief.navigator.hindered and not self.stage.done
        radio.tell(len(self.ended) + (self.stage.done and not self.over), self.belief.slot_now)
        return command

    def _command(self, seen: Observation) -> Command | None:
        """Return the command of the stage; a rover that waits may be in the other one's way."""
        localized = self.belief.localization is not None
        waits = self.stage.done and localized and _TAKEN not in self.ended
        called = self.radio.partner.blocked and not self.radio.silent
        if waits and called and self._gives_way is None and self._ways < _MOST_WAYS:
            self._gives_way = GiveWay(self.belief)
            self._ways += 1
        if (way := self._way) is not None:
            return way.step(seen)
        if not called:
            self._gives_way = None
        return self.stage.step(seen)

    @property
    def _way(self) -> GiveWay | None:
        """Drive out of the other one's way that has not ended: the localization is of before it."""
        way = self._gives_way
        return None if way is None or way.done else way

    def _exchange_maps(self, now: float) -> None:
        """Exchange maps as soon as both rovers are in the panel's frame."""
        if self.belief.localization is None or self.belief.partner is None:
            return
        if self._maps is None:
            self._maps = MapExchange(self.belief, self.radio, self._number)
        self._maps.step(now)

    def _end_stage(self) -> None:
        """Begin the next stage if the other rover has completed its part, too."""
        if self.radio.partner.done <= len(self.ended):
            self.radio.wait()
            return
        self.ended.append(self.stage.name)
        self.radio.ready = False
        following = next(self._stages, None)
        self.over = following is None
        self.stage = following or self.stage
