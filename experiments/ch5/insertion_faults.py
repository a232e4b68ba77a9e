"""Faults of an insertion, injected between the robots and their controllers."""

import enum
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np

from controllers.insertion.card_inserter import InsertionStage
from experiments.ch5.insertion_scene import MASTER
from twin.link import Link, Polled
from twin.robot import MISSING, Channel, ImageChannel, Observation, Robot, Validity


class Fault(enum.Enum):
    """Faults that can happen."""

    BLACK = "black images"
    HIDDEN = "markers hidden for 2 s"
    LOST = "markers lost for good"
    FROZEN = "camera frozen"
    TILT = "inclinometer lost"
    WRENCH = "wrench lost in contact"
    SPIKE = "wrench spike"
    RADIO = "radio out for 2 s"


BEGINS: Mapping[Fault, InsertionStage | None] = {
    Fault.BLACK: None,
    Fault.HIDDEN: InsertionStage.APPROACH,
    Fault.LOST: InsertionStage.APPROACH,
    Fault.FROZEN: InsertionStage.APPROACH,
    Fault.TILT: InsertionStage.APPROACH,
    Fault.WRENCH: InsertionStage.INSERT,
    Fault.SPIKE: InsertionStage.INSERT,
    Fault.RADIO: InsertionStage.APPROACH,
}
"""InsertionStage of the slave in which a fault begins; None for from the start."""
ENDS_IN: Mapping[Fault, tuple[bool, str]] = {
    Fault.BLACK: (False, "target not seen"),
    Fault.HIDDEN: (True, ""),
    Fault.LOST: (False, "target not seen"),
    Fault.FROZEN: (False, "target not seen"),
    Fault.TILT: (True, ""),
    Fault.WRENCH: (False, "arm_base_wrench missing"),
    Fault.SPIKE: (True, ""),
    Fault.RADIO: (True, ""),
}
"""How a fault has to end: inserted or not, and how the reason begins."""
AFTER = 1.5
"""From the begin of the stage to that of the fault [s]."""
_SHORT = 2.0
_SPIKE = np.array([40.0, -60.0, 50.0, 5.0, 3.0, 2.0])
"""On one sample [N, N m]."""
_SPIKE_EVERY = 0.5


class FaultInjector:
    """Changes what robots observe and receive under a fault.

    Args:
        fault: Fault that happens.
        stage: Returns the slave's present stage.
        clock: Returns robot time [s].
    """

    def __init__(
        self, fault: Fault, stage: Callable[[], InsertionStage], clock: Callable[[], float]
    ) -> None:
        self._fault, self._stage, self._clock = fault, stage, clock
        self._since: float | None = None
        self._frozen: Channel | None = None

    def robots(self, robots: Mapping[str, Robot]) -> dict[str, Robot]:
        """Return robots whose sensors suffer from the fault."""
        return {
            name: cast(Robot, _FaultyRobot(robot, functools.partial(self.observed, name)))
            for name, robot in robots.items()
        }

    def links(self, links: Mapping[str, Link]) -> dict[str, Link]:
        """Return ends of the radio that suffer from the fault."""
        return {name: _FaultyLink(link, self.outage) for name, link in links.items()}

    def outage(self) -> bool:
        """Return whether the radio is silent now."""
        return self._fault is Fault.RADIO and 0.0 <= self._age(self._clock()) < _SHORT

    def observed(self, robot: str, seen: Observation) -> Observation:
        """Return what a robot observes under the fault.

        Args:
            robot: Name of the robot.
            seen: Observation without the fault.
        """
        age = self._age(self._clock())  # A robot's own clock may be off.
        if age < 0.0:
            return seen
        return self._eyes(seen, age) if robot == MASTER else self._senses(seen, age)

    def _age(self, time: float) -> float:
        """Return the time since the fault began; negative before."""
        begin = BEGINS[self._fault]
        if begin is None:
            return time
        if self._since is None and self._stage() is begin:
            self._since = time + AFTER
        return time - self._since if self._since is not None else -1.0

    def _eyes(self, seen: Observation, age: float) -> Observation:
        stereo, lasts = seen.stereo, _SHORT if self._fault is Fault.HIDDEN else math.inf
        if not stereo.usable:
            return seen
        if self._fault in (Fault.BLACK, Fault.LOST, Fault.HIDDEN) and age < lasts:
            stereo = ImageChannel.deferred(
                lambda: np.zeros_like(seen.stereo.value, np.uint8), stereo.stamp
            )
        elif self._fault is Fault.FROZEN:
            self._frozen = self._frozen or stereo
            # New stamps on an old picture: the hardest freeze to notice.
            stereo = self._frozen._replace(stamp=stereo.stamp)
        return seen._replace(stereo=stereo)

    def _senses(self, seen: Observation, age: float) -> Observation:
        if self._fault is Fault.TILT:
            return seen._replace(inclinometer=MISSING)
        if self._fault is Fault.WRENCH:
            return seen._replace(arm_base_wrench=MISSING)
        if self._fault is Fault.SPIKE and age % _SPIKE_EVERY < 0.5e-2:
            wrench = np.asarray(seen.arm_base_wrench.value, dtype=float) + _SPIKE
            return seen._replace(
                arm_base_wrench=Channel(wrench, seen.arm_base_wrench.stamp, Validity.MEASURED)
            )
        return seen


class _FaultyRobot:
    """A robot with other observations."""

    def __init__(self, robot: Robot, observed: Callable[[Observation], Observation]) -> None:
        self._robot, self._observed = robot, observed

    def observe(self) -> Observation:
        """Return the changed observation."""
        return self._observed(self._robot.observe())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)


class _FaultyLink:
    """An end of the radio that is silent at times: what is sent or arrives then is lost."""

    def __init__(self, link: Link, outage: Callable[[], bool]) -> None:
        self._link, self._outage = link, outage

    def send(self, message: bytes) -> int:
        """Queue a message as the link does."""
        return self._link.send(message)

    def send_latest(self, message: bytes) -> None:
        """Send a value, unless the radio is silent."""
        if not self._outage():
            self._link.send_latest(message)

    def poll(self) -> Polled:
        """Return what has arrived, unless the radio is silent."""
        polled = self._link.poll()
        return Polled([], []) if self._outage() else polled
