"""A motion's own time, slowed tick by tick so that the zero-moment point stays in the footprint.

The reference is a path q(s) in its own time s. The guard chooses how fast that passes: with rate
r = ds/dt the joints go at q' r and accelerate at q'' r^2 + q' dr/dt. The ground's wrench (Thesis
eq. A-5) is then linear in x = r^2 and a = dr/dt, and so is "the zero-moment point is inside an edge
by the reserve". From the end of the horizon backwards follows the largest x at every place
from which the arm can still come to rest with all edges kept; forwards the guard goes as fast as
that allows. The base's tilt is measured anew every tick.
"""

import dataclasses
import math
from collections.abc import Callable

import numba
import numpy as np

from controllers.kinematics.rigid_motion import FrameMotion
from controllers.motion.tipping.tip_over import Footing
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers

Path = Callable[[float], tuple[FloatArray, FloatArray, FloatArray]]
"""Angles [rad], rates [rad/s] and accelerations [rad/s^2] of the joints at a time [s]."""
_HALVINGS = 24  # Halvings of the interval in which the largest squared rate is sought.
_REST_RATE = 1e-3  # A rate below counts as rest.
_ZERO = np.zeros(3)
_NORMAL = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # Part of a wrench that presses.


@dataclasses.dataclass(frozen=True)
class OnlineConfig:
    """Limits and horizon of the guard.

    Attributes:
        reserve: Least distance of the zero-moment point from the polygon's edge [m], as
            `tip_over.GuardConfig` has it.
        brake: Fastest fall of the rate [1/s].
        resume: Fastest rise of the rate [1/s].
        ahead: Horizon along the path, in its own time [s].
        period: Servo tick, and the spacing of the examined places [s].
        tilt_lag: Time constant of the tilt's low pass [s].
        least_weight: Share of the weight that must stay on the ground.
        swing: Factor by which a sudden motion moves the zero-moment point beyond its inertia's
            share, since the base swings through on its springs: 1 + exp(-pi z / sqrt(1 - z^2)) for
            a damping ratio z; the default is for 0.13, the rover's.
    """

    reserve: float = 0.03
    brake: float = 6.0
    resume: float = 2.0
    ahead: float = 1.0
    period: float = 0.01
    tilt_lag: float = 0.1
    least_weight: float = 0.3
    swing: float = 1.66

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number and what is valid.
        """
        check_numbers("online guard", self)


class OnlineGuard:
    """Passes a path on to the arm, slowed where it would tip the rover.

    Args:
        footing: The rover.
        path: The motion, from rest.
        config: Limits and horizon; None for the default.

    Attributes:
        time: Time of the path that is reached [s].
        rate: Rate of the path's time, 0 (rest) to 1 (as requested).
        slowest: Least rate so far.
        late: Delay of the path against the request [s].
        held: Duration of the present rest [s].
        lost: Ticks in which no rate kept half of the reserve, as when the ground yields.
    """

    def __init__(self, footing: Footing, path: Path, config: OnlineConfig | None = None) -> None:
        self._footing, self._path = footing, path
        self._config = config or OnlineConfig()
        self._edges = _edge_rows(footing.polygon, footing.ground)
        # Costly, so done before the first tick as far as it can be.
        self._known: dict[int, FloatArray] = {}
        self._look(0)
        self._up: FloatArray | None = None
        self._reserve, self._floor = self._config.reserve, 1.1 * self._config.reserve
        self._settled = False
        self._acceleration, self._ticks = 0.0, -1
        self.time, self.rate, self.slowest = 0.0, 1.0, 1.0
        self.late, self.held, self.lost = 0.0, 0.0, 0

    @property
    def report(self) -> str:
        """Report of what was slowed; empty if nothing."""
        if self.slowest > 1.0 - 1e-9:
            return ""
        text = f"slowed to {self.slowest:.0%}, {self.late:.2f} s late"
        if self.held > 0.0:
            text = f"slowed to rest, held at {self.time:.2f} s of the motion"
        return text if self.lost == 0 else f"{text}, half the reserve lost for {self.lost} ticks"

    def step(self, still: FrameMotion | None) -> None:
        """Advance by a tick; `at` gives the reference within it.

        Args:
            still: The base at rest, as its inclinometer has it; None or not finite without one: the
                motion is brought to rest until it is measured again.
        """
        config, tick = self._config, self._config.period
        self._ticks += 1
        if self._ticks:
            gone = max(self.rate * tick + 0.5 * self._acceleration * tick**2, 0.0)
            self.time += gone
            self.rate = min(max(self.rate + self._acceleration * tick, 0.0), 1.0)
            self.late += tick - gone
            self.held = self.held + tick if self.rate < _REST_RATE else 0.0
        blind = still is None or not np.all(np.isfinite(still.specific_force))
        if still is not None and not blind:
            force = np.asarray(still.specific_force, dtype=float)
            share = tick / (tick + config.tilt_lag)
            self._up = force if self._up is None else self._up + share * (force - self._up)
        if self._up is None:
            self.rate = self.slowest = self._acceleration = 0.0
            return
        if not self._settled:
            self._begin(self._up)
        first = math.floor(self.time / tick + 1e-9)
        limits = self._viable(first, self._up)
        if self._ticks == 0:
            self.rate = math.sqrt(limits[0])
        self._acceleration = self._choose(first, limits, self._up, blind)
        self.slowest = min(self.slowest, self.rate)

    def at(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angles [rad], rates [rad/s] and accelerations [rad/s^2] of the reference.

        Args:
            time: Time since the first step [s], within the tick that the last one began; beyond it
                the rate is extrapolated.
        """
        since = time - max(self._ticks, 0) * self._config.period
        # A falling rate stays at rest once it is there.
        if self._acceleration < 0.0:
            since = min(since, -self.rate / self._acceleration)
        rate = self.rate + self._acceleration * since
        place = self.time + self.rate * since + 0.5 * self._acceleration * since**2
        angles, slopes, bends = self._path(place)
        return angles, slopes * rate, bends * rate**2 + slopes * self._acceleration

    def _begin(self, up: FloatArray) -> None:
        """Settle the reserve: a motion from a pose that has less may not go further out.

        Half of what it has is left to the dynamics then, so that the arm can be drawn in.
        """
        self._settled = True
        angles = self._path(0.0)[0]
        zero = np.zeros(len(angles))
        here = self._footing.margin(
            self._footing.zero_moment_point(angles, zero, zero, FrameMotion(up, _ZERO, _ZERO))
        )
        self._floor = min(self._floor, here - 1e-3)
        self._reserve = max(min(self._reserve, 0.5 * here), 0.0)

    def _coefficients(self, time: float) -> FloatArray:
        """Return (6, 5): the ground's wrench by a, by x, and by the three of specific force."""
        angles, slopes, bends = self._path(time)
        zero = np.zeros(len(angles))
        free = FrameMotion(_ZERO, _ZERO, _ZERO)
        columns = [
            self._footing.wrench(angles, zero, slopes, free),
            self._footing.wrench(angles, slopes, bends, free),
        ]
        for axis in np.eye(3):
            pulled = FrameMotion(axis, _ZERO, _ZERO)
            columns.append(self._footing.wrench(angles, zero, zero, pulled))
        return np.column_stack(columns)

    def _rows(
        self, wrenches: FloatArray, up: FloatArray, reserve: float, swing: float = 1.0
    ) -> FloatArray:
        """Return (n, k, 3): what must be >= 0 by a, by x, and at rest, from `_coefficients`."""
        by_rates, at_rest = swing * wrenches[..., :2], wrenches[..., 2:] @ up
        matrix = self._edges - reserve * np.outer(np.ones(len(self._edges)), _NORMAL)
        weight = self._config.least_weight * at_rest[..., 2]
        rows = np.concatenate([matrix, _NORMAL[None]])
        values = np.concatenate([rows @ by_rates, (rows @ at_rest[..., None])], axis=-1)
        values[..., -1, 2] -= weight
        return values

    def _look(self, first: int) -> FloatArray:
        """Return (n, 6, 5): the coefficients of the places ahead; those behind are forgotten."""
        config = self._config
        places = range(first, first + math.ceil(config.ahead / config.period) + 1)
        for place in places:
            if place not in self._known:
                self._known[place] = self._coefficients(place * config.period)
        for place in [place for place in self._known if place < first]:
            del self._known[place]
        return np.array([self._known[place] for place in places])

    def _viable(self, first: int, up: FloatArray) -> FloatArray:
        """Return (n,) the largest squared rate at the places ahead from which rest is in reach."""
        config = self._config
        wrenches = self._look(first)
        stable = self._rows(wrenches, up, self._floor)[..., 2].min(axis=1) >= 0.0
        # Beyond the first place where the arm could not stand still it may not go.
        last = len(wrenches) if stable.all() else max(int(np.argmin(stable)), 1)
        limits = np.zeros(len(wrenches))
        rows = self._rows(wrenches[:last], up, self._reserve, config.swing)
        _backward(rows, config.period, config.brake, config.resume, limits)
        return limits

    def _choose(self, first: int, limits: FloatArray, up: FloatArray, blind: bool) -> float:
        """Return the change of the rate in this tick [1/s]."""
        config, tick = self._config, self._config.period
        x = self.rate**2
        # The next place at least half a spacing ahead: a nearer one hardly constrains `a`.
        index = min(math.ceil(self.time / tick + 0.5) - first, len(limits) - 1)
        distance = max((first + index) * tick - self.time, 0.5 * tick)
        least = -min(config.brake, self.rate / tick)
        most = min(config.resume, (1.0 - self.rate) / tick, (limits[index] - x) / (2.0 * distance))
        # Unseen, or at the last place where the arm may stand, it only brakes.
        ending = blind or limits[0] == 0.0
        most = 0.0 if ending else max(least, most)
        # Viable to the full reserve, so that half of it is left to noise and to what is between.
        share = self.time / tick - first
        near = [(1.0 - share) * self._known[first] + share * self._known[first + 1],
                self._known[first + index]]  # fmt: skip
        rows = self._rows(np.array(near), up, 0.5 * self._reserve)
        low, high = _accelerations(rows[0], rows[1], x, 2.0 * distance, least, most)
        if low <= high:
            return low if ending else high
        self.lost += 1
        tried = np.linspace(least, 0.5 * least if ending else most, 33)
        slack = np.min(rows[0, :, :1] * tried + rows[0, :, 1:2] * x + rows[0, :, 2:], axis=0)
        return float(tried[np.argmax(slack)])


def _edge_rows(polygon: FloatArray, ground: float) -> FloatArray:
    """Return (k, 6): the zero-moment point's distance inside each edge times the normal force.

    That is linear in the ground's wrench about the origin.
    """
    ends = np.roll(polygon, -1, axis=0)
    along = (ends - polygon) / np.linalg.norm(ends - polygon, axis=1)[:, None]
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    x, y = inward.T
    zero = np.zeros(len(polygon))
    offset = -np.sum(inward * polygon, axis=1)
    return np.column_stack([ground * x, ground * y, offset, y, -x, zero])


@numba.njit(cache=True)
def _accelerations(rows, after, x, growth, least, most):
    """Return the interval of a in which all is kept here and at the next place.

    It is empty if low > high.

    Rows (k, 3), here and `after`, are by a, by x, and the rest; x here grows by a times `growth`
    until there.
    """
    low, high = least, most
    for k in range(2 * rows.shape[0]):
        row = rows[k] if k < rows.shape[0] else after[k - rows.shape[0]]
        slope, rest = row[0], row[1] * x + row[2]
        if k >= rows.shape[0]:
            slope += row[1] * growth
        if slope > 1e-12:
            low = max(low, -rest / slope)
        elif slope < -1e-12:
            high = min(high, -rest / slope)
        elif rest < 0.0:
            return 1.0, 0.0
    return low, high


@numba.njit(cache=True)
def _backward(rows, spacing, brake, resume, limits):
    """Write the largest squared rates (n,), 0 at the last place, by bisection.

    At rest everything is kept, and what is kept is convex, so all smaller rates are viable too.
    """
    for i in range(rows.shape[0] - 2, -1, -1):
        after = limits[i + 1]
        good, bad = 0.0, 1.0
        for turn in range(_HALVINGS):
            x = bad if turn == 0 else 0.5 * (good + bad)
            growth = 2.0 * spacing
            least, most = max(-brake, -x / growth), min(resume, (after - x) / growth)
            low, high = _accelerations(rows[i], rows[i + 1], x, growth, least, most)
            if low <= high:
                good = x
                if turn == 0:
                    break
            else:
                bad = x
        limits[i] = good
