"""The slope of even ground, by what the twin of a rover takes for it where it drives.

That is off by a tilt of the rover's own, as of a spring that is softer than drawn. The slope stays
as the rover turns, while its own tilt turns with it.
"""

import cmath

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.servo import SERVO_PERIOD

FAR = 60.0
"""Time of driving after which what was driven over is forgotten to 1/e [s]."""
_LEVEL = 100.0  # Ticks for which it counts that a rover has most likely no tilt of its own.


class EvenGround:
    """Least squares of a slope and of a tilt of the rover's own, over what it drove over.

    Attributes:
        slope: (2,) of the ground in pitch and roll, as the world looks [rad].
    """

    def __init__(self) -> None:
        self.begin(np.zeros(2))

    def begin(self, slope: FloatArray) -> None:
        """Forget what was driven over, and take the ground to have a slope (2,)."""
        self.slope = slope.copy()
        self._own = 0j
        #: Sums over ticks: their count, turns by the heading, slopes, and slopes as it looks.
        self._sums = np.zeros(4, dtype=complex)

    def drive(self, slope: FloatArray, heading: float) -> None:
        """Take a tick of driving.

        Args:
            slope: (2,) what the twin takes the ground to be, as the world looks [rad].
            heading: Which way it looks [rad].
        """
        turn, tilt = cmath.rect(1.0, heading), complex(slope[1], -slope[0])
        kept = 1.0 - SERVO_PERIOD / FAR
        self._sums = kept * self._sums + [1.0, turn, tilt, tilt / turn]
        count, turns, tilts, own = self._sums
        weights = np.array([[count, turns], [turns.conjugate(), count + _LEVEL]])
        found, self._own = np.linalg.solve(weights, [tilts, own])
        self.slope = np.array([-found.imag, found.real])

    def taken(self, heading: float) -> FloatArray:
        """Return what the twin takes the ground to be (2,) where it looks that way [rad]."""
        own = self._own * cmath.rect(1.0, heading)
        return self.slope + [-own.imag, own.real]
