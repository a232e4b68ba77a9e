"""Force-guided insertion: motion in the direction of least resistance (Thesis section A.4).

The guide uses the wrench at the hand, its own commands, and shape, friction and stiffness; never
the slot's true pose. Poses (x, y, theta) are of the card in the estimated frame of the slot, y into
the slot. It needs no vision once it has begun.

- A force against the leading edge before the card is in: hold it at a small push, and slide away
  from the side where the line of action meets the edge (states 1 and 3).
- A force across the card: yield along it, and turn by the moment of the normal forces alone
  about the middle of the inserted part (states 2, 5 and 6). The moment of friction is subtracted
  first: with it a card that touches a wall with one corner would turn into the wall.
- Inside a deadband the command does not yield, so that noise does not make the card drift.
- Held free at the start, the sensor shows its zero; that is taken off all that follows.
"""

import dataclasses
import enum
import math

import numpy as np

from controllers.insertion.contact import turn
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers

_MEDIAN = 3  # Samples of the median filter: one bad sample is no contact.


class Phase(enum.Enum):
    """Phase of an insertion."""

    APPROACH = "approach"
    SLIDE = "slide"
    INSERT = "insert"
    RETREAT = "retreat"
    SEAT = "seat"
    DONE = "done"
    FAILED = "failed"


@dataclasses.dataclass(frozen=True)
class GuideConfig:
    """Shape, friction, stiffness, gains and limits of the insertion by force.

    Attributes:
        card_width: Width of the card, across [m].
        friction: Coulomb coefficient between card and slot.
        stiffness: Stiffness of hand, arm and base along an axis, nominal or identified [N/m].
        depth: Depth at which the card is seated [m].
        period: Sampling period of the wrench [s].
        speed: Speed of the insertion in free motion [m/s].
        slide_speed: Speed along the face [m/s].
        push: Force held against the face [N].
        deadband: Force below which the command does not yield [N].
        moment_deadband: Moment below which the command does not yield [N m].
        give: Admittance, speed across the card over force [m/s/N].
        give_turn: Admittance, turning rate over moment [rad/s/(N m)].
        turn_rate: Largest turning rate [rad/s].
        slow_force: Force at which the insertion's speed falls to zero [N].
        force_limit: Force at which the card is drawn back [N].
        filter_time: Time constant of the wrench's low pass [s].
        steepest: Largest expected angle of the card [rad].
        jam_time: Time without progress that counts as a jam [s].
        progress: Least advance that counts as progress [m].
        retreat: Distance drawn back after a jam [m].
        retries: Largest number of further attempts.
        reach: Largest distance across from the start [m].
        turn_reach: Largest turn from the start [rad].
        lost_time: Time without a wrench after which the guide gives up [s].
        timeout: Time after which the guide gives up [s].
        tare: Time for which the card is held at the start, free, to take the sensor's zero [s]; 0
            for a wrench that is tared.
    """

    card_width: float
    friction: float
    stiffness: float
    depth: float = 0.035
    period: float = 0.01
    speed: float = 0.01
    slide_speed: float = 0.005
    push: float = 1.0
    deadband: float = 0.3
    moment_deadband: float = 0.02
    give: float = 0.004
    give_turn: float = 2.0
    turn_rate: float = 0.1
    slow_force: float = 2.5
    force_limit: float = 4.0
    filter_time: float = 0.03
    steepest: float = math.radians(8.0)
    jam_time: float = 2.0
    progress: float = 5e-4
    retreat: float = 0.008
    retries: int = 3
    reach: float = 0.012
    turn_reach: float = math.radians(10.0)
    lost_time: float = 0.5
    timeout: float = 45.0
    tare: float = 0.0

    def __post_init__(self) -> None:
        """Refuse values out of range.

        Raises:
            ValueError: Naming the field.
        """
        check_numbers("guide", self, zero=True)
        check_numbers("guide", self, "card_width", "stiffness", "period", "speed", "force_limit")


class InsertionGuide:
    """Commands the card's pose from the measured wrench, one step each period.

    Args:
        config: Shape, friction, stiffness, gains and limits.
        start: (3,) initial commanded pose, in front of the slot [m, m, rad].

    Attributes:
        config: Shape, friction, stiffness, gains and limits.
        phase: Phase of the insertion.
        reason: Reason of the last retreat or failure; empty without one.
        tries: Number of further attempts so far.
        command: (3,) commanded pose [m, m, rad].

    Raises:
        ValueError: If the start is not three finite numbers.
    """

    def __init__(self, config: GuideConfig, start: FloatArray) -> None:
        if np.shape(start) != (3,) or not np.all(np.isfinite(start)):
            raise ValueError(f"start {start}: expected three finite numbers")
        self.config = config
        self.phase, self.reason, self.tries = Phase.APPROACH, "", 0
        self._start = np.array(start, dtype=float)
        self.command = self._start.copy()
        self._recent: list[FloatArray] = []
        self._wrench = np.zeros(3)
        self._time = self._since = self._lost = self._load = 0.0
        self._deepest, self._goal_back, self._slid = float(start[1]), 0.0, 0.0
        self._share = config.period / (config.period + config.filter_time)
        self._free: list[FloatArray] = []
        self._zero = np.zeros(3)

    @property
    def over(self) -> bool:
        """Whether the insertion has ended, in DONE or FAILED."""
        return self.phase in (Phase.DONE, Phase.FAILED)

    def step(self, wrench: FloatArray | None) -> FloatArray:
        """Process a wrench and return the next command.

        Args:
            wrench: (3,) wrench by the slot on the card, card's frame, about the middle of the
                leading edge [N, N, N m]; None or not finite where the sensor gave none.

        Returns:
            (3,) commanded pose of the card; held once the guide is over, and while the wrench is
            missing.
        """
        self._time += self.config.period
        if wrench is not None and not np.all(np.isfinite(wrench)):
            wrench = None
        if self.config.tare > 0.0 and self._time <= self.config.tare + 0.5 * self.config.period:
            if wrench is not None:
                self._free.append(np.asarray(wrench, dtype=float))
                self._zero = np.mean(self._free, axis=0)
            self._since = self._time
        elif not self.over:
            self._advance(None if wrench is None else wrench - self._zero)
        return self.command.copy()

    def _advance(self, wrench: FloatArray | None) -> None:
        """Choose phase and motion from a wrench."""
        if wrench is None:
            self._lost += self.config.period
            if self._lost >= self.config.lost_time:
                self._fail("no wrench")
            return
        self._lost = 0.0
        self._sense(wrench)
        if self._time > self.config.timeout:
            self._fail("out of time")
        else:
            self._choose()
        if not self.over:
            self._move()

    def believed(self) -> FloatArray:
        """Return (3,) the card's estimated pose: the command plus the deflection of the hand."""
        pose = self.command.copy()
        pose[:2] += turn(pose[2]) @ self._wrench[:2] / self.config.stiffness
        return pose

    def _sense(self, wrench: FloatArray) -> None:
        self._recent = [*self._recent[1 - _MEDIAN :], wrench]
        middle = np.median(self._recent, axis=0)
        self._wrench += self._share * (middle - self._wrench)
        self._load = math.hypot(middle[0], middle[1])

    def _choose(self) -> None:
        """Choose the phase of this step."""
        config, depth = self.config, float(self.believed()[1])
        if self.phase is Phase.RETREAT:
            if self.command[1] <= self._goal_back:
                self.phase = Phase.APPROACH
                self._deepest, self._since = depth, self._time
            return
        if depth >= config.depth:
            self.phase = Phase.DONE
            return
        if depth > self._deepest + config.progress:
            self._deepest, self._since = depth, self._time
        force_x, force_y = self._wrench[:2]
        outside = depth < config.card_width / 2.0 * math.sin(config.steepest) + 1e-3
        ahead = -force_y > max(config.deadband, abs(force_x))
        if self._load > config.force_limit:
            self._draw_back("force")
        elif self.phase is not Phase.SLIDE and self._time - self._since > config.jam_time:
            self._draw_back("jam")
        elif outside and ahead:
            self.phase = Phase.SLIDE
            self._since = self._time
        else:
            self.phase = Phase.APPROACH if outside else Phase.INSERT

    def _draw_back(self, reason: str) -> None:
        """Retreat for another attempt, or fail after the last one."""
        self.tries += 1
        if self.tries > self.config.retries:
            self._fail(reason)
            return
        self.phase, self.reason = Phase.RETREAT, reason
        self._goal_back = min(float(self.command[1]), self._deepest) - self.config.retreat
        # The next attempt starts a little farther in the direction of the last slide.
        self.command[0] += math.copysign(1e-3, self._slid) if self._slid else 0.0

    def _fail(self, reason: str) -> None:
        self.phase, self.reason = Phase.FAILED, reason

    def _move(self) -> None:
        """Add this step's motion to the command."""
        config = self.config
        # Without yielding, an elastically deflected card would spring aside and hit the slot.
        across, ahead, rate = self._give_aside(), -config.speed, 0.0
        if self.phase is Phase.SLIDE:
            across, ahead = self._slide()
        elif self.phase is not Phase.RETREAT:
            rate, ahead = self._turn_away(), self._advance_speed()
        step = turn(self.command[2]) @ [across, ahead]
        self.command += config.period * np.array([step[0], step[1], rate])
        moved = self.command - self._start
        if abs(moved[0]) > config.reach or abs(moved[2]) > config.turn_reach:
            self.command[[0, 2]] -= config.period * np.array([step[0], rate])
            self._fail("out of reach")

    def _advance_speed(self) -> float:
        """Return the speed ahead, which falls with the load."""
        config, load = self.config, math.hypot(self._wrench[0], self._wrench[1])
        free = 1.0 - max(load - config.deadband, 0.0) / config.slow_force
        return config.speed * max(free, 0.0)

    def _slide(self) -> tuple[float, float]:
        """Return speeds across and ahead that hold the push and slide off the face."""
        _, force_y, moment = self._wrench
        self._slid = -math.copysign(1.0, moment / force_y)
        held = (self.config.push + force_y) * self.config.give
        return self._slid * self.config.slide_speed, held

    def _turn_away(self) -> float:
        """Return the turning rate that relieves the forces on the sides."""
        config = self.config
        force_x, _, moment = self._wrench
        depth = max(float(self.believed()[1]), 0.0)
        # Sliding in, each side's friction is mu N backward, half a width from the middle; both
        # together turn by mu f_x times that. The rest is the moment of the normal forces.
        normal = moment - config.friction * config.card_width / 2.0 * force_x
        about = normal - depth / 2.0 * force_x
        return self._turn_by(about)

    def _turn_by(self, moment: float) -> float:
        """Return the turning rate that yields to a moment."""
        config = self.config
        rate = config.give_turn * beyond(moment, config.moment_deadband)
        return min(max(rate, -config.turn_rate), config.turn_rate)

    def _give_aside(self) -> float:
        """Return the speed across that relieves the forces on the sides."""
        return self.config.give * beyond(self._wrench[0], self.config.deadband)


class StraightInsertion(InsertionGuide):
    """Insertion without guidance: straight ahead, and stop at the same limit of force."""

    def _advance(self, wrench: FloatArray | None) -> None:
        config = self.config
        if wrench is None:
            self._fail("no wrench")
        elif math.hypot(wrench[0], wrench[1]) > config.force_limit:
            self._fail("force")
        elif self.command[1] >= config.depth + config.push / config.stiffness:
            self.phase = Phase.DONE
        else:
            self._go_on()

    def _go_on(self) -> None:
        """Move the command straight ahead."""
        config = self.config
        self.command[:2] += turn(self.command[2]) @ [0.0, config.speed * config.period]


def beyond(value: float, deadband: float) -> float:
    """Return the part of a value beyond a deadband around zero."""
    return math.copysign(max(abs(value) - deadband, 0.0), value)
