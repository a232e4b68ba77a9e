"""What may go wrong in an insertion, put between the robots and their controllers."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping

import numpy as np

from controllers.insertion.card_inserter import InsertionStage
from experiments.ch5.insertion_scene import MASTER, SLAVE
from twin.robot import MISSING, Channel, ImageChannel, Observation, Validity


class Fault(enum.Enum):
    """What goes wrong."""

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


@dataclasses.dataclass
class FaultyEyes:
    """Changes observations as a fault has it.

    Attributes:
        fault: What goes wrong; None for nothing.
    """

    fault: Fault | None

    def __post_init__(self) -> None:
        """Nothing has begun."""
        self._since = 0.0
        self._stage: InsertionStage | None = None
        self._frozen: Channel | None = None

    def outage(self, time: float, stage: InsertionStage) -> bool:
        """Say whether the radio is silent now."""
        return self.fault is Fault.RADIO and 0.0 <= self._age(time, stage) < _SHORT

    def change(
        self, observations: Mapping[str, Observation], stage: InsertionStage
    ) -> Mapping[str, Observation]:
        """Return what the robots observe under the fault.

        Args:
            observations: Of both, as they are.
            stage: Of the slave.
        """
        if self.fault is None:
            return observations
        master, slave = observations[MASTER], observations[SLAVE]
        age = self._age(slave.time, stage)
        if age >= 0.0:
            master, slave = self._eyes(master, age), self._senses(slave, age)
        return {MASTER: master, SLAVE: slave}

    def _age(self, time: float, stage: InsertionStage) -> float:
        """Return the time since the fault began; negative before."""
        assert self.fault is not None
        begin = BEGINS[self.fault]
        if begin is None:
            return time
        if self._stage is None and stage is begin:
            self._stage, self._since = stage, time + AFTER
        return time - self._since if self._stage is not None else -1.0

    def _eyes(self, seen: Observation, age: float) -> Observation:
        stereo = seen.stereo
        if not stereo.usable:
            return seen
        if self.fault in (Fault.BLACK, Fault.LOST) or (self.fault is Fault.HIDDEN and age < _SHORT):
            black = ImageChannel.deferred(
                lambda: np.zeros_like(stereo.value, np.uint8), stereo.stamp
            )
            return seen._replace(stereo=black)
        if self.fault is Fault.FROZEN:
            self._frozen = self._frozen or stereo
            # New stamps on an old picture: the worst way to freeze.
            return seen._replace(stereo=self._frozen._replace(stamp=stereo.stamp))
        return seen

    def _senses(self, seen: Observation, age: float) -> Observation:
        if self.fault is Fault.TILT:
            return seen._replace(inclinometer=MISSING)
        if self.fault is Fault.WRENCH:
            return seen._replace(arm_base_wrench=MISSING)
        if self.fault is Fault.SPIKE and age % _SPIKE_EVERY < 0.5e-2:
            wrench = np.asarray(seen.arm_base_wrench.value, dtype=float) + _SPIKE
            return seen._replace(
                arm_base_wrench=Channel(wrench, seen.arm_base_wrench.stamp, Validity.MEASURED)
            )
        return seen
