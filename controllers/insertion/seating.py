"""Force guidance into card guides, until the card has snapped into its connector.

As `guide.InsertionGuide` within the plane of the card. Out of it the card gives way along its
normal, by which the hand follows what the guides' lips press; in roll its gripper gives way by
itself. Before the connector a push grows until the force falls at once, the snap, and then until
the bottom bears it.
"""

import dataclasses
import math

import numpy as np

from controllers.insertion.guide import (
    GuideConfig,
    InsertionGuide,
    Phase,
    StraightInsertion,
    beyond,
)
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers

_BEARING = 1.5  # Rise of the force over that which shows the bottom at which the push stays.
_SLIPPERY = 1e-3  # Double the friction below which edges that jam do so without a sign [-].
_NEAR = 0.006  # Distance before the bottom from which on a push is that of the connector [m].


@dataclasses.dataclass(frozen=True)
class SeatingConfig:
    """What the connector asks for, and how the card gives way along its normal.

    Attributes:
        bottom: Depth at which the bottom stops the card [m].
        snap: Force at which the connector lets the card in, as drawn [N].
        mouth: Distance along the normal, each way, at which the guides take in a card's edge [m].
        push: Largest force of the push [N].
        fall: Share of its peak by which a force falls that snaps.
        bottom_force: Rise of the force by which the bottom then shows itself [N].
        square: Largest distance of that force from the middle of a card that stands on it [m].
        speed: Speed before the connector [m/s].
        give: Admittance along the normal, speed over force [m/s/N].
        deadband: Force along the normal below which the command does not yield [N].
        reach: Largest distance along the normal from the start [m].
    """

    bottom: float
    snap: float
    mouth: float
    push: float = 7.0
    fall: float = 0.5
    bottom_force: float = 3.0
    square: float = 0.007
    speed: float = 0.004
    give: float = 0.004
    deadband: float = 0.2
    reach: float = 0.008

    def __post_init__(self) -> None:
        """Refuse values out of range.

        Raises:
            ValueError: Naming the field.
        """
        check_numbers("seating", self)


class SeatingGuide(InsertionGuide):
    """Commands the card's pose from the measured wrench, until it is seated.

    `step` takes all six of the wrench, about the middle of the leading edge.

    Args:
        config: Insertion within the plane.
        start: (3,) initial commanded pose, in front of the slot [m, m, rad].
        seating: What the connector asks for.
        beside: Initial commanded position along the normal [m].

    Attributes:
        seating: What the connector asks for.
        beside: Commanded position along the normal [m].
        snap_force: Force at which the card has snapped in [N]; NaN before.
    """

    def __init__(
        self, config: GuideConfig, start: FloatArray, seating: SeatingConfig, beside: float = 0.0
    ) -> None:
        super().__init__(config, start)
        self.seating, self.beside, self.snap_force = seating, beside, math.nan
        self._first_beside = beside
        self._zero = np.zeros(6)
        self._beside_force = self._peak = self._least = self._moment = 0.0

    def _sense(self, wrench: FloatArray) -> None:
        super()._sense(wrench[[0, 1, 5]])
        self._beside_force += self._share * (wrench[2] - self._beside_force)

    def _choose(self) -> None:
        """Choose the phase of this step; before the connector it is its own."""
        # Once there it stays: on soft springs the push would seem to bend the hand out again.
        near = self.phase is Phase.SEAT or self.believed()[1] > self.seating.bottom - _NEAR
        if self.phase is Phase.RETREAT or not near:
            self._peak = 0.0
            super()._choose()
            return
        self.phase, seating = Phase.SEAT, self.seating
        push = -float(self._wrench[1])
        snapped = not math.isnan(self.snap_force)
        if push < self._least:
            self._least, self._moment = push, float(self._wrench[2])
        if self._load > seating.push + 0.5 * seating.snap:
            self._draw_back("force")
        elif snapped:
            rise, moment = push - self._least, abs(self._wrench[2] - self._moment)
            if rise <= seating.bottom_force:
                self._since = self._time
            elif moment < seating.square * rise:
                self.phase = Phase.DONE
            elif self._time - self._since > self.config.jam_time:
                self._draw_back("jam")
        else:
            self._peak = max(self._peak, self._load)
            if self._peak > 0.5 * seating.snap and push < (1.0 - seating.fall) * self._peak:
                self.snap_force, self._least = self._peak, push
                self._moment = float(self._wrench[2])
            elif push > seating.push:
                self._draw_back("force")

    def _draw_back(self, reason: str) -> None:
        """Retreat, by which a card that had snapped in comes out again."""
        super()._draw_back(reason)
        self.snap_force = math.nan

    def _move(self) -> None:
        super()._move()
        seating = self.seating
        if not self.over:
            rate = seating.give * beyond(self._beside_force, seating.deadband)
            self.beside += rate * self.config.period
        if abs(self.beside - self._first_beside) > seating.reach:
            self._fail("out of reach")

    def _turn_away(self) -> float:
        """Return the turning rate; of a card that has snapped in, by what the bottom adds."""
        if math.isnan(self.snap_force):
            return super()._turn_away()
        return self._turn_by(float(self._wrench[2]) - self._moment)

    def _turn_by(self, moment: float) -> float:
        """Return the turning rate that yields to a moment, as far as forces explain it.

        A sensor half a metre behind the card errs by a tenth of a newton metre as the arm reaches
        out. Two edges that jam press with opposite forces, which friction along them betrays.
        """
        config, depth = self.config, max(float(self.believed()[1]), 0.0)
        lever = config.card_width / 2.0 + depth / max(2.0 * config.friction, _SLIPPERY)
        load = math.hypot(self._wrench[0], self._wrench[1])
        most = lever * max(load - config.deadband, 0.0)
        return super()._turn_by(min(max(moment, -most), most))

    def _advance_speed(self) -> float:
        """Return the speed ahead: up to the snap it does not fall with the push.

        Behind it does, so that a crooked card has time to turn onto the bottom.
        """
        if self.phase is not Phase.SEAT:
            return super()._advance_speed()
        if math.isnan(self.snap_force):
            return self.seating.speed
        share = (-float(self._wrench[1]) - self._least) / (_BEARING * self.seating.bottom_force)
        return self.seating.speed * max(1.0 - share, 0.0)


class StraightSeating(StraightInsertion):
    """Straight ahead until a force; the card counts as seated if it is commanded to the bottom.

    `step` takes all six of the wrench, as that of `SeatingGuide`.

    Args:
        config: Speed and period.
        start: (3,) initial commanded pose, in front of the slot [m, m, rad].
        seating: Bottom and largest push.
        beside: Commanded position along the normal [m].

    Attributes:
        beside: Commanded position along the normal [m].
    """

    def __init__(
        self, config: GuideConfig, start: FloatArray, seating: SeatingConfig, beside: float = 0.0
    ) -> None:
        super().__init__(config, start)
        self.beside, self._seating = beside, seating
        self._zero = np.zeros(6)

    def _advance(self, wrench: FloatArray | None) -> None:
        if wrench is None:
            self._fail("no wrench")
        elif np.linalg.norm(wrench[:3]) <= self._seating.push:
            self._go_on()
        elif self.command[1] >= self._seating.bottom:
            self.phase = Phase.DONE
        else:
            self._fail("force")
