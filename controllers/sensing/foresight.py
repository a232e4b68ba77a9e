"""How far predictions of a robot come out beside what is measured then: bands that are learned.

A model predicts worse than its sensors' noise says, by what it does not have. How much worse was
seen of the predictions before, of each reading and kind of motion: that is the band of the next.
"""

import dataclasses

import numpy as np

from controllers.sensing.changes import KINDS
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers


@dataclasses.dataclass(frozen=True)
class ForesightConfig:
    """How bands are learned.

    Attributes:
        least: Predictions of a kind of motion before a band is stated.
        memory: Predictions after which what was learned is forgotten to 1/e.
    """

    least: int = 10
    memory: float = 100.0

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        check_numbers("foresight", self, "least", "memory")


class Foresight:
    """Learns the bands of one robot's predictions.

    Args:
        config: How; None for the default.

    Attributes:
        nees: Squared errors over the bands' variances, a mean over the readings for each prediction
            that had a band.
    """

    def __init__(self, config: ForesightConfig | None = None) -> None:
        self._config = config or ForesightConfig()
        self._squares: list[FloatArray | None] = [None] * KINDS
        self._counts: list[FloatArray | None] = [None] * KINDS
        self.nees: list[float] = []

    def band(self, kind: int) -> FloatArray | None:
        """Return the standard deviations (n,) of a prediction, NaN where not known; None for none.

        Args:
            kind: Kind of motion, below `controllers.sensing.changes.KINDS`.
        """
        squares, counts = self._squares[kind], self._counts[kind]
        if squares is None or counts is None:
            return None
        # A reading that never erred sticks, and says nothing of how far the next one will err.
        known = (counts >= self._config.least) & (squares > 0.0)
        return np.sqrt(np.where(known, squares, np.nan))

    def add(self, errors: FloatArray, kind: int) -> None:
        """Take a prediction.

        Args:
            errors: (n,) measured less predicted; NaN for what was not measured.
            kind: Kind of motion, as of `band`.
        """
        squares, counts = self._squares[kind], self._counts[kind]
        if squares is None or counts is None:
            squares, counts = np.zeros((2, len(errors)))
        there, band = np.isfinite(errors), self.band(kind)
        if band is not None:
            ratios = np.square(errors / band)
            if np.isfinite(ratios).any():
                self.nees.append(float(np.nanmean(ratios)))
        counts = counts + there
        share = np.where(there, 1.0 / np.clip(counts, 1.0, self._config.memory), 0.0)
        squares = squares + share * (np.square(np.nan_to_num(errors)) - squares)
        self._squares[kind], self._counts[kind] = squares, counts
