"""The twin beside one rover: a shadow, and what its innovations say of changes."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from controllers.sensing.changes import UNKNOWN, Change, ChangeConfig, ChangeDetector, ChangeMemory
from controllers.sensing.diagnosis import Finding
from controllers.sensing.foresight import Foresight
from models.compose import RobotPlacement
from perception.geometry.arrays import FloatArray
from twin.connect import ConnectionSettings
from twin.describe import describe_rover
from twin.logs.ticks import RoverTick
from twin.robot import Command
from twin.servo import SERVO_PERIOD
from twin.shadow.deviations import Deviation, rover_deviations, shadow_scene
from twin.shadow.shadow import Innovation, Shadow, ShadowConfig

AHEAD = 1.0
"""How far the twin predicts [s], once in that time."""


@dataclasses.dataclass(frozen=True)
class Block:
    """What the twin found in a block of ticks.

    Attributes:
        time: Time at its end [s].
        surprise: (channels,) root mean square of the innovations over their deviations.
        deviations: (k,) deviations from the drawing, as learned and as named.
        sigma: (k,) their standard deviations.
        evidence: Logarithm of how much likelier a change is than none; NaN while learning.
    """

    time: float
    surprise: FloatArray
    deviations: FloatArray
    sigma: FloatArray
    evidence: float


@dataclasses.dataclass(frozen=True)
class Named:
    """A change that was named.

    Attributes:
        time: When it was [s].
        finding: Its name and size.
        unit: Unit of the size.
    """

    time: float
    finding: Finding
    unit: str

    def __str__(self) -> str:
        found, unit = self.finding, f" {self.unit}" if self.unit != "1" else ""
        if found.name == UNKNOWN:
            return f"{self.time:.1f} s: {UNKNOWN}"
        return (
            f"{self.time:.1f} s: {found.name} {found.size:+.3g} +- {1.96 * found.sigma:.2g}{unit}"
        )


@dataclasses.dataclass(frozen=True)
class TwinMemory:
    """What a twin knows of its rover, so that it can go on another time.

    Attributes:
        names: Names of its deviations.
        known: (k,) those that it has.
        learned: What is learned beside them.
    """

    names: tuple[str, ...]
    known: FloatArray
    learned: ChangeMemory


class TwinBeside:
    """A shadow, and the detector that its innovations go to.

    Args:
        placed: The rover; its name and what it carries, nothing of how it was made.
        learning: Time for which it is only learned [s].
        begin: Time of the rover's own zero [s].
        memory: What is known of it already; None for nothing.
        threads: Count of threads that share its models.

    Attributes:
        drawn: The rover as drawn.
        shadow: The shadow.
        deviations: Ways in which it may differ.
        blocks: What was found, block by block.
        named: Changes that were named.
        foresight: What became of its predictions.

    Raises:
        ValueError: If there is no twin of such a rover, or the memory is another twin's.
    """

    def __init__(
        self,
        placed: RobotPlacement,
        learning: float,
        begin: float = 0.0,
        memory: TwinMemory | None = None,
        threads: int = 2,
    ) -> None:
        self.drawn = describe_rover(placed.name, card=placed.card, mast=placed.mast)
        self.deviations = rover_deviations(self.drawn)
        config = ShadowConfig(threads=threads)
        self.shadow = Shadow(shadow_scene(placed), self.drawn, self.deviations, config)
        usual, ticks = ChangeConfig(), round(learning / SERVO_PERIOD)
        self._config = dataclasses.replace(usual, learning=max(1, ticks // usual.block))
        self._changes = changes_of(self.deviations)
        spreads = np.array([each.spread for each in self.deviations])
        self._detector = ChangeDetector(spreads, self._changes, self._config)
        if memory is not None:
            if memory.names != tuple(each.name for each in self.deviations):
                raise ValueError(f"{placed.name}: what is known is of a twin with other deviations")
            self.shadow.know(memory.known)
            self._detector.remember(memory.learned)
        self._begin = begin
        self._applied: Command | None = None
        self._squares: list[FloatArray] = []
        self.blocks: list[Block] = []
        self.named: list[Named] = []
        self.foresight = Foresight()
        self._pause()

    def _pause(self) -> None:
        """Foresee nothing until the twin has begun."""
        self._since, self._kind = math.nan, 0

    @property
    def memory(self) -> TwinMemory:
        """What it knows of its rover."""
        names = tuple(each.name for each in self.deviations)
        return TwinMemory(names, self.shadow.known, self._detector.memory)

    def close(self) -> None:
        """End the shadow's threads."""
        self.shadow.close()

    def step(self, tick: RoverTick) -> None:
        """Take a tick of the rover."""
        before, self._applied = self._applied, tick.applied
        innovation = self.shadow.step(tick.seen, before or tick.applied)
        if innovation is None:
            # What comes next is not of the same motion.
            self._detector.pause()
            self._squares.clear()
            self._pause()
            return
        kind = int(innovation.driving)
        found = self._detector.step(
            innovation.values, innovation.sigma, innovation.sensitivities, kind
        )
        self._foresee(innovation, kind)
        self._squares.append(np.square(innovation.values / innovation.sigma))
        time = self._begin + innovation.time
        if len(self._squares) == self._config.block:
            self._end_block(time)
        if found is not None:
            self._name(found, time)

    def _foresee(self, innovation: Innovation, kind: int) -> None:
        """Compare what was foreseen with what is measured, and foresee anew, when it is time."""
        # A rover that drives at all in that time is shaken.
        self._kind = max(self._kind, kind)
        if innovation.time - self._since > AHEAD - 0.5 * SERVO_PERIOD:
            self.foresight.add(innovation.foreseen, self._kind)
            self._pause()
        if math.isnan(self._since):
            self._since, self._kind = innovation.time, kind
            self.shadow.foresee(self.shadow.known + self._detector.deviations)

    def _end_block(self, time: float) -> None:
        rows = np.array(self._squares)
        self._squares = []
        surprise = [_rms(rows[:, place]) for place in self.shadow.channels.values()]
        detector = self._detector
        self.blocks.append(
            Block(
                time,
                np.array(surprise),
                self.shadow.known + detector.deviations,
                np.sqrt(np.diag(detector.covariance)),
                detector.odds,
            )
        )

    def _name(self, found: Finding, time: float) -> None:
        there = {each.name: each for each in self._changes}
        change = there.get(found.name)
        self.named.append(Named(time, found, change.unit if change else ""))
        if change is None:
            self._detector.reset()
            return
        self.shadow.know(self.shadow.known + change.direction * found.size)
        self._pause()
        self._detector.accept(change, found)


def placement_of(settings: ConnectionSettings | None, robot: str) -> RobotPlacement:
    """Return what the settings of a connection say that a rover carries.

    Args:
        settings: None for a real one, of which nothing is said.
        robot: Its name.
    """
    robots = settings.robots if settings is not None else ()
    return next((each for each in robots if each.name == robot), RobotPlacement(robot))


def changes_of(deviations: Sequence[Deviation]) -> list[Change]:
    """Return the changes that there may be: of each deviation, and of all motors' supply."""
    rows = np.eye(len(deviations))
    single = [
        Change(each.name, each.unit, row, each.change, each.sign, each.usual)
        for each, row in zip(deviations, rows)
        if each.change > 0.0
    ]
    supply = np.array([float(each.name.startswith("supply")) for each in deviations])
    return [*single, Change("battery", "1", supply, 0.3, 1)]


def _rms(squares: FloatArray) -> float:
    there = squares[np.isfinite(squares)]
    return float(np.sqrt(np.mean(there))) if len(there) else float("nan")
