"""What changed on a robot, found in the innovations of a twin that runs beside it.

Innovations are linear in how the robot deviates from the twin. What it deviates by is learned while
nothing changes, and that of the latest seconds is held against it, for each change that there may
be and each time since when. How likely these seconds are with the change, over how likely they are
without, is averaged over the sizes that it may have. Such a ratio is 1 in the mean while nothing
changes, so that a sum over all times since when exceeds a number of times about once in that
number: that is how false alarms are bounded over any length of time.

No model is complete. What it misses of a reading for good is learned as an offset of that reading.
What it misses for a while is not white: what a reading is off by in one block it is likely to be in
the next, and so tells less than its variance says. The long-run variance is learned, which counts
that in; where the latest seconds are rougher than that, they count for less, as in Student's t. A
rover that drives is shaken as one that stands is not: what is missed of them is learned apart.
"""

import collections
import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy.special
from numpy.typing import NDArray

from controllers.sensing.diagnosis import Finding
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers

KINDS = 4
"""Kinds of motion whose readings vary apart: 1 for driving and 2 for swinging the arm, added."""
_FLOOR = 1e-3  # Least long-run variance of a reading, over what its sigma says.
_MOST = 6.0  # Deviations for which a single innovation counts at most: stones, knocks.
_LEAST = 1e-3  # Least information that counts, in what is known beforehand.
_FREELY = 3.0  # How far a change may go that is fitted, over what it may well be.
_ROUGHEST = 4.0  # Most that a window's variance counts for, over the long-run one.
_SUSPECTS = 4  # Changes that an alarm suspects.


@dataclasses.dataclass(frozen=True)
class Change:
    """A change that there may be.

    Attributes:
        name: Such as ``load gripper``.
        unit: Unit of its size.
        direction: (k,) what one unit changes of each deviation.
        spread: How large it may well be, in its unit.
        sign: 1 or -1 for one whose size is above or below zero only; 0 for both.
        whole: Whether it happens wholly or not at all, and is tried out only.
        most: Largest size, to either side, that there can be.
        wholly: Name of the change that it is where it is as large as that, which happens wholly or
            not at all; empty if it is still itself.
    """

    name: str
    unit: str
    direction: FloatArray
    spread: float
    sign: int = 0
    whole: bool = False
    most: float = math.inf
    wholly: str = ""


@dataclasses.dataclass(frozen=True)
class ChangeConfig:
    """How changes are found.

    Attributes:
        block: Ticks that are summed before they are looked at; more than there are windows.
        windows: Blocks since when a change is looked for; the last are the most.
        learning: Blocks for which the robot is only learned.
        settling: Blocks at first that are left out.
        between: Mean count of blocks between two false alarms, at least, if the innovations were as
            they are modelled.
        walk: How far deviations of an unchanged robot come out elsewhere from one window to
            another, in their spreads, for what no deviation describes.
        memory: Blocks after which what was learned is forgotten to 1/e.
        forgetting: Blocks within which the long-run variance of the readings is learned.
        offset: Standard deviation of what a reading may be off by for good, in its sigma.
        lags: Blocks over which what a reading is off by may last.
        freedom: Count of blocks that the long-run variance counts for beside those of a window.
        confirming: Blocks after an alarm until changes are suspected, if they are as likely still.
    """

    block: int = 25
    windows: tuple[int, ...] = (2, 3, 4, 5, 6, 8, 11, 16, 23, 32)
    learning: int = 80
    settling: int = 8
    between: float = 30.0
    walk: float = 0.1
    memory: float = 400.0
    forgetting: float = 120.0
    offset: float = 2.0
    lags: int = 8
    freedom: float = 4.0
    confirming: int = 1

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        check_numbers("changes", self, "block", "learning", "between", "forgetting", "memory")
        check_numbers("changes", self, "walk", "settling", "confirming", "offset", zero=True)
        check_numbers("changes", self, "lags", "freedom", zero=True)
        if not self.windows or min(self.windows) < 1:
            raise ValueError(f"changes windows = {self.windows}: expected counts of blocks above 0")
        if self.block <= len(self.windows):
            raise ValueError(
                f"changes block = {self.block}: expected more ticks than the {len(self.windows)} "
                "windows"
            )


class ChangeMemory(NamedTuple):
    """What a detector has learned, so that it can go on another time.

    Attributes:
        mean: (k + n,) deviations and offsets of the readings, in their spreads.
        covariance: (k + n, k + n) their covariance.
        products: (KINDS, lags + 1, n) means of what a reading is off by, times what it is some
            blocks later, by kind of motion.
        learned: (KINDS,) blocks of which these are the means.
        blocks: Count of blocks that were seen.
    """

    mean: FloatArray
    covariance: FloatArray
    products: FloatArray
    learned: FloatArray
    blocks: int


class _Blocks(NamedTuple):
    """Means over the ticks of m blocks, in deviations of the readings' noise.

    Attributes:
        ticks: (m, n) count of each reading's ticks.
        values: (m, n) innovations; 0 where there are none.
        slopes: (m, k, n) sensitivities to deviations.
        offsets: (m, n) sensitivities to the reading's own offset.
        kinds: (m,) kinds of motion.
    """

    ticks: FloatArray
    values: FloatArray
    slopes: FloatArray
    offsets: FloatArray
    kinds: NDArray[np.intp]

    def last(self, count: int) -> "_Blocks":
        """Return the latest of them."""
        return self._make(rows[-count:] for rows in self)

    def expected(self, mean: FloatArray) -> FloatArray:
        """Return the innovations (m, n) by deviations and offsets (k + n,)."""
        count = self.slopes.shape[1]
        return mean[:count] @ self.slopes + mean[count:] * self.offsets

    def weighed(self, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return information (k + n, k + n) and score (k + n,) about what is learned.

        Args:
            variances: (KINDS, n) long-run variances of the readings.
        """
        weights = self.ticks / variances[self.kinds]
        sloped, offset = self.slopes * weights[:, None], self.offsets * weights
        between = np.einsum("mkn,mn->kn", sloped, self.offsets)
        information = np.block(
            [
                [np.tensordot(sloped, self.slopes, ((0, 2), (0, 2))), between],
                [between.T, np.diag(np.einsum("mn,mn->n", offset, self.offsets))],
            ]
        )
        told = np.einsum("mkn,mn->k", sloped, self.values)
        return information, np.concatenate([told, np.einsum("mn,mn->n", offset, self.values)])


class _Window(NamedTuple):
    """What the latest blocks say of each change.

    Attributes:
        ratios: Logarithm of how much likelier they are with it, averaged over its sizes.
        sizes: Its likeliest size.
        sigmas: Standard deviation of that.
    """

    ratios: FloatArray
    sizes: FloatArray
    sigmas: FloatArray


class Learned(NamedTuple):
    """What is learned of an unchanged robot, against which changes are tried out.

    Attributes:
        deviations: (k,) what the robot deviates from the twin by.
        covariance: (k, k) covariance of these, with what no deviation describes.
        offsets: (n,) what readings are off by for good, in their sigma.
        variances: (KINDS, n) long-run variance of each reading, over what its sigma says.
    """

    deviations: FloatArray
    covariance: FloatArray
    offsets: FloatArray
    variances: FloatArray


class ChangeDetector:
    """Looks for changes of one robot.

    Args:
        spreads: (k,) standard deviations of the deviations among new robots.
        changes: Changes that there may be, of those that have a size.
        config: How they are found; None for the default.
        walks: (k,) `ChangeConfig.walk` of each deviation, where it is not the same of all.

    Attributes:
        evidence: (changes,) logarithm of the ratio of each change at the latest block.
        suspects: Changes that the latest alarm suspects, the likeliest first.
    """

    def __init__(
        self,
        spreads: FloatArray,
        changes: Sequence[Change],
        config: ChangeConfig | None = None,
        walks: FloatArray | None = None,
    ) -> None:
        self._config = config or ChangeConfig()
        self._spreads = np.asarray(spreads, dtype=float)
        usual = np.full(len(self._spreads), self._config.walk)
        self._walks = usual if walks is None else np.asarray(walks, dtype=float)
        self.changes = list(changes)
        # All inside is in spreads, so that no number is much larger than another.
        rows = [each.direction / self._spreads for each in self.changes]
        self._changes = np.array(rows).reshape(len(rows), len(self._spreads))
        self._sizes = np.array([each.spread for each in self.changes])
        self._signs = np.array([each.sign for each in self.changes])
        self.reset()

    def reset(self) -> None:
        """Forget the robot."""
        self.suspects: list[Finding] = []
        self._begin(0)

    def _begin(self, readings: int) -> None:
        """Know nothing of a robot with so many readings."""
        count, config = len(self._spreads) + readings, self._config
        self._mean, self._covariance = np.zeros(count), np.eye(count)
        self._products = np.zeros((KINDS, config.lags + 1, readings))
        self._products[:, 0] = 1.0 + 0.25 * config.lags
        self._learned = np.zeros(KINDS)
        self._directions = np.hstack([self._changes, np.zeros((len(self.changes), readings))])
        self._pause()
        self._before = 0

    def _pause(self) -> None:
        """Begin with another stretch of the robot's motion."""
        self.evidence = np.full(len(self.changes), np.nan)
        #: What the latest blocks of one kind of motion were off by, and which that is.
        self._left: collections.deque[FloatArray] = collections.deque(maxlen=self._config.lags)
        self._last = -1
        self._ticks: list[tuple[FloatArray, FloatArray, int]] = []
        self._recent: collections.deque[_Blocks] = collections.deque()
        self._looking: Iterator[Finding | None] = iter(())
        self._seen, self._alarmed = 0, -1

    def pause(self) -> None:
        """Keep what was learned, where what comes next is not of the same motion."""
        self._before += self._seen
        self._pause()

    @property
    def memory(self) -> ChangeMemory:
        """What was learned so far."""
        products, learned = self._products.copy(), self._learned.copy()
        return ChangeMemory(self._mean, self._covariance, products, learned, self.blocks)

    def remember(self, memory: ChangeMemory) -> None:
        """Go on where a detector of the same deviations had come to.

        Raises:
            ValueError: If it has others, or knew other kinds of motion.
        """
        readings = len(memory.mean) - len(self._spreads)
        expected = KINDS, self._config.lags + 1, readings
        if memory.products.shape != expected:
            raise ValueError(
                f"what was learned has numbers {memory.products.shape} of {len(memory.mean)} "
                f"deviations and readings, expected {expected}: begin anew"
            )
        self._begin(readings)
        self._mean, self._covariance = memory.mean, memory.covariance
        self._products, self._learned = memory.products.copy(), memory.learned.copy()
        self._before = memory.blocks

    @property
    def deviations(self) -> FloatArray:
        """(k,) what the robot deviates from the twin by, as learned."""
        return self._mean[: len(self._spreads)] * self._spreads

    @property
    def covariance(self) -> FloatArray:
        """(k, k) covariance of these, with what no deviation describes."""
        count = len(self._spreads)
        own = self._covariance[:count, :count] + np.diag(self._walks**2)
        return own * np.outer(self._spreads, self._spreads)

    @property
    def odds(self) -> float:
        """Logarithm of how much likelier some change is than none; NaN while learning."""
        if np.isnan(self.evidence).any():
            return float("nan")
        return float(np.logaddexp.reduce(self.evidence) - np.log(len(self.changes)))

    @property
    def learned(self) -> Learned:
        """What is learned of the robot so far."""
        offsets = self._mean[len(self._spreads) :] * self._config.offset
        return Learned(self.deviations, self.covariance, offsets, self._variances)

    def step(
        self,
        values: FloatArray,
        sigma: FloatArray,
        sensitivities: FloatArray,
        kind: int = 0,
    ) -> Finding | None:
        """Take the innovations of a tick.

        Args:
            values: (n,) measured less expected; NaN for what was not measured.
            sigma: (n,) standard deviations of the readings.
            sensitivities: (k, n) change of the expected by one unit of each deviation.
            kind: Kind of motion, below `KINDS`.

        Returns:
            The likeliest change, once there is one. That is some ticks after the block that shows
            it, as each tick looks at one window only.
        """
        finding = next(self._looking, None)
        # What is far beyond its noise counts for less, and with it what would explain it.
        counted = 1.0 / np.maximum(sigma, np.abs(np.nan_to_num(values)) / _MOST)
        slopes = self._spreads[:, None] * sensitivities * counted
        self._ticks.append((values * counted, slopes, kind))
        if len(self._ticks) < self._config.block or finding is not None:
            return finding
        block, self._ticks = _averaged(self._ticks, self._config.offset), []
        if self._seen == 0 and self._before == 0:
            self._begin(len(values))
        self._seen += 1
        if self._seen <= self._config.settling:
            return None
        self._recent.append(block)
        if len(self._recent) > max(self._config.windows):
            self._learn(self._recent.popleft())
        if self.blocks >= self._config.learning:
            self._looking = self._look()
        return None

    def accept(self, change: Change, finding: Finding) -> None:
        """Go on with a twin that has a change, and learn for a while.

        Args:
            change: The change.
            finding: Its size, as the twin has it from now on.
        """
        along = np.zeros(len(self._mean))
        along[: len(self._spreads)] = change.direction / self._spreads
        self._covariance = self._covariance + finding.sigma**2 * np.outer(along, along)
        self._pause()
        self._seen, self._before = self._config.settling, 0

    def take_in(self, which: NDArray[np.bool_]) -> FloatArray:
        """Go on with a twin that has what was learned, of all blocks so far.

        Args:
            which: (k,) deviations that it takes in.

        Returns:
            (k,) what it has of them from now on, beside what it had.
        """
        while self._recent:
            self._learn(self._recent.popleft())
        taken = np.where(which, self.deviations, 0.0)
        mean = self._mean.copy()
        mean[: len(taken)] -= taken / self._spreads
        self._mean = mean
        self.pause()
        return taken

    @property
    def blocks(self) -> int:
        """Count of blocks that were seen."""
        return self._before + self._seen

    @property
    def _variances(self) -> FloatArray:
        """(KINDS, n) long-run variance of each reading, over what its sigma says."""
        lags, own = self._config.lags, self._products[:, 0]
        weights = 2.0 * (1.0 - np.arange(1, lags + 1) / (lags + 1))  # Bartlett's
        total = own + np.einsum("l,kln->kn", weights, self._products[:, 1:])
        return np.maximum(np.maximum(total, own), _FLOOR)

    def _learn(self, block: _Blocks) -> None:
        """Learn the robot from a block that is old enough to be unchanged."""
        config, kind = self._config, int(block.kinds[0])
        left = ((block.values - block.expected(self._mean)) * np.sqrt(block.ticks))[0]
        self._learned[kind] += 1
        share = (block.ticks[0] > 0) / min(config.forgetting, 4.0 + self._learned[kind])
        if kind != self._last:
            self._left.clear()
        self._last = kind
        products = self._products[kind]
        for lag, earlier in enumerate((left, *reversed(self._left))):
            products[lag] += share * (left * earlier - products[lag])
        self._left.append(left)
        information, score = block.weighed(self._variances)
        kept = np.exp(-1.0 / config.memory)
        mean = kept * self._mean
        prior = kept**2 * self._covariance + (1.0 - kept**2) * np.eye(len(mean))
        self._covariance = np.linalg.inv(np.linalg.inv(prior) + information)
        self._mean = mean + self._covariance @ (score - information @ mean)

    def _look(self) -> Iterator[Finding | None]:
        """Look for changes in the latest blocks, at one window for each item."""
        config, blocks = self._config, _joined(self._recent)
        spared = np.asarray(np.linalg.inv(self._before_window), dtype=float)
        found: list[_Window] = []
        for count in config.windows:
            if count <= len(blocks.kinds):
                found.append(self._compare(blocks.last(count), spared))
                yield None
        if not found:
            return
        ratios = [window.ratios for window in found]
        self.evidence = np.logaddexp.reduce(ratios, axis=0) - np.log(len(ratios))
        likely = self.odds > np.log(config.between)
        if self._alarmed < 0 and likely:
            self._alarmed = self._seen
        if self._alarmed >= 0 and self._seen >= self._alarmed + config.confirming:
            self._alarmed = -1
            if likely:
                order = np.argsort(-self.evidence)[:_SUSPECTS]
                self.suspects = [self._suspected(found, int(each)) for each in order]
                yield self.suspects[0]

    def _suspected(self, windows: Sequence[_Window], change: int) -> Finding:
        """Return a change as the window shows it in which it is likeliest."""
        window = max(windows, key=lambda each: float(each.ratios[change]))
        size, sigma = float(window.sizes[change]), float(window.sigmas[change])
        return Finding(self.changes[change].name, size, sigma, abs(size / sigma))

    def _compare(self, blocks: _Blocks, spared: FloatArray) -> _Window:
        """Return what the latest blocks say of each change.

        Args:
            blocks: Blocks of a window.
            spared: Inverse of the covariance before it.
        """
        variances = self._variances
        told = blocks.weighed(variances)
        window = self._weigh(*told, spared)
        best = int(np.argmax(window.ratios))
        likeliest = self._directions[best] * _FREELY * self._sizes[best]
        squares, count = self._left_by(blocks, spared, *told, likeliest)
        freedom = self._config.freedom
        rough = (freedom + squares) / (freedom + count)
        rough = np.clip(rough, 1.0, _ROUGHEST)
        return self._weigh(*blocks.weighed(variances * rough), spared)

    def _left_by(
        self,
        blocks: _Blocks,
        spared: FloatArray,
        information: FloatArray,
        score: FloatArray,
        change: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return what a change leaves unexplained.

        Args:
            blocks: Blocks of a window.
            spared: Inverse of the covariance before it.
            information: (k + n, k + n) what they tell.
            score: (k + n,) likewise.
            change: (k + n,) its direction, as far as it may go.

        Returns:
            (n,) sums of the squares of what each reading is off by still, over their variance, and
            (n,) count of these.
        """
        along: FloatArray = spared @ change
        prior = spared - np.outer(along, along) / (1.0 + change @ along)
        mean = self._mean + np.linalg.solve(prior + information, score - information @ self._mean)
        own = np.maximum(self._products[:, 0], _FLOOR)[blocks.kinds]
        left = np.square(blocks.values - blocks.expected(mean)) * blocks.ticks / own
        return left.sum(axis=0), (blocks.ticks > 0).sum(axis=0)

    @property
    def _before_window(self) -> FloatArray:
        """Covariance of deviations and offsets before a window, with what none describes."""
        walk = np.zeros(len(self._covariance))
        walk[: len(self._spreads)] = self._walks
        return self._covariance + np.diag(walk**2)

    def _weigh(self, information: FloatArray, score: FloatArray, spared: FloatArray) -> _Window:
        """Return what a window says of each change, by what it tells, as `_compare` has it."""
        score = score - information @ self._mean
        # What it tells of the deviations, beside how far off they may be before it.
        left = np.linalg.solve(information + spared, np.column_stack([information, score]))
        told = information - information @ left[:, :-1]
        pull = score - information @ left[:, -1]
        precision = np.sum(self._directions @ told * self._directions, axis=1)
        # Of what a window hardly tells, rounding is all that would be left.
        precision = np.maximum(precision, _LEAST / self._sizes**2)
        sizes = self._directions @ pull / precision
        within = precision * self._sizes**2
        # What is left of their squares where the size is drawn back by how large it may be.
        square = precision * sizes**2 * within / (1.0 + within)
        ratios = 0.5 * (square - np.log1p(within))
        # Of a change of one sign the other half of the sizes counts for nothing.
        ahead = np.sign(sizes) * np.sqrt(square)
        half = np.log(2.0) + scipy.special.log_ndtr(self._signs * ahead)
        ratios += np.where(self._signs == 0, 0.0, half)
        return _Window(ratios, sizes, precision**-0.5)


def _joined(blocks: Iterable[_Blocks]) -> _Blocks:
    """Return blocks as one stack."""
    return _Blocks(*(np.concatenate(rows) for rows in zip(*blocks)))


def _averaged(ticks: Sequence[tuple[FloatArray, FloatArray, int]], offset: float) -> _Blocks:
    """Return the means of some ticks as one block."""
    values = np.array([each for each, _, _ in ticks])
    slopes = np.array([each for _, each, _ in ticks])
    kinds = [kind for _, _, kind in ticks]
    there = np.isfinite(values)
    count = there.sum(axis=0).astype(float)
    over = np.maximum(count, 1.0)
    mean = np.where(there[:, None], slopes, 0.0).sum(axis=0) / over
    return _Blocks(
        count[None],
        (np.where(there, values, 0.0).sum(axis=0) / over)[None],
        mean[None],
        np.where(count > 0, offset, 0.0)[None],
        # A block in which the rover drives at all is shaken.
        np.array([np.bitwise_or.reduce(kinds)]),
    )
