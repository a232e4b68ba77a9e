"""The twin beside one rover: a shadow, and what its innovations say of changes."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from controllers.sensing.changes import Change, ChangeConfig, ChangeDetector, ChangeMemory
from controllers.sensing.diagnosis import UNKNOWN, Finding
from controllers.sensing.foresight import Foresight
from controllers.sensing.jumps import ZeroJumps
from controllers.sensing.loose_camera import LooseCamera
from controllers.sensing.tilt_zeros import TiltZeros
from controllers.sensing.trial import Trial
from models.compose import RobotPlacement
from models.datasheets import INCLINOMETER
from perception.geometry.arrays import FloatArray
from twin.connect import ConnectionSettings
from twin.describe import describe_rover
from twin.logs.ticks import RoverTick
from twin.robot import Command
from twin.servo import SERVO_PERIOD
from twin.shadow.deviations import WEAKEST, Deviation, rover_deviations, shadow_scene
from twin.shadow.shadow import Innovation, Shadow, ShadowConfig

AHEAD = 1.0
"""How far the twin predicts [s], once in that time."""
LOOKING = 0.99
"""Time after a pair of images from which on the next one is looked at [s]."""
TILTS = "zero pitch", "zero roll"
"""Zeros of the inclinometer, by name; the accelerometer tells them."""
PATCHES = 0.25
"""How far friction below a wheel wanders on rough ground, as a share of the drawing's."""


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
        rough: Whether the ground is uneven and has patches of friction, on which neither less grip
            nor a tilt or twist is a change, and what is tried out is named only where the seconds
            after that tell the same.

    Attributes:
        drawn: The rover as drawn.
        shadow: The shadow.
        deviations: Ways in which it may differ.
        blocks: What was found, block by block.
        suspected: Likeliest change at each alarm, before any is tried out; innovations count as
            linear in it.
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
        rough: bool = False,
    ) -> None:
        self.drawn = describe_rover(placed.name, card=placed.card, mast=placed.mast)
        self.deviations = rover_deviations(self.drawn)
        config = ShadowConfig(threads=threads, even=not rough)
        self.shadow = Shadow(shadow_scene(placed), self.drawn, self.deviations, config)
        usual, ticks = ChangeConfig(), round(learning / SERVO_PERIOD)
        self._config = dataclasses.replace(usual, learning=max(1, ticks // usual.block))
        spreads = np.array([each.spread for each in self.deviations])
        wander = np.array([rough and each.name.startswith("grip") for each in self.deviations])
        walks = np.where(wander, PATCHES / spreads, usual.walk)
        self._changes = changes_of(
            [dataclasses.replace(each, change=0.0) if fixed else each
             for each, fixed in zip(self.deviations, wander)]
        )  # fmt: skip
        self._by_name = {each.name: each for each in self._changes}
        # A zero that jumps or drifts shows beside other sensors; here it looks like much else.
        felt = [
            each for each in self._changes if not each.whole and not each.name.startswith("zero")
        ]
        self._detector = ChangeDetector(spreads, felt, self._config, walks)
        noise, at = self.shadow.noise, self.shadow.channels
        angle, rate, force = (
            float(noise[at[name]].max()) for name in ("arm_angles", "arm_rates", "accelerometer")
        )
        self._jumps = ZeroJumps(angle, rate)
        self._tilts = TiltZeros(
            INCLINOMETER.bandwidth, INCLINOMETER.linear_range, force, SERVO_PERIOD
        )
        self._tilted = -math.inf
        self._eyes = LooseCamera(self.drawn.head.camera) if self.drawn.head else None
        self._looked = -math.inf
        self._trial: Trial | None = None
        self._suspects: list[Change] = []
        self._rough = rough
        #: What the trial before told, that is to be told twice.
        self._once = ""
        if memory is not None:
            if memory.names != tuple(each.name for each in self.deviations):
                raise ValueError(f"{placed.name}: what is known is of a twin with other deviations")
            self.shadow.know(memory.known)
            self._detector.remember(memory.learned)
        #: What the twin takes in as it is learned: what does not happen wholly, or wander.
        self._lasting = ~wander & np.array([not each.encoder for each in self.deviations])
        self._begin = begin
        self._applied: Command | None = None
        self._squares: list[FloatArray] = []
        self.blocks: list[Block] = []
        self.suspected: list[Named] = []
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
            self._end_trial()
            self._jumps.reset()
            self._tilts.reset()
            self._squares.clear()
            self._pause()
            return
        kind = innovation.driving + 2 * innovation.swinging
        self._foresee(innovation, kind)
        self._squares.append(np.square(innovation.values / innovation.sigma))
        time = self._begin + innovation.time
        if len(self._squares) == self._config.block:
            self._end_block(time)
            self._take_in()
        found = self._jump(tick) or self._drift(tick) or self._look(innovation, kind)
        if found is not None:
            self._end_trial()
            self._name(found, time)
        if (loose := self._look_at(tick)) is not None:
            self.named.append(Named(time, loose, "rad"))

    def _jump(self, tick: RoverTick) -> Finding | None:
        """Return the zero of an encoder that jumped."""
        angles, rates = tick.seen.arm_angles, tick.seen.arm_rates
        if not (angles.usable and rates.usable):
            return None
        read, turning = (np.array(each.value, dtype=float) for each in (angles, rates))
        jump = self._jumps.step(tick.seen.time, read, turning)
        if jump is None:
            return None
        name = f"zero {self.drawn.joint_names[jump.joint]}"
        return Finding(name, jump.size, jump.sigma, abs(jump.size) / jump.sigma)

    def _drift(self, tick: RoverTick) -> Finding | None:
        """Return the zero of the inclinometer that drifted."""
        tilt, force = tick.seen.inclinometer, tick.seen.accelerometer
        if not (tilt.usable and force.usable):
            self._tilts.reset()
            return None
        new, self._tilted = tilt.stamp > self._tilted, tilt.stamp
        shown = np.array(tilt.value, dtype=float) if new else None
        drift = self._tilts.step(shown, np.array(force.value, dtype=float))
        if drift is None:
            return None
        return Finding(TILTS[drift.axis], drift.size, drift.sigma, abs(drift.size) / drift.sigma)

    def _look_at(self, tick: RoverTick) -> Finding | None:
        """Return a camera that came loose, if there are images."""
        pair = tick.seen.stereo
        if self._eyes is None or not pair.usable or pair.stamp < self._looked + LOOKING:
            return None
        self._looked = pair.stamp
        return self._eyes.step(np.asarray(pair.value, dtype=np.uint8))

    def _look(self, innovation: Innovation, kind: int) -> Finding | None:
        """Look for changes; those that are suspected are tried out until one is named, or none."""
        told = innovation.sigma, innovation.sensitivities
        if self._trial is None:
            found = self._detector.step(innovation.values, *told, kind)
            if found is not None:
                unit = self._by_name[found.name].unit
                self.suspected.append(Named(self._begin + innovation.time, found, unit))
                self._try(innovation)
            return None
        rows = self._trial.rows
        self._trial.step(innovation.tried, *told, kind)
        if not self._trial.over:
            if self._trial.rows is not rows:
                self.shadow.try_out(self.shadow.known + self._trial.rows, self._trial.begin)
            return None
        if (found := self._trial.finding) is None:
            self._detector.pause()
            self._end_trial()
        elif self._rough and found.name != self._once:
            self._once = found.name
            self._begin_trial()
            return None
        return found

    def _try(self, innovation: Innovation) -> None:
        """Try out what the detector suspects."""
        suspects = self._detector.suspects
        part = suspects[0].name.partition(" ")[2]
        names = [each.name for each in suspects]
        #: What happens wholly or not looks like much that is wrong with the same part.
        whole = [f"{kind} {part}" for kind in ("stuck", "blocked")]
        cannot = {each.name for each, no in zip(self.deviations, innovation.refuted) if no}
        names += [each for each in whole if each in self._by_name and each not in names]
        self._suspects = [self._by_name[each] for each in names if each not in cannot]
        self._once = ""
        if self._suspects:
            self._begin_trial()

    def _begin_trial(self) -> None:
        """Try out what is suspected, from where the twin is."""
        self._trial = Trial(self._suspects, self._detector.learned)
        self.shadow.try_out(self.shadow.known + self._trial.rows)

    def _end_trial(self) -> None:
        if self._trial is not None:
            self._trial = None
            self.shadow.try_out(np.empty((0, len(self.deviations))))

    def _foresee(self, innovation: Innovation, kind: int) -> None:
        """Compare what was foreseen with what is measured, and foresee anew, when it is time."""
        # A rover that drives at all in that time is shaken.
        self._kind |= kind
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

    def _take_in(self) -> None:
        """Let the twin have what was learned, after each quarter of the learning but the last.

        Innovations are linear in small deviations only: friction that holds a joint lets go. A
        learning is too short for that if a quarter of it is over as soon as the twin has settled.
        """
        learning = self._config.learning
        quarters = [number * learning // 4 for number in (1, 2, 3)]
        long_enough = learning > 4 * self._config.settling
        if long_enough and self._trial is None and self._detector.blocks in quarters:
            self.shadow.know(self.shadow.known + self._detector.take_in(self._lasting))
            self._pause()

    def _name(self, found: Finding, time: float) -> None:
        change = self._by_name.get(found.name)
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
        Change(
            each.name, each.unit, row, each.change, each.sign, each.whole, each.most, each.wholly
        )
        for each, row in zip(deviations, rows)
        if each.change > 0.0
    ]
    supply = np.array([float(each.name.startswith("supply")) for each in deviations])
    return [*single, Change("battery", "1", supply, 0.3, 1, most=WEAKEST)]


def _rms(squares: FloatArray) -> float:
    there = squares[np.isfinite(squares)]
    return float(np.sqrt(np.mean(there))) if len(there) else float("nan")
