"""One rover's part of a mission: stages in sequence, each using the estimates of earlier ones.

A stage ends when both rovers have completed their parts of it, as far as the radio says so. What a
twin beside the rover names may slow it, stop it, or let it identify itself anew beforehand.
"""

from collections.abc import Iterator

import numpy as np

from controllers.mission.belief import MissionBelief
from controllers.mission.map_exchange import MapExchange
from controllers.mission.radio import MissionRadio
from controllers.mission.stage import MissionStage, StageError
from controllers.mission.stages.give_way import GiveWay
from controllers.mission.stages.identify import SwingArm
from controllers.mission.stages.insert import InsertCard
from controllers.sensing.consequences import Consequence, consequence_of, on_springs
from controllers.sensing.diagnosis import UNKNOWN, Finding
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
        rng: Random generator for the excitation of an identification anew.

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
        rng: np.random.Generator,
    ) -> None:
        self.belief, self.radio = belief, radio
        self.ended: list[str] = []
        self.over = False
        self._number, self._stages = number, stages
        self._maps: MapExchange | None = None
        self._gives_way: GiveWay | None = None
        self._ways = 0
        self._rng = rng
        self._anew: SwingArm | None = None
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
        if self._done and not self.over and self._way is None:
            self._end_stage()
        if self.stage.name != InsertCard.name:  # From then on the line is for guidance.
            self._exchange_maps(seen.time)
        command = self._command(seen)
        radio.stage = self.stage.name
        radio.blocked = self.belief.navigator.hindered and not self.stage.done
        radio.tell(len(self.ended) + (self._done and not self.over), self.belief.slot_now)
        return command

    def told(self, finding: Finding) -> Consequence:
        """Take a change of the rover that its twin named, and return what it means.

        The rover goes on, drives at half its speeds, or stops. Of a change that is not known it
        goes on slower, as nobody is there to look. What moves its pitch dynamics lets it swing its
        arm anew before the next stage.

        Args:
            finding: A change of those of `twin.shadow.deviations`.

        Raises:
            StageError: If it cannot go on, with what changed.
        """
        consequence, reason = consequence_of(finding, self.belief.robot)
        if finding.name == UNKNOWN:
            consequence = Consequence.SLOWER
        if consequence is Consequence.STOP:
            raise StageError(self.stage.name, reason)
        if consequence is Consequence.SLOWER:
            self.belief.navigator.slow()
        if on_springs(finding) and self.stage.name != InsertCard.name:
            self._anew = SwingArm(self.belief, self._rng)
        return consequence

    @property
    def _done(self) -> bool:
        """Whether its part of the stage is completed, and it knows itself for the next."""
        return self.stage.done and self._anew is None

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
        if self._anew is not None and self.stage.done and not self.over:
            command = self._anew.step(seen)
            if self._anew.done:
                self._anew = None
            return command
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
