"""What changed on a robot, found in the innovations of a twin that runs beside it.

Innovations are linear in how the robot deviates from the twin. What it deviates by is learned while
nothing changes, and that of the latest seconds is held against it, for each change that there may
be and each time since when. How likely these seconds are with the change, over how likely they are
without, is averaged over the sizes that it may have. Such a ratio is 1 in the mean while nothing
changes, so that a sum over all times since when exceeds a number of times about once in that
number: that is how false alarms are bounded over any length of time.
"""

import collections
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.special

from controllers.sensing.diagnosis import Finding
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers

UNKNOWN = "unknown change"
_FLOOR = 1e-3  # Least long-run variance of a reading, over what its sigma says.
_CLIP = 6.0  # Deviations beyond which a single innovation counts no further: stones, knocks.
_LEAST = 1e-3  # Least information that counts, in what is known beforehand.
_STRANGE = 4.0  # Mean squared deviation that the best change must leave, or it is none of these.


@dataclasses.dataclass(frozen=True)
class Change:
    """A change that there may be.

    Attributes:
        name: Such as ``load gripper``.
        unit: Unit of its size.
        direction: (k,) what one unit changes of each deviation.
        spread: How large it may well be, in its unit.
        sign: 1 or -1 for one whose size is above or below zero only; 0 for both.
    """

    name: str
    unit: str
    direction: FloatArray
    spread: float
    sign: int = 0


@dataclasses.dataclass(frozen=True)
class ChangeConfig:
    """How changes are found.

    Attributes:
        block: Ticks that are summed before they are looked at.
        windows: Blocks since when a change is looked for; the last are the most.
        learning: Blocks for which the robot is only learned.
        settling: Blocks at first that are left out.
        between: Mean count of blocks between two false alarms, at least, if the innovations were as
            they are modelled.
        walk: How far deviations of an unchanged robot come out elsewhere from one window to
            another, in their spreads, for what no deviation describes.
        memory: Blocks after which what was learned is forgotten to 1/e.
        forgetting: Blocks within which the long-run variance of the readings is learned.
        confirming: Blocks after an alarm until the change is named.
    """

    block: int = 25
    windows: tuple[int, ...] = (2, 4, 8, 16)
    learning: int = 80
    settling: int = 8
    between: float = 1e9
    walk: float = 0.2
    memory: float = 400.0
    forgetting: float = 120.0
    confirming: int = 4

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        check_numbers("changes", self, "block", "learning", "between", "forgetting", "memory")
        check_numbers("changes", self, "walk", "settling", "confirming", zero=True)
        if not self.windows or min(self.windows) < 1:
            raise ValueError(f"changes windows = {self.windows}: expected counts of blocks above 0")


class ChangeMemory(NamedTuple):
    """What a detector has learned, so that it can go on another time.

    Attributes:
        mean: (k,) deviations, in their spreads.
        covariance: (k, k) their covariance.
        variances: (n,) long-run variances of the readings; none where none were learned yet.
        blocks: Count of blocks that were seen.
    """

    mean: FloatArray
    covariance: FloatArray
    variances: FloatArray
    blocks: int


class _Block(NamedTuple):
    """Means over the ticks of a block, in deviations of the readings' noise.

    Attributes:
        ticks: Count of each reading's ticks (n,).
        values: Innovations (n,); 0 where there are none.
        slopes: Sensitivities (k, n).
    """

    ticks: FloatArray
    values: FloatArray
    slopes: FloatArray


class _Window(NamedTuple):
    """What the latest blocks say of each change.

    Attributes:
        ratios: Logarithm of how much likelier they are with it, averaged over its sizes.
        sizes: Its likeliest size.
        sigmas: Standard deviation of that.
        misfit: How far they are off without any change, in squared deviations.
        numbers: Count of the block means whose squared deviations `misfit` sums.
    """

    ratios: FloatArray
    sizes: FloatArray
    sigmas: FloatArray
    misfit: float
    numbers: int


class ChangeDetector:
    """Looks for changes of one robot.

    Args:
        spreads: (k,) standard deviations of the deviations among new robots.
        changes: Changes that there may be.
        config: How they are found; None for the default.

    Attributes:
        evidence: (changes,) logarithm of the ratio of each change at the latest block.
    """

    def __init__(
        self, spreads: FloatArray, changes: Sequence[Change], config: ChangeConfig | None = None
    ) -> None:
        self._config = config or ChangeConfig()
        self._spreads = np.asarray(spreads, dtype=float)
        self.changes = list(changes)
        # All inside is in spreads, so that no number is much larger than another.
        self._directions = np.array([each.direction / self._spreads for each in self.changes])
        self._sizes = np.array([each.spread for each in self.changes])
        self._signs = np.array([each.sign for each in self.changes])
        self.reset()

    def reset(self) -> None:
        """Forget the robot."""
        self._mean, self._covariance = np.zeros(len(self._spreads)), np.eye(len(self._spreads))
        self.evidence = np.full(len(self.changes), np.nan)
        self._variances: FloatArray | None = None
        self._ticks: list[tuple[FloatArray, FloatArray]] = []
        self._recent: collections.deque[_Block] = collections.deque()
        self._seen, self._before, self._alarmed = 0, 0, -1

    @property
    def memory(self) -> ChangeMemory:
        """What was learned so far."""
        variances = np.empty(0) if self._variances is None else self._variances
        return ChangeMemory(self._mean, self._covariance, variances, self._before + self._seen)

    def remember(self, memory: ChangeMemory) -> None:
        """Go on where a detector of the same deviations had come to.

        Raises:
            ValueError: If it has others.
        """
        if memory.mean.shape != self._spreads.shape:
            raise ValueError(f"expected {len(self._spreads)} deviations, got {len(memory.mean)}")
        self.reset()
        self._mean, self._covariance = memory.mean, memory.covariance
        self._variances = memory.variances if len(memory.variances) else None
        self._before = memory.blocks

    @property
    def deviations(self) -> FloatArray:
        """(k,) what the robot deviates from the twin by, as learned."""
        return self._mean * self._spreads

    @property
    def covariance(self) -> FloatArray:
        """(k, k) covariance of these, with what no deviation describes."""
        own = self._covariance + self._config.walk**2 * np.eye(len(self._spreads))
        return own * np.outer(self._spreads, self._spreads)

    @property
    def odds(self) -> float:
        """Logarithm of how much likelier some change is than none; NaN while learning."""
        if np.isnan(self.evidence).any():
            return float("nan")
        return float(np.logaddexp.reduce(self.evidence) - np.log(len(self.changes)))

    def step(
        self, values: FloatArray, sigma: FloatArray, sensitivities: FloatArray
    ) -> Finding | None:
        """Take the innovations of a tick.

        Args:
            values: (n,) measured less expected; NaN for what was not measured.
            sigma: (n,) standard deviations of the readings.
            sensitivities: (k, n) change of the expected by one unit of each deviation.

        Returns:
            A change, once it is named.
        """
        self._ticks.append(
            (np.clip(values / sigma, -_CLIP, _CLIP), self._spreads[:, None] * sensitivities / sigma)
        )
        if len(self._ticks) < self._config.block:
            return None
        block, self._ticks = _averaged(self._ticks), []
        self._seen += 1
        if self._seen <= self._config.settling:
            return None
        self._recent.append(block)
        if len(self._recent) > max(self._config.windows):
            self._learn(self._recent.popleft())
        if self._before + self._seen < self._config.learning:
            return None
        return self._look()

    def accept(self, change: Change, finding: Finding) -> None:
        """Go on with a twin that has a change, and learn for a while.

        Args:
            change: The change.
            finding: Its size, as the twin has it from now on.
        """
        along = change.direction / self._spreads
        self._covariance = self._covariance + finding.sigma**2 * np.outer(along, along)
        self._recent.clear()
        self.evidence = np.full(len(self.changes), np.nan)
        self._seen, self._before, self._alarmed = self._config.settling, 0, -1

    def _learn(self, block: _Block) -> None:
        """Learn the robot from a block that is old enough to be unchanged."""
        config = self._config
        left = block.values - self._mean @ block.slopes
        found = np.where(block.ticks > 0, left**2 * block.ticks, np.nan)
        if self._variances is None:
            self._variances = np.ones(len(left))
        share = 1.0 / min(config.forgetting, 4.0 + self._before + self._seen)
        change = np.nan_to_num(found - self._variances)
        self._variances = np.maximum(self._variances + share * change, _FLOOR)
        information, score = self._weighed([block])
        kept = np.exp(-1.0 / config.memory)
        mean = kept * self._mean
        prior = kept**2 * self._covariance + (1.0 - kept**2) * np.eye(len(mean))
        self._covariance = np.linalg.inv(np.linalg.inv(prior) + information)
        self._mean = mean + self._covariance @ (score - information @ mean)

    def _weighed(self, blocks: Sequence[_Block]) -> tuple[FloatArray, FloatArray]:
        """Return information (k, k) and score (k,) of blocks about the deviations."""
        variances = 1.0 if self._variances is None else self._variances
        information, score = 0.0, 0.0
        for block in blocks:
            weighed = block.slopes * (block.ticks / variances)
            information = information + weighed @ block.slopes.T
            score = score + weighed @ block.values
        return np.asarray(information), np.asarray(score)

    def _look(self) -> Finding | None:
        """Look for changes in the latest blocks."""
        recent, config = list(self._recent), self._config
        found = [self._compare(recent[-count:]) for count in config.windows if count <= len(recent)]
        if not found:
            return None
        ratios = [window.ratios for window in found]
        self.evidence = np.logaddexp.reduce(ratios, axis=0) - np.log(len(ratios))
        if self._alarmed < 0 and self.odds > np.log(config.between):
            self._alarmed = self._seen
        if self._alarmed < 0 or self._seen < self._alarmed + config.confirming:
            return None
        return self._named(found)

    def _named(self, windows: Sequence[_Window]) -> Finding:
        """Return the likeliest change, as the window shows it in which it is likeliest."""
        self._alarmed = -1
        best = int(np.argmax(self.evidence))
        window = max(windows, key=lambda each: float(each.ratios[best]))
        size, sigma = float(window.sizes[best]), float(window.sigmas[best])
        left = (window.misfit - (size / sigma) ** 2) / window.numbers
        name = UNKNOWN if left > _STRANGE else self.changes[best].name
        return Finding(name, size, sigma, abs(size / sigma))

    def _compare(self, blocks: Sequence[_Block]) -> _Window:
        """Return what the latest blocks say of each change."""
        information, score = self._weighed(blocks)
        score = score - information @ self._mean
        # What a window tells of the deviations, beside how far off they may be before it.
        freedom = np.eye(len(score))
        spared = np.linalg.inv(self._covariance + self._config.walk**2 * freedom)
        left = np.linalg.solve(information + spared, np.column_stack([information, score]))
        told = information - information @ left[:, :-1]
        pull = score - information @ left[:, -1]
        precision = np.einsum("hk,kl,hl->h", self._directions, told, self._directions)
        # Of what a window hardly tells, rounding is all that would be left.
        precision = np.maximum(precision, _LEAST / self._sizes**2)
        sizes = self._directions @ pull / precision
        within = precision * self._sizes**2
        ahead = sizes * np.sqrt(precision * within / (1.0 + within))
        ratios = 0.5 * (ahead**2 - np.log1p(within))
        # Of a change of one sign the other half of the sizes counts for nothing.
        half = np.log(2.0) + scipy.special.log_ndtr(self._signs * ahead)
        ratios += np.where(self._signs == 0, 0.0, half)
        misfit = sum(self._misfit(block) for block in blocks) - float(score @ left[:, -1])
        numbers = sum(int(np.count_nonzero(block.ticks)) for block in blocks)
        return _Window(ratios, sizes, precision**-0.5, misfit, numbers)

    def _misfit(self, block: _Block) -> float:
        """Return how far a block is off what was learned, in squared deviations."""
        off = block.values - self._mean @ block.slopes
        variances = 1.0 if self._variances is None else self._variances
        return float(np.sum(off**2 * block.ticks / variances))


def _averaged(ticks: Sequence[tuple[FloatArray, FloatArray]]) -> _Block:
    values = np.array([each for each, _ in ticks])
    slopes = np.array([each for _, each in ticks])
    there = np.isfinite(values)
    count = there.sum(axis=0).astype(float)
    over = np.maximum(count, 1.0)
    return _Block(
        count,
        np.where(there, values, 0.0).sum(axis=0) / over,
        np.where(there[:, None], slopes, 0.0).sum(axis=0) / over,
    )
