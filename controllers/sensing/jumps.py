"""Encoders of an arm whose zero jumps: an angle that changes at once, and by more than it turned.

A twin is led to what the encoders read, so that its innovations hardly show it; beside the rate
that is measured on its own it shows within a tick.
"""

import collections
import dataclasses
import math

import numpy as np

from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers


@dataclasses.dataclass(frozen=True)
class JumpConfig:
    """What counts as a jump.

    Attributes:
        beyond: Deviations of what noise makes beyond which an angle jumped.
        steady: Ticks before and after for which it stays as it is.
        gap: Time between two readings beyond which nothing is compared [s].
        off: Standard deviation of a size over the size: an arm that follows its encoder swings.
    """

    beyond: float = 8.0
    steady: int = 5
    gap: float = 0.05
    off: float = 0.01

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        check_numbers("jumps", self, "beyond", "steady", "gap", "off")


@dataclasses.dataclass(frozen=True)
class Jump:
    """A zero that jumped.

    Attributes:
        joint: Number of the joint.
        size: Angle by which its zero jumped [rad].
        sigma: Standard deviation of the size [rad].
    """

    joint: int
    size: float
    sigma: float


class ZeroJumps:
    """Looks for jumps of one arm's encoders.

    Args:
        angle_sigma: Standard deviation of an angle that is read [rad].
        rate_sigma: Standard deviation of a rate [rad/s].
        config: What counts as a jump; None for the default.
    """

    def __init__(
        self, angle_sigma: float, rate_sigma: float, config: JumpConfig | None = None
    ) -> None:
        self._config = config or JumpConfig()
        self._angle, self._rate = angle_sigma, rate_sigma
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        #: Time, angles and rates.
        self._kept: collections.deque[tuple[float, FloatArray, FloatArray]] = collections.deque(
            maxlen=2 * self._config.steady
        )

    def step(self, time: float, angles: FloatArray, rates: FloatArray) -> Jump | None:
        """Take a reading.

        Args:
            time: When it was taken [s].
            angles: (joints,) of the arm [rad].
            rates: (joints,) of the arm [rad/s].

        Returns:
            A jump, some ticks after it.
        """
        kept = self._kept
        if kept and time - kept[-1][0] > self._config.gap:
            kept.clear()
        kept.append((time, angles, rates))
        if len(kept) < 2 * self._config.steady:
            return None
        return self._jumped(*(np.array(each) for each in zip(*kept)))

    def _jumped(self, times: FloatArray, angles: FloatArray, rates: FloatArray) -> Jump | None:
        """Return the jump in the middle of some readings.

        Args:
            times: (m,) when they were taken [s].
            angles: (m, joints) what was read [rad].
            rates: (m, joints) likewise [rad/s].
        """
        ticks, steady = np.diff(times), self._config.steady
        turned = np.cumsum(0.5 * ticks[:, None] * (rates[1:] + rates[:-1]), axis=0)
        off = angles - np.vstack([np.zeros(angles.shape[1]), turned])
        before, later = off[:steady], off[steady:]
        jumped = later[0] - before[-1]
        noise = math.hypot(self._angle, self._rate * float(ticks.max()))
        # An arm that is stopped within a tick turned by less or more than its rates say.
        limit = self._config.beyond * math.sqrt(2.0) * noise + np.ptp(rates, axis=0) * ticks.max()
        wander = np.maximum(np.ptp(before, axis=0), np.ptp(later, axis=0))
        over = np.where(wander < 0.5 * np.abs(jumped), np.abs(jumped) - limit, -1.0)
        joint = int(np.argmax(over))
        if over[joint] <= 0.0:
            return None
        self.reset()
        # Rates are off by some share, so that the difference grows: lines before and after it.
        middle = 0.5 * (times[steady - 1] + times[steady])
        sides = (times[:steady], before), (times[steady:], later)
        ends = [np.polynomial.Polynomial.fit(at, each[:, joint], 1)(middle) for at, each in sides]
        size = float(ends[1] - ends[0])
        return Jump(joint, size, math.hypot(noise * math.sqrt(steady), self._config.off * size))
