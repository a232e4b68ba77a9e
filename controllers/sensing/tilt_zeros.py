"""Zeros of an inclinometer that drift away from the accelerometer beside it.

Both feel the same specific force, so what one shows less what the other does is the difference of
their zeros, however the rover moves and the ground lies. Where wheels skid the accelerometer is
shaken, and sampled too seldom to tell; what counts is when it is quiet.
"""

import collections
import dataclasses
import math

import numpy as np

from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from perception.geometry.gravity import apparent_tilt


@dataclasses.dataclass(frozen=True)
class TiltZeroConfig:
    """What counts as a zero that drifted.

    Attributes:
        block: Ticks that are averaged, if the accelerometer is quiet all the time.
        quiet: Largest deviation of its readings in a block, over that of their noise.
        lead: Ticks before a block that have to be quiet, too: the inclinometer lags.
        count: Latest blocks that have to tell it, each.
        memory: Blocks over which is averaged what they are held against.
        learning: Blocks before anything is told.
        beyond: Standard deviations of a block from which on a zero drifted.
        smallest: Least drift that is told [rad].
    """

    block: int = 20
    quiet: float = 3.0
    lead: int = 10
    count: int = 3
    memory: int = 200
    learning: int = 20
    beyond: float = 6.0
    smallest: float = 0.01

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        names = [field.name for field in dataclasses.fields(self)]
        check_numbers("tilt zeros", self, *names)


@dataclasses.dataclass(frozen=True)
class TiltDrift:
    """A zero that drifted.

    Attributes:
        axis: 0 for the pitch's, 1 for the roll's.
        size: Angle by which it did [rad].
        sigma: Standard deviation of the size [rad].
    """

    axis: int
    size: float
    sigma: float


class TiltZeros:
    """Looks for drifts of one inclinometer's zeros.

    Args:
        bandwidth: Corner of the inclinometer's low pass [Hz].
        most: Apparent tilt at which its masses stop [rad].
        noise: Standard deviation of an acceleration that is read [m/s^2].
        period: Time between two ticks [s].
        config: What counts as a drift; None for the default.
    """

    def __init__(
        self,
        bandwidth: float,
        most: float,
        noise: float,
        period: float,
        config: TiltZeroConfig | None = None,
    ) -> None:
        self._config = config or TiltZeroConfig()
        self._keep = math.exp(-2.0 * math.pi * bandwidth * period)
        self._most, self._shaken = most, noise * self._config.quiet
        #: Blocks that may have drifted.
        self._latest: collections.deque[FloatArray] = collections.deque(maxlen=self._config.count)
        self._learned, self._mean, self._variance = 0, np.zeros(2), np.zeros(2)
        self.reset()

    def reset(self) -> None:
        """Begin anew after a gap; what was learned stays."""
        config = self._config
        self._forces: collections.deque[FloatArray] = collections.deque(
            maxlen=config.block + config.lead
        )
        self._off: list[FloatArray] = []
        self._ticks = 0
        self._shown: FloatArray | None = None

    def step(self, tilt: FloatArray | None, force: FloatArray) -> TiltDrift | None:
        """Take the readings of a tick.

        Args:
            tilt: (2,) pitch and roll of the inclinometer [rad]; None if it was not read anew.
            force: (3,) specific force [m/s^2].

        Returns:
            A drift, once there is one.
        """
        config = self._config
        felt = apparent_tilt(force[None], self._most)[0]
        shown = felt if self._shown is None else felt + self._keep * (self._shown - felt)
        self._shown = shown
        self._forces.append(force)
        if tilt is not None:
            self._off.append(tilt - shown)
        self._ticks += 1
        if self._ticks % config.block:
            return None
        off, self._off = self._off, []
        full = len(self._forces) == config.block + config.lead
        if not off or not full or np.std(self._forces, axis=0).max() > self._shaken:
            return None
        return self._take(np.mean(off, axis=0))

    def _take(self, block: FloatArray) -> TiltDrift | None:
        """Hold the latest quiet blocks against those before."""
        if len(self._latest) == self._config.count:
            self._learn(self._latest[0])
        self._latest.append(block)
        if self._learned < self._config.learning:
            return None
        off = np.array(self._latest) - self._mean
        # The first of them may be from both before and after.
        size, deviation = np.median(off, axis=0), np.sqrt(self._variance)
        limit = np.maximum(self._config.beyond * deviation, self._config.smallest)
        steady = (off * np.sign(size) > 0.5 * np.abs(size)).all(axis=0)
        over = np.where(steady, np.abs(size) - limit, -1.0)
        axis = int(np.argmax(over))
        if over[axis] <= 0.0:
            return None
        self._mean[axis] += size[axis]
        return TiltDrift(axis, float(size[axis]), float(deviation[axis]))

    def _learn(self, block: FloatArray) -> None:
        """Learn from a block that is old enough."""
        self._learned += 1
        share = 1.0 / min(self._config.memory, self._learned)
        square = (1.0 - share) * np.square(block - self._mean)
        if self._learned > self._config.learning:
            # What has not been told, and yet is far off, is no noise.
            square = np.minimum(square, 9.0 * self._variance)
        self._mean = self._mean + share * (block - self._mean)
        self._variance = self._variance + share * (square - self._variance)
