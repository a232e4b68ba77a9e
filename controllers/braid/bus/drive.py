"""Open-loop drive of BRAID's muscle wires from one word to another (Thesis E.4).

A leg changes when the bundle that extends or retracts it is heated for a while; its detent holds
it afterwards without power. Nothing is sensed. Legs are heated in groups, since a group takes its
power at once, from the tip to the base: what is switched later then carries a settled load. Before
the next word the wires must cool, or they would still pull against their antagonists.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from controllers.braid.arm.stage import LEGS, STATES
from perception.geometry.arrays import FloatArray, IntArray

EXTEND, RETRACT = 0, 1
"""Places of a leg's bundles in the last axis of `WireDrive.levels`."""


@dataclasses.dataclass(frozen=True)
class DriveConfig:
    """Times of the drive.

    Attributes:
        heating: Time for which a group is heated [s].
        cooling: Rest after the last group [s].
        at_once: Number of legs in a group.
    """

    heating: float = 1.1
    cooling: float = 1.9
    at_once: int = LEGS

    def __post_init__(self) -> None:
        """Refuse what would never change a leg.

        Raises:
            ValueError: Naming the number.
        """
        if not (np.isfinite(self.heating) and self.heating > 0.0):
            raise ValueError(f"heating {self.heating}: expected a positive time [s]")
        if not (np.isfinite(self.cooling) and self.cooling >= 0.0):
            raise ValueError(f"cooling {self.cooling}: expected 0 or more [s]")
        if self.at_once < 1:
            raise ValueError(f"at_once {self.at_once}: expected at least 1 leg")


def word_bits(word: IntArray) -> NDArray[np.bool_]:
    """Return (n, 3) which legs of a word (n,) are long.

    Raises:
        ValueError: If a state is not 0 to 7.
    """
    word = np.asarray(word, dtype=np.int64)
    if word.ndim != 1 or word.size == 0 or not (word.min() >= 0 and word.max() < STATES):
        raise ValueError(f"word {word.tolist()}: expected states 0 to {STATES - 1}, base first")
    return (word[:, None] >> np.arange(LEGS)) & 1 == 1


class WireDrive:
    """Heats the wires that a change of word needs.

    Attributes:
        word: (n,) states that the arm has, or will have after this change.
        duration: Duration of the change under way, cooling included [s].
        groups: m arrays (k, 2), stage and leg of what is heated together, in order.
    """

    def __init__(self, word: IntArray, config: DriveConfig | None = None) -> None:
        """Begin with an arm at rest.

        Args:
            word: (n,) states that it rests in.
            config: Times of the drive.

        Raises:
            ValueError: If a state is not 0 to 7.
        """
        self._long = word_bits(word)
        self.word = np.asarray(word, dtype=np.int64).copy()
        self.groups: list[NDArray[np.int64]] = []
        self._config = config or DriveConfig()

    @property
    def duration(self) -> float:
        """Time that the last change takes, cooling included [s]."""
        if not self.groups:
            return 0.0
        return len(self.groups) * self._config.heating + self._config.cooling

    def change(self, word: IntArray) -> None:
        """Begin to go to another word; the change before must be over.

        Raises:
            ValueError: If a state is not 0 to 7, or the number of stages differs.
        """
        wanted = word_bits(word)
        if len(wanted) != len(self.word):
            raise ValueError(f"word of {len(wanted)} stages: expected {len(self.word)}")
        changed = np.argwhere(wanted != self._long)[::-1]
        step = self._config.at_once
        self.groups = [changed[i : i + step] for i in range(0, len(changed), step)]
        self._long = wanted
        self.word = np.asarray(word, dtype=np.int64).copy()

    def levels(self, time: float) -> FloatArray:
        """Return the share of the rated current that each bundle gets.

        Args:
            time: Time since `change` [s].

        Returns:
            (n, 3, 2) 0 or 1, extending and retracting bundle of each leg.
        """
        levels = np.zeros((len(self.word), LEGS, 2))
        turn = math.floor(time / self._config.heating)
        if 0 <= turn < len(self.groups):
            for stage, leg in self.groups[turn]:
                levels[stage, leg, EXTEND if self._long[stage, leg] else RETRACT] = 1.0
        return levels
