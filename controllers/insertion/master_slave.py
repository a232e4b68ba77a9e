"""Master and slave who carry a segment together and insert it (Thesis section A.4).

The master plans the segment's path, adds both grips' wrenches (figure A-6) and lets the insertion
guide move the plan in the direction of least resistance. The slave follows the set points received
by radio. Neither knows the other's joint angles, nor the stage's true pose.
"""

import dataclasses
import enum
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from controllers.insertion.cooperation import REPORT, SET_POINT, Grip, HybridGrip, decode, encode
from controllers.insertion.guide import GuideConfig, InsertionGuide
from controllers.motion.base_motion import level_of
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from twin.robot import Command, Observation


class Stage(enum.Enum):
    """Stage of the pair."""

    HOLD = "hold"
    CARRY = "carry"
    REST = "rest"
    INSERT = "insert"
    OVER = "over"


@dataclasses.dataclass(frozen=True)
class PairConfig:
    """Configuration shared by master and slave.

    Attributes:
        master: The master's grip.
        slave: The slave's grip.
        mouth: (2,) s, z of the mouth's middle by the master's estimate [m]; the stage is level.
        guide: Configuration of the insertion; `card_width` is that of the segment's web.
        stand_off: Height of the leading edge above the mouth before the insertion [m].
        hold: Time in which the tilt is averaged and the forces settle [s].
        carry: Duration of the path to the mouth [s].
        rest: Time before the insertion in which the wrench is tared of the segment's weight [s].
        every: Ticks between two messages.
        latency: Known latency of a message by the radio [s].
        lost_time: Age beyond which a message is ignored [s].
        period: Servo tick [s].
    """

    master: Grip
    slave: Grip
    mouth: tuple[float, float]
    guide: GuideConfig
    stand_off: float = 0.012
    hold: float = 1.0
    carry: float = 3.0
    rest: float = 1.0
    every: int = 4
    latency: float = 0.03
    lost_time: float = 0.3
    period: float = 0.01

    def __post_init__(self) -> None:
        """Refuse times out of range.

        Raises:
            ValueError: Naming the field.
        """
        check_numbers("pair", self, "hold", "carry", "rest", "lost_time", "period")
        if self.every < 1:
            raise ValueError(f"every = {self.every}: expected 1 tick or more between messages")


class _Partner:
    """Common part of master and slave: the partner's messages, and holding at the start."""

    def __init__(self, grip: HybridGrip, config: PairConfig) -> None:
        self._grip, self._config = grip, config
        self._message: FloatArray | None = None
        self._age = math.inf  # Age of the message [s].
        self._sent = 0
        self._holding = round(config.hold / config.period)  # Remaining ticks.
        self._tilts: list[float] = []

    def _take(self, seen: Observation, heard: list[bytes], kind: int, age: float = 0.0) -> None:
        """Process the wrench, and the newest message of a kind with its age at arrival [s]."""
        self._age += self._config.period
        for message in heard:
            found, values = decode(message)
            if found == kind:
                self._message, self._age = values, age
        self._grip.feel(seen)

    def _start(self, seen: Observation) -> FloatArray | None:
        """Average the tilt for a tick; at the end start the grip and return its pose (3,)."""
        if seen.inclinometer.usable:
            up = level_of(seen).specific_force
            self._tilts.append(math.atan2(up[1], up[2]))
        self._holding -= 1
        if self._holding > 0:
            return None
        return self._grip.start(float(np.mean(self._tilts)) if self._tilts else 0.0)

    def _encoded(self, kind: int, values: ArrayLike | None) -> bytes | None:
        """Return a message when one is due; None without values."""
        self._sent += 1
        if self._sent % self._config.every or values is None:
            return None
        return encode(kind, values)


class Master(_Partner):
    """Plans the segment's path, guides the insertion, and controls its own grip.

    Without the slave's reports, or its own wrench, it waits in REST; in INSERT it stops, and
    gives up after the guide's `lost_time`.

    Args:
        grip: Control of the master's gripper.
        config: Agreement of master and slave.
        guide: Insertion guide, by force or straight ahead.

    Attributes:
        stage: Stage of the pair.
        guide: Insertion guide, by force or straight ahead.
        target: (3,) planned pose of the segment, plan frame; NaN while it holds.
        felt: (3,) wrench of the stage on the segment from both grips' measurements, in the guide's
            frame [N, N, N m]; None without them.
    """

    def __init__(
        self,
        grip: HybridGrip,
        config: PairConfig,
        guide: Callable[[GuideConfig, FloatArray], InsertionGuide] = InsertionGuide,
    ) -> None:
        super().__init__(grip, config)
        self.stage = Stage.HOLD
        self.target = np.full(3, np.nan)
        self.felt: FloatArray | None = None
        self.guide = guide(config.guide, np.array([0.0, -config.stand_off, 0.0]))
        self._time = 0.0
        self._tare: list[FloatArray] = []
        self._weight, self._rate, self._begin = np.zeros((3, 3))

    def step(self, seen: Observation, heard: list[bytes]) -> tuple[Command, bytes | None]:
        """Return the arm's command and a message for the slave, None if there is none.

        Args:
            seen: Observation of the master.
            heard: Messages of the slave since the last step.

        Raises:
            RobotError: If joint angles are missing at the start.
            ValueError: If a message is of neither kind.
        """
        config = self._config
        self._take(seen, heard, REPORT)
        if self.stage is Stage.HOLD:
            held, gripper = self._grip.hold(seen), self._start(seen)
            if gripper is None:
                return held, None
            self._begin = config.master.segment_of(gripper)
            self.target, self.stage = self._begin.copy(), Stage.CARRY
        self._plan()
        command = self._grip.command(
            config.master.on(self.target), config.master.rate_on(self.target, self._rate)
        )
        return command, self._encoded(SET_POINT, [*self.target, *self._rate])

    def _plan(self) -> None:
        """Advance the segment's planned pose by a tick."""
        config, total = self._config, self._total()
        self._time += config.period
        self.felt = self._contact(total)
        before = self.target.copy()
        if self.stage is Stage.CARRY:
            share = min(self._time / config.carry, 1.0)
            smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
            goal = self._to_plan(np.array([0.0, -config.stand_off, 0.0]))
            self.target = self._begin + smooth * (goal - self._begin)
            if share == 1.0:
                self.stage, self._time = Stage.REST, 0.0
        elif self.stage is Stage.REST:
            if self._time > config.rest / 2.0 and total is not None:
                self._tare.append(total)
            if self._time >= config.rest and self._tare:
                self._weight = np.mean(self._tare, axis=0)
                self.stage = Stage.INSERT
        elif self.stage is Stage.INSERT:
            self.target = self._to_plan(self.guide.step(self.felt))
            if self.guide.over:
                self.stage = Stage.OVER
        self._rate = (self.target - before) / config.period

    def _to_plan(self, pose: FloatArray) -> FloatArray:
        """Return a pose of the guide's frame, x along s and y down, in the plan frame."""
        s, z = self._config.mouth
        return np.array([s + pose[0], z - pose[1], -pose[2]])

    def _total(self) -> FloatArray | None:
        """Return (3,) wrench of both grips on the segment about its origin, plan frame."""
        own, report, lost = self._grip.wrench, self._message, self._age > self._config.lost_time
        if own is None or report is None or lost:
            return None
        angle = float(self.target[2])
        own = self._config.master.about_segment(own, angle)
        return own + self._config.slave.about_segment(report, angle)

    def _contact(self, total: FloatArray | None) -> FloatArray | None:
        """Return (3,) wrench of the stage on the segment, in the guide's frame."""
        if total is None or self.stage in (Stage.CARRY, Stage.REST):
            return None
        f_s, f_z, moment = self._weight - total
        c, n = math.cos(self.target[2]), math.sin(self.target[2])
        return np.array([c * f_s + n * f_z, n * f_s - c * f_z, -moment])


class Slave(_Partner):
    """Controls its own grip by the master's set points and its own forces.

    Args:
        grip: Control of the slave's gripper.
        config: Agreement of master and slave.
    """

    def step(self, seen: Observation, heard: list[bytes]) -> tuple[Command, bytes | None]:
        """Return the arm's command and a message for the master, None if there is none.

        Without a new set point it extrapolates the last one by its rate for `lost_time`, and then
        holds; the forces stay controlled.

        Args:
            seen: Observation of the slave.
            heard: Messages of the master since the last step.

        Raises:
            RobotError: If joint angles are missing when it starts.
            ValueError: If a message is none of the two.
        """
        self._take(seen, heard, SET_POINT, self._config.latency)
        command = self._grip.hold(seen)
        if self._holding > 0:
            self._start(seen)
        if self._holding <= 0 and self._message is not None:
            command = self._follow(*np.split(self._message, 2))
        return command, self._encoded(REPORT, self._grip.wrench)

    def _follow(self, pose: FloatArray, rate: FloatArray) -> Command:
        """Return the command for a set point: pose (3,) and rate (3,) of the segment."""
        grip, most = self._config.slave, self._config.lost_time
        segment = pose + min(self._age, most) * rate
        moving = np.zeros(3) if self._age > most else rate
        return self._grip.command(grip.on(segment), grip.rate_on(segment, moving))
