"""A job of ch5-contact: the card is inserted into card guides until it has snapped in.

Three ways to do so from the same drawn misalignment: by force (`controllers.insertion.seating`),
straight ahead, and by a spiral search, as assembly robots search for a hole.
"""

import dataclasses
import enum
import math
from typing import Literal

import numpy as np

from controllers.insertion.guide import GuideConfig, Phase
from controllers.insertion.seating import SeatingConfig, SeatingGuide
from experiments.ch5.contact.bench import HandAsMade, HandBench
from models.card_and_slot.guides import build_guides_bench
from models.datasheets import CARD_AND_SLOT, CARD_GUIDE, DEGREE, FORCE_TORQUE, HAND
from perception.geometry.arrays import FloatArray
from twin.optics.realism import RealismName

Way = Literal["guided", "straight", "spiral"]
WAYS: tuple[Way, ...] = ("guided", "straight", "spiral")
"""Ways to insert the card."""
WIDEST = np.array([3e-3, 1e-3, 2e-3, 1.0 * DEGREE, 5.0 * DEGREE, 3.0 * DEGREE])
"""Widest misalignment: across, ahead, along the normal [m]; yaw, roll, turn [rad]. In the plane it
is three times what vision leaves; along the normal and in roll the card stays within the mouth."""
RINGS = (1, 2, 3)
"""Thirds of it."""
FRICTIONS = (0.1, 0.3, 0.5)
"""Coefficients of friction between card and slot."""
STAND_OFF, LIMIT, TARE = 0.015, 50.0, 0.5
"""Distance before the mouth at the start [m], longest insertion and time of the tare [s]."""
MOST_FORCE = 8.5
"""Force at which straight ahead and the spiral stop, and by force the card is drawn back from the
connector [N]."""
_NOISE = 0.02  # Of the wrench, as a share of it.
_SEATED = 1e-3
"""Distance from the bottom within which a card is seated [m]; twice that at its corners."""
_HAND = 22  # Stream of random numbers of the hand.


@dataclasses.dataclass(frozen=True)
class SeatingJob:
    """One insertion into card guides.

    Attributes:
        clearance: Distance of each of the card's edges from its groove [m].
        friction: Coefficient of friction between card and slot.
        ring: Which third of the widest misalignment, 1 to 3.
        way: How the card is inserted.
        seed: Seed of misalignment, hand and noise, the same for all ways.
        fine: Whether the physics have half the step, and contacts half the time constant.
        realism: How far the hand and its sensor are from their drawings.
    """

    clearance: float
    friction: float
    ring: int
    way: Way
    seed: int
    fine: bool = False
    realism: RealismName = "ideal"


@dataclasses.dataclass(frozen=True)
class SeatingResult:
    """How an insertion into card guides ended.

    Attributes:
        success: Whether the card is truly on the bottom, square; by force, and reported so.
        peak: Largest true contact force [N].
        snap: Force at which the card snapped in, as felt [N]; NaN without a report.
        seconds: Duration [s].
        depth: Depth of the middle of the leading edge [m].
        reason: Why it failed; empty if it did not.
    """

    success: bool
    peak: float
    snap: float
    seconds: float
    depth: float
    reason: str


class ByForce:
    """The guide, with the settings that the drawing gives it."""

    def __init__(self, start: FloatArray) -> None:
        sheet = CARD_AND_SLOT
        config = GuideConfig(sheet.card_width, sheet.friction, HAND.stiffness, tare=TARE)
        seating = SeatingConfig(CARD_GUIDE.depth, CARD_GUIDE.snap, CARD_GUIDE.mouth)
        self.guide = SeatingGuide(config, start, seating)

    @property
    def over(self) -> bool:
        """Whether the guide is over."""
        return self.guide.over

    def step(self, wrench: FloatArray) -> FloatArray:
        """Return (4,) across, ahead [m], turn [rad] and along the normal [m] for a wrench (6,)."""
        return np.append(self.guide.step(wrench), self.guide.beside)


class StraightAhead:
    """Straight ahead until the force, less its tare, is too large."""

    speed, period = 0.01, 0.01

    def __init__(self, start: FloatArray) -> None:
        self.over = False
        self._command = np.append(start, 0.0)
        self._free: list[FloatArray] = []

    def step(self, wrench: FloatArray) -> FloatArray:
        """Return the next command (4,) for a wrench (6,), held while the sensor's zero is taken."""
        if len(self._free) < round(TARE / self.period):
            self._free.append(wrench)
            return self._command.copy()
        force = (wrench - np.mean(self._free, axis=0))[:3]
        self.over = bool(np.linalg.norm(force) > MOST_FORCE)
        if not self.over:
            self._advance(force)
        return self._command.copy()

    def _advance(self, force: FloatArray) -> None:
        """Move the command: straight ahead."""
        self._command[1] += self.speed * self.period


class _Search(enum.Enum):
    """Part of a spiral search."""

    APPROACH = 0
    SEARCH = 1
    INSERT = 2


class BySpiral(StraightAhead):
    """A spiral over the mouth under a small push, then straight ahead.

    The usual blind search for a hole: an Archimedean spiral, until the card falls in.

    Attributes:
        push: Force of the push [N].
        pitch: Distance between turns of the spiral [m].
        drop: Depth below the place of the first touch at which the card has fallen in [m].
        along: Speed along the spiral [m/s].
        reach: Radius at which the search ends in vain [m].
        give: Admittance ahead, speed over force [m/s/N].
        mouth: Depth at which what leads in has ended, and the error ahead: a card that gets there
            needs no search [m].
    """

    push, pitch, drop, along, reach, give = 1.0, 1e-3, 2.5e-3, 0.008, 6e-3, 0.004
    mouth = 0.016

    def __init__(self, start: FloatArray) -> None:
        super().__init__(start)
        self._part, self._turned = _Search.APPROACH, 0.0
        self._middle, self._touched = self._command[[0, 3]].copy(), 0.0

    def _advance(self, force: FloatArray) -> None:
        depth = float(self._command[1] + force[1] / HAND.stiffness)
        if self._part is _Search.APPROACH and depth > self.mouth:
            self._part = _Search.INSERT
        elif self._part is _Search.APPROACH and -force[1] > self.push:
            self._part, self._touched = _Search.SEARCH, depth
        if self._part is not _Search.SEARCH:
            super()._advance(force)
            return
        radius = self.pitch * self._turned / (2.0 * math.pi)
        if depth > self._touched + self.drop:
            self._part = _Search.INSERT
        elif radius > self.reach:
            self.over = True
        self._turned += self.along * self.period / max(radius, 0.5 * self.pitch)
        self._command[[0, 3]] = self._middle + radius * np.array(
            [math.cos(self._turned), math.sin(self._turned)]
        )
        self._command[1] += self.period * self.give * (self.push + force[1])


_INSERTERS: dict[Way, type[ByForce | StraightAhead]] = {
    "guided": ByForce,
    "straight": StraightAhead,
    "spiral": BySpiral,
}


def draw_misalignment(job: SeatingJob, rng: np.random.Generator) -> FloatArray:
    """Draw a misalignment (6,) within the job's ring, each part to either side."""
    low, high = (job.ring - 1) / len(RINGS), job.ring / len(RINGS)
    return WIDEST * rng.uniform(low, high, 6) * rng.choice([-1.0, 1.0], 6)


def run_seating(job: SeatingJob) -> SeatingResult:
    """Insert the card once from a drawn misalignment."""
    rng = np.random.default_rng([job.seed, job.ring, round(job.clearance * 1e6)])
    wrong = draw_misalignment(job, rng)
    start = np.array([0.0, -STAND_OFF, 0.0])
    bench, inserter = _bench(job), _INSERTERS[job.way](start)
    bench.put(_in_space(np.append(start, 0.0)) + wrong)
    peak, period = 0.0, 0.01
    sigma = np.repeat([FORCE_TORQUE.force_noise, FORCE_TORQUE.torque_noise], 3)
    for _ in range(round(LIMIT / period)):
        felt = bench.felt
        felt = felt * (1.0 + _NOISE * rng.normal(size=6)) + sigma * rng.normal(size=6)
        bench.move(_in_space(inserter.step(felt)) + wrong)
        peak = max(peak, bench.step(period))
        if inserter.over:
            break
    card = bench.data.body("card")
    aside = card.xmat.reshape(3, 3)[:, 0] * CARD_AND_SLOT.card_width / 2.0
    depth = float(card.xpos[1])
    seated = depth - abs(aside[1]) > CARD_GUIDE.depth - 2.0 * _SEATED
    seated &= depth > CARD_GUIDE.depth - _SEATED
    snap, reason, reported = math.nan, "" if seated else "not seated", True
    if isinstance(inserter, ByForce):
        guide = inserter.guide
        snap, reported = guide.snap_force, guide.phase is Phase.DONE
        reason = reason if reported else guide.reason
    success = bool(seated and reported)
    return SeatingResult(success, peak, snap, bench.data.time, depth, reason)


def _bench(job: SeatingJob) -> HandBench:
    """Return the bench of a job, whose hand does not depend on what is done with it."""
    model = build_guides_bench(job.clearance, job.friction).compile()
    if job.fine:
        model.opt.timestep /= 2.0
        model.geom_solref[:, 0] /= 2.0
    hand = HandAsMade.drawn_from(job.realism, np.random.default_rng([job.seed, _HAND]))
    return HandBench(model, hand)


def _in_space(command: FloatArray) -> FloatArray:
    """Return a command (4,) as a pose of the hand (6,)."""
    across, ahead, turn, beside = command
    return np.array([across, ahead, beside, 0.0, 0.0, turn])
