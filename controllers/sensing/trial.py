"""Which of some suspected changes happened: each is tried out in twins that have it.

A change that is suspected is one that explains what a twin missed, as far as its innovations are
linear in it. Then copies of the twin run that have it, in some sizes and later in others about the
likeliest: what is blocked is blocked there, and a spring is as soft as it would be. The one that
misses least of the next seconds is named, if without any the twin would miss much more. What a size
between two that are tried out would miss lies between what these do.

All of them deviate from the drawing as the unchanged robot was learned to. Misses are means over
blocks, less what each reading is off by for good, over its long-run variance. Each counts as of
Student's distribution, by which a stone that no twin expects does not decide.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
import scipy.linalg

from controllers.sensing.changes import Change, Learned
from controllers.sensing.diagnosis import UNKNOWN, Finding
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers

_MOST = 60.0  # Deviations for which a single miss counts at most.
_LITTLE = 0.5  # Share of what the unchanged robot misses above which a change explains too little.
_STRANGE = 20.0  # Mean squared miss above which what no change explains is told, too.
_TELLING = 9.0  # Squared miss of the unchanged robot below which it may be noise.
_APART = 0.06  # Logarithm of the ratio of two sizes that follow one another, at most.
_STILL = 4  # Last blocks in each of which what is unknown is strange still.


@dataclasses.dataclass(frozen=True)
class TrialConfig:
    """How changes are tried out.

    Attributes:
        block: Ticks over which misses are averaged.
        coarse: Sizes that are tried out at first, over how large a change may well be.
        fine: Sizes that are tried out then, over the likeliest of these.
        settling: Blocks at first that count for nothing: what a change moved before, it moves in
            the copies anew.
        first: Blocks of the first part, of which those changes are left that may be.
        least: Blocks of each later part before one is named.
        most: Blocks after which the likeliest is, if no other is far less likely before.
        parts: Parts at most; one follows where the likeliest size is the first or last of its own.
        off: Standard deviation of a size by what models of such robots miss, over the size.
        left: Ratio of likelihoods to the likeliest change above which a change is left; one that
            may be larger than all sizes that were tried out is left, too.
        decided: Ratio of likelihoods to the next one with which a change is named before `most`.
        needed: Logarithm of the ratio of likelihoods to no change, in the mean of the blocks of the
            later parts, from which on one is named at all: as no model is a robot, some change
            explains an unchanged one better than none, too, though by less.
        smallest: Least size that is named, over how large the change may well be: smaller ones are
            learned.
        sure: Least size that is named, over its standard deviation.
        freedom: Degrees of freedom of Student's distribution of the misses.
    """

    block: int = 25
    coarse: tuple[float, ...] = (0.2, 0.5, 1.0, 2.0, 5.0)
    fine: tuple[float, ...] = (0.75, 1.0, 1.35)
    settling: int = 1
    first: int = 3
    least: int = 4
    most: int = 16
    parts: int = 4
    off: float = 0.1
    left: float = 1e-20
    decided: float = 1e6
    needed: float = 7.0
    smallest: float = 0.4
    sure: float = 2.0
    freedom: float = 4.0

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        names = "block", "first", "least", "most", "parts", "left", "decided", "needed", "freedom"
        check_numbers("trial", self, *names)
        check_numbers("trial", self, "settling", "off", "smallest", "sure", zero=True)
        if self.first <= self.settling:
            raise ValueError(
                f"trial first = {self.first}: expected more blocks than the {self.settling} of "
                "settling"
            )


class Trial:
    """Tries out some changes.

    Args:
        suspects: Changes that may have happened.
        learned: What is known of the unchanged robot.
        config: How; None for the default.

    Attributes:
        rows: (1 + m, k) deviations to try out, beside those that the twin has, first those of the
            unchanged robot; others in its later parts.
        begin: (1 + m,) from where each begins in a later part: the number of a row before; None in
            the first, which begins where the twin is.
        over: Whether it is over.
        finding: What came of it: the change with its size; None if none is needed.
    """

    def __init__(
        self,
        suspects: Sequence[Change],
        learned: Learned,
        config: TrialConfig | None = None,
    ) -> None:
        self._config = config or TrialConfig()
        self._learned = learned
        self.over = False
        self.finding: Finding | None = None
        self._parts, self._later = 1, 0
        self.begin: list[int] | None = None
        signed = [(each, sign * each.spread) for each in suspects for sign in _signs(each)]
        self._try(signed, self._config.coarse, [0.0] * len(signed))

    def _try(
        self,
        suspects: Sequence[tuple[Change, float]],
        shares: Sequence[float],
        before: Sequence[float],
    ) -> None:
        """Begin a part, with shares of given sizes of some changes.

        Args:
            suspects: The changes, with their sizes.
            shares: Shares of these.
            before: Logarithm of how much likelier each was than no change in the parts before.
        """
        self._told_before = before
        self._changes = [change for change, _ in suspects]
        self._sizes = [_sizes(change, size, shares) for change, size in suspects]
        added = [
            size * change.direction
            for change, sizes in zip(self._changes, self._sizes)
            for size in sizes
        ]
        self.rows: FloatArray = self._learned.deviations + np.vstack([0.0 * added[0], *added])
        #: Of each change, sizes of which it is told how likely they are.
        self._between = [_between(each) for each in self._sizes]
        #: (1 + g, 1 + m) by which what these miss follows from what is missed by those tried out.
        between = [_shares(*each) for each in zip(self._between, self._sizes)]
        self._shares: FloatArray = np.asarray(scipy.linalg.block_diag(1.0, *between))
        #: (g,) which of them are of what happens wholly or not at all.
        self._whole = np.repeat(
            [each.whole for each in self._changes], [len(each) for each in self._between]
        )
        #: Misses of this block's ticks.
        self._ticks: list[tuple[FloatArray, FloatArray, int]] = []
        self._likely: FloatArray = np.zeros(len(self._shares))
        self._squares: FloatArray = np.zeros(len(self._shares))
        count = len(self._learned.deviations)
        self._information: FloatArray = np.zeros((count, count))
        self._blocks, self._count = 0, 0
        #: Mean squared misses of the unchanged robot, block by block.
        self._without: list[float] = []

    def step(
        self, missed: FloatArray, sigma: FloatArray, sensitivities: FloatArray, kind: int
    ) -> None:
        """Take the innovations of a tick.

        Args:
            missed: (1 + m, n) measured less expected with each of the deviations that are tried
                out; NaN for what was not measured.
            sigma: (n,) standard deviations of the readings.
            sensitivities: (k, n) change of the expected by one unit of each deviation.
            kind: Kind of motion, below `controllers.sensing.changes.KINDS`.
        """
        missed = np.clip(missed / sigma - self._learned.offsets, -_MOST, _MOST)
        self._ticks.append((missed, sensitivities / sigma, kind))
        if len(self._ticks) == self._config.block:
            if self._parts > 1 or self._blocks >= self._config.settling:
                self._take_block()
            self._ticks = []
            self._blocks += 1
            if self._parts > 1:
                self._judge()
            elif self._blocks == self._config.first:
                self._refine()

    def _take_block(self) -> None:
        missed, slopes = (np.array([each[at] for each in self._ticks]) for at in (0, 1))
        kind = int(np.bitwise_or.reduce([kind for _, _, kind in self._ticks]))
        there = np.isfinite(missed)
        count = there[:, 0].sum(axis=0)
        mean = self._shares @ (np.where(there, missed, 0.0).sum(axis=0) / np.maximum(count, 1))
        weights = count / self._learned.variances[kind]
        squares = np.square(mean) * weights
        # What sticks or is blocked expects readings to the bit: that it misses no noise is no news.
        noise = np.where(squares[0] < _TELLING, squares[0], 0.0)
        squares[1:] = np.maximum(squares[1:], self._whole[:, None] * noise)
        slope = slopes.mean(axis=0)
        self._information += (slope * weights) @ slope.T
        freedom = self._config.freedom
        self._likely -= 0.5 * (freedom + 1.0) * np.log1p(squares / freedom).sum(axis=1)
        self._squares += squares.sum(axis=1)
        measured = int(np.count_nonzero(count))
        self._count += measured
        self._without.append(float(squares[0].sum()) / max(1, measured))
        self._later += self._parts > 1

    def _told(self) -> tuple[list[FloatArray], list[float]]:
        """Return how likely each size is in this part, and each change over no change in all."""
        parts = np.split(self._likely[1:], np.cumsum([len(each) for each in self._between])[:-1])
        means = [float(np.logaddexp.reduce(part)) - math.log(len(part)) for part in parts]
        without = float(self._likely[0])
        return parts, [each + mean - without for each, mean in zip(self._told_before, means)]

    def _refine(self) -> None:
        """Begin another part, with the changes that are left."""
        parts, likely = self._told()
        limit = max(likely) + math.log(self._config.left)
        left: list[tuple[Change, float]] = []
        rows, before, row = list[int](), list[float](), 1
        for index, (change, part, each) in enumerate(zip(self._changes, parts, likely)):
            tried = self._sizes[index]
            # How likely one is that may be larger than all sizes that were tried out is not known.
            if each > limit or self._larger(index, part):
                left.append((change, self._next(index, part)))
                rows.append(row + int(np.argmin(np.abs(tried - self._likeliest(index, part)))))
                # The first part's sizes are far apart: one that lies between them counts for less.
                before.append(each if self._parts > 1 else 0.0)
            row += len(tried)
        self._parts += 1
        self._try(left, self._config.fine, before)
        self.begin = [0, *np.repeat(rows, [len(each) for each in self._sizes]).tolist()]

    def _next(self, index: int, likely: FloatArray) -> float:
        """Return about what size a change is tried out next: beyond the largest, if it is that."""
        if self._parts > 1 and self._larger(index, likely):
            return float(self._sizes[index][-1]) * math.sqrt(self._config.fine[-1])
        return self._likeliest(index, likely)

    def _likeliest(self, index: int, likely: FloatArray) -> float:
        """Return the likeliest size of a change."""
        return float(self._between[index][int(np.argmax(likely))])

    def _judge(self) -> None:
        """End the trial, if it can be told what came of it."""
        config = self._config
        parts, likely = self._told()
        best, *others = sorted(range(len(likely)), key=lambda each: -likely[each])
        needed = likely[best] > config.needed * self._later
        decided = not others or likely[best] - likely[others[0]] > math.log(config.decided)
        enough = self._blocks >= config.least and needed and decided
        limit = likely[best] + math.log(config.left)
        at_edge = enough and any(
            each > limit and self._beyond(index, parts[index]) for index, each in enumerate(likely)
        )
        # What is larger than all sizes that were tried out is needed more than it seems.
        at_edge = at_edge or self._larger(best, parts[best])
        if self._blocks >= config.least and self._parts < config.parts and at_edge:
            self._refine()
            return
        self.over = enough or self._blocks >= config.most
        if self.over and needed:
            self.finding = self._found(best, parts[best])

    def _beyond(self, best: int, likely: FloatArray) -> bool:
        """Return whether a change may be larger or smaller than all sizes that were tried out."""
        smaller = len(likely) > 1 and int(np.argmax(likely)) == 0
        return smaller or self._larger(best, likely)

    def _larger(self, best: int, likely: FloatArray) -> bool:
        """Return whether a change may be larger than all sizes that were tried out."""
        last = len(likely) - 1
        may_be = abs(float(self._sizes[best][-1])) < self._changes[best].most
        return last > 0 and may_be and int(np.argmax(likely)) == last

    def _found(self, best: int, likely: FloatArray) -> Finding | None:
        """Return a change with its size, by the likelihood of each that was tried out.

        Returns:
            The change; that it is unknown, where it explains too little of what is strange; None
            where it explains too little of what is not, or may as well be none.
        """
        row = 1 + sum(len(each) for each in self._between[:best]) + int(np.argmax(likely))
        misfit, without = (self._squares[[row, 0]] / max(1, self._count)).tolist()
        config, change = self._config, self._changes[best]
        size, sigma = mean_size(self._between[best], likely)
        off = 0.0 if change.whole else config.off * size
        sigma = math.sqrt(sigma**2 * max(1.0, misfit) + self._before(change) + off**2)
        beyond = math.sqrt(2.0 * max(0.0, float(likely.max() - self._likely[0])))
        if misfit > _LITTLE * without:
            # What is strange for a while only was a stone.
            strange = min(misfit, *self._without[-_STILL:]) > _STRANGE
            return Finding(UNKNOWN, size, sigma, beyond) if strange else None
        if abs(size) < max(config.smallest * change.spread, config.sure * sigma):
            return None
        if change.wholly and abs(self._likeliest(best, likely)) >= change.most:
            return Finding(change.wholly, 1.0, 0.0, beyond)
        return Finding(change.name, size, sigma, beyond)

    def _before(self, change: Change) -> float:
        """Return the variance of a size by what the robot deviated by before."""
        if change.whole:
            return 0.0
        pull = self._information @ change.direction
        share = pull / max(float(change.direction @ pull), 1e-12)
        return float(share @ self._learned.covariance @ share)


def _signs(change: Change) -> tuple[float, ...]:
    """Return to which sides of zero a change may be."""
    return (float(change.sign),) if change.sign else (1.0,) if change.whole else (-1.0, 1.0)


def _sizes(change: Change, size: float, shares: Sequence[float]) -> FloatArray:
    """Return the sizes of a change that are tried out."""
    if change.whole:
        return np.ones(1)
    sizes = np.unique(np.minimum(np.array(shares) * abs(size), change.most))
    return math.copysign(1.0, size) * sizes


def _between(sizes: FloatArray) -> FloatArray:
    """Return sizes (m,), and others between them."""
    parts = [
        np.geomspace(low, high, 1 + math.ceil(abs(math.log(high / low)) / _APART))[:-1]
        for low, high in itertools.pairwise(sizes.tolist())
    ]
    return np.concatenate([*parts, sizes[-1:]])


def _shares(sizes: FloatArray, tried: FloatArray) -> FloatArray:
    """Return shares (g, m) of those tried out (m,) by which sizes (g,) lie between them."""
    return np.column_stack(
        [np.interp(np.abs(sizes), np.abs(tried), each) for each in np.eye(len(tried))]
    )


def mean_size(sizes: FloatArray, likely: FloatArray) -> tuple[float, float]:
    """Return the mean size and its standard deviation.

    Args:
        sizes: (m,) sizes, all of one sign, about the same ratio apart.
        likely: (m,) logarithm of the likelihood of each.
    """
    weights = np.exp(likely - likely.max())
    weights /= weights.sum()
    mean = float(weights @ sizes)
    return mean, math.sqrt(float(weights @ np.square(sizes - mean)))
