"""Search for the target by driving: where it may be, and which view is worth its time.

A rover knows roughly where it began, so where the target stands is a cloud of possible places in
its own frame. Each view without the target makes those places unlikely in which it would have been
seen. The next view is the one with the best chance of seeing it a second, as the rate is one of the
methods of chapter 3: a view from here takes the head's turn, one from elsewhere the drive as well.
"""

import dataclasses
import math
from typing import NamedTuple

import cv2
import numba
import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import BoolArray, FloatArray, IntArray

_LINE = 0.05, 0.93  # Parts of a line of sight between which the ground may hide its end.
_UNLIKELY = 0.02  # Odds of a place over those of the mean one below which it is not looked at.
_AROUND = 0.11  # Half the side of the square about a place in which something of it stands [m].
_BELOW = 0.1  # Height below its middle that something of a target reaches [m].
_KNOWN = 0.6  # Share of that square that must be mapped to tell that nothing stands there.
_LEAST = 1e-6  # Odds below which a target is not where it seems to be.


@dataclasses.dataclass(frozen=True)
class PanelSearchConfig:
    """When a target is seen, and what a view costs.

    Attributes:
        reach: Nearest and farthest distance at which the target localizes the rover [m].
        sight: Farthest distance at which a view at rest shows where it is [m].
        slant: Largest angle of the view with the face's normal [rad].
        half_view: Half of the angle across within which it is detected, about the camera's axis
            [rad].
        half_height: The same upright [rad].
        missed: Odds that a view at rest misses a target that it should see, where `reach` ends and
            where `sight` does; in between by the distance.
        passed: Least odds of one on the way: images are blurred, and one pair follows the other so
            soon that they miss it for the same reason.
        opaque: Odds that something unmapped hides the target.
        empty: Odds that a target stands where the map shows nothing but ground.
        same: Distance within which a camera sees what it saw before [m].
        view_time: Time that a view from the present place takes [s].
        speed: Speed of a drive [m/s] along what its path costs: about twice its length.
        keeping: How many times as good as another a view may be that was decided on before, and is
            kept: a rover that decides anew at each stop goes to and fro.
        start_time: Time that a drive takes beside its length [s]: turns, and the fall of the tilt.
        windows: Directions in which a place's views are tried.
        likely: Odds that something stands within `about` of a place from which on it is kept off.
        about: Distance within which those odds are summed [m].
        grain: Side of the squares in which places are counted [m].
        sighted: Odds that the target is where it was sighted.
        sight_sigma: Deviations of its place [m] and of its face's direction [rad] from a possible
            place within which a sighting is believed: the places lie some centimetres apart.
    """

    reach: tuple[float, float] = (0.45, 1.9)
    sight: float = 4.0
    slant: float = math.radians(55.0)
    half_view: float = math.radians(15.0)
    half_height: float = math.radians(10.0)
    missed: tuple[float, float] = (0.1, 0.6)
    passed: float = 0.7
    opaque: float = 0.15
    empty: float = 0.02
    same: float = 0.3
    view_time: float = 4.0
    speed: float = 0.2
    keeping: float = 2.0
    start_time: float = 8.0
    windows: int = 36
    likely: float = 0.15
    about: float = 0.3
    grain: float = 0.15
    sighted: float = 0.95
    sight_sigma: tuple[float, float] = (0.15, 0.2)


class Viewpoint(NamedTuple):
    """A place to look from, and where to.

    Attributes:
        place: (2,) of the camera [m].
        target: (3,) point to look at [m].
        chance: Chance of seeing the target in one view.
        rate: Chance of seeing it a second, with all views that the place offers [1/s].
        shown: (N,) possible places of the target that the view would show.
    """

    place: FloatArray
    target: FloatArray
    chance: float
    rate: float
    shown: BoolArray


class Ground(NamedTuple):
    """What is mapped of the ground, for lines of sight.

    Attributes:
        heights: (rows, columns) heights [m]; NaN where unknown.
        corner: (2,) lowest corner [m].
        cell: Side of a cell [m].
    """

    heights: FloatArray
    corner: FloatArray
    cell: float

    def hidden(self, eye: FloatArray, points: FloatArray) -> BoolArray:
        """Return (N,), whether the mapped ground hides points (N, 3) [m] from an eye (3,) [m]."""
        return _hidden(self.heights, self.corner, self.cell, eye, np.atleast_2d(points))

    def empty(self, points: FloatArray) -> BoolArray:
        """Return (N,), whether nothing mapped reaches up to points (N, 3) [m] about their feet."""
        side = 2 * round(_AROUND / self.cell) + 1
        known = np.isfinite(self.heights)
        highest = cv2.dilate(np.where(known, self.heights, -1e3), np.ones((side, side)))
        share = cv2.blur(known.astype(np.float64), (side, side), borderType=cv2.BORDER_CONSTANT)
        columns, rows = np.floor((points[:, :2] - self.corner) / self.cell).astype(int).T
        inside = (rows >= 0) & (rows < known.shape[0]) & (columns >= 0) & (columns < known.shape[1])
        empty = np.zeros(len(points), bool)
        at = rows[inside], columns[inside]
        empty[inside] = (np.asarray(share)[at] > _KNOWN) & (
            np.asarray(highest)[at] < points[inside, 2]
        )
        return empty


@numba.njit(cache=True)
def _hidden(heights, corner, cell, eye, points):
    """Return (N,), whether heights of the ground are above the lines from an eye to points."""
    hidden = np.zeros(len(points), np.bool_)
    first, last = _LINE
    for i, point in enumerate(points):
        along = point - eye
        steps = max(2, math.ceil(math.hypot(along[0], along[1]) / cell))
        for step in range(steps):
            share = first + (last - first) * step / (steps - 1)
            column = math.floor((eye[0] + share * along[0] - corner[0]) / cell)
            row = math.floor((eye[1] + share * along[1] - corner[1]) / cell)
            inside = 0 <= row < heights.shape[0] and 0 <= column < heights.shape[1]
            if inside and heights[row, column] > eye[2] + share * along[2]:
                hidden[i] = True
                break
    return hidden


class Cloud(NamedTuple):
    """Possible places of the target.

    Attributes:
        places: (N, 3) middles of its face [m].
        normals: (N, 2) unit vectors out of its face, on the ground.
        frames: (N, 3) x, y [m] and yaw [rad] of the site's ground frame, if it is at each place.
    """

    places: FloatArray
    normals: FloatArray
    frames: FloatArray


class PanelSearch:
    """Search for the target among the places where it may be.

    Args:
        cloud: Possible places of the target.
        config: When it is seen, and what a view costs; None for the default.

    Attributes:
        places: (N, 3) possible middles of the target's face [m]; their heights may be updated.
        weights: (N,) odds of each place; they sum to 1.
        views: Number of views without the target.
        within: Distance from which a sighted target is to be seen, as views from farther away told
            too little of it [m].
        hiding: (K, 3) discs of the site that hide what is behind them, as another robot does: x, y
            and radius [m], in its ground frame.
    """

    def __init__(self, cloud: Cloud, config: PanelSearchConfig | None = None) -> None:
        self.places, self._normals, self._frames = (part.copy() for part in cloud)
        self._seen: IntArray | None = None  # Indices of the places of the latest sighting.
        self._config = config or PanelSearchConfig()
        self.weights = np.full(len(self.places), 1.0 / len(self.places))
        self.views = 0
        self.within = math.inf
        self.hiding = np.zeros((0, 3))
        self._eye = np.full(2, np.inf)  # From where views were taken last, and what they showed.
        self._tried = np.zeros(len(self.places), bool)
        # Places where nothing stands, and those for which that tells nothing more.
        self._empty = np.zeros(len(self.places), bool)
        self._spot: FloatArray | None = None  # Where it was sighted last.
        # Discs of the site and what they made likely, until the next view.
        self._found: tuple[FloatArray, FloatArray] | None = None

    @property
    def mean(self) -> FloatArray:
        """(3,) mean place of the target [m]."""
        return self.weights @ self.places

    def odds_within(self, place: FloatArray, distance: float) -> float:
        """Return the odds that the target is within a distance [m] of a place (2,) [m]."""
        away = np.linalg.norm(self.places[:, :2] - place, axis=1)
        return float(self.weights[away < distance].sum())

    def likely_discs(self, discs: FloatArray) -> FloatArray:
        """Return (M, 3) discs that a rover keeps off, for something likely stands there [m].

        Args:
            discs: (K, 3) discs of the site: x, y and radius [m], in its ground frame.
        """
        if self._found is not None and np.array_equal(self._found[0], discs):
            return self._found[1]
        c, kept = self._config, [np.zeros((0, 3))]
        for x, y, radius in discs:
            spots = self._spots(x, y)
            cells = np.round(spots / c.grain).astype(int)
            found, which = np.unique(cells, axis=0, return_inverse=True)
            odds = np.bincount(which, self.weights)
            near = np.linalg.norm(c.grain * (found[:, None] - found), axis=2) < c.about
            middles = c.grain * found[near @ odds > c.likely]
            kept.append(np.column_stack([middles, np.full(len(middles), radius)]))
        self._found = discs.copy(), np.concatenate(kept)
        return self._found[1]

    def draw_places(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, 2) places that look at the faces of likely targets [m].

        Args:
            count: Number of places.
            rng: Random generator for the places.
        """
        chosen = rng.choice(len(self.weights), count, p=self.weights)
        far = rng.uniform(0.5, 0.9, count) * self._reach
        turn = rng.uniform(-0.8, 0.8, count) * self._config.slant
        c, s = np.cos(turn), np.sin(turn)
        x, y = self._normals[chosen].T
        away = np.column_stack([c * x - s * y, s * x + c * y])
        return self.places[chosen, :2] + far[:, None] * away

    def miss(
        self,
        transform_camera_to_frame: RigidTransform,
        ground: Ground,
        intended: Viewpoint | None = None,
        far: bool = False,
    ) -> None:
        """Take note of a view that did not show the target.

        Args:
            transform_camera_to_frame: Pose of the left camera.
            ground: What is mapped of the ground.
            intended: View that was to be taken, which the joints may not quite reach; None for one
                on the way.
            far: Whether a view on the way was searched for a target far away.
        """
        c, eye = self._config, np.asarray(transform_camera_to_frame.translation)
        axis = transform_camera_to_frame.rotation.apply([0.0, 0.0, 1.0])
        bearing, raised = _directions(self.places - eye)
        turn, tilt = _directions(axis[None])
        within = (_apart(bearing, turn) < c.half_view) & (abs(raised - tilt) < c.half_height)
        reach = c.reach[1] if intended is None and not far else self._reach
        seen = within & self._visible(eye, reach) & ~ground.hidden(eye, self.places)
        odds = self._missed(eye)
        if intended is None:
            odds = np.maximum(odds, c.passed)
        else:
            # Another view from the same place shows no more: what hid the target still does.
            seen = (seen | intended.shown) & ~self._tried_from(eye[:2])
            self._tried = seen | self._tried_from(eye[:2])
            self._eye = eye[:2].copy()
        self.weights *= np.where(seen, odds + c.opaque - odds * c.opaque, 1.0)
        self.weights /= self.weights.sum()
        self._found = None
        self.views += 1

    def stands(self, ground: Ground) -> None:
        """Take note of where the map shows that no target stands.

        Args:
            ground: What is mapped of the ground.
        """
        empty = ground.empty(self.places - [0.0, 0.0, _BELOW]) & ~self._empty
        self._empty |= empty
        self.weights *= np.where(empty, self._config.empty, 1.0)
        self.weights /= self.weights.sum()
        self._found = None

    def in_sight(self, eye: FloatArray, ground: Ground) -> FloatArray:
        """Return the places (M, 3) at which the target, even far away, shows itself [m].

        Args:
            eye: (3,) position of the camera [m].
            ground: What is mapped of the ground.
        """
        likely = self.weights * len(self.weights) > _UNLIKELY
        places = self.places[likely & self._visible(eye, self._config.sight)]
        return places[~ground.hidden(eye, places)]

    def sight(self, *seen: Cloud) -> None:
        """Take note of where a view shows the target, too far away to localize the rover by it.

        What was less likely before gives way to where it is seen; so do places of sightings before.

        Args:
            seen: Possible places by what the view tells, one cloud for each pose of the target that
                fits it; together as many each time, and fewer than those before.
        """
        c = self._config
        supports = np.array([self._support(cloud) for cloud in seen])
        if supports.sum() < _LEAST:
            return  # Nothing may stand there.
        places, normals, frames = (np.concatenate(parts) for parts in zip(*seen, strict=True))
        if self._seen is None:
            self._seen = np.argsort(self.weights, kind="stable")[: len(places)]
        self.places[self._seen], self._normals[self._seen] = places, normals
        self._frames[self._seen] = frames
        self.weights[self._seen] = 0.0
        self.weights *= (1.0 - c.sighted) / max(self.weights.sum(), _LEAST)
        counts = np.array([len(cloud.places) for cloud in seen])
        shares = np.repeat(supports / (supports.sum() * counts), counts)
        self.weights[self._seen] = c.sighted * shares
        self.weights /= self.weights.sum()
        self._tried[self._seen] = False
        self._empty[self._seen] = True  # What is seen stands there, whatever the map shows.
        self._spot = shares @ places[:, :2]
        self._found = None

    def _support(self, seen: Cloud) -> float:
        """Return the odds, as known before, of places like those of a sighting."""
        far, turn = self._config.sight_sigma
        place, normal = seen.places.mean(axis=0), seen.normals.mean(axis=0)
        away = np.linalg.norm(self.places[:, :2] - place[:2], axis=1)
        turned = np.arccos(np.clip(self._normals @ normal / np.linalg.norm(normal), -1.0, 1.0))
        return float(self.weights @ np.exp(-0.5 * ((away / far) ** 2 + (turned / turn) ** 2)))

    def best(
        self,
        places: FloatArray,
        lengths: FloatArray,
        height: FloatArray,
        ground: Ground,
        wanted: FloatArray | None = None,
    ) -> Viewpoint:
        """Return the view with the best rate.

        Args:
            places: (M, 2) places from which views are possible [m]; the first is the present one.
            lengths: (M,) length of the path to each [m].
            height: (M,) height of the camera at each [m].
            ground: What is mapped of the ground.
            wanted: (2,) place of the view decided on before, one of them [m]; None for none.
        """
        c = self._config
        best, worth = None, 0.0
        turns = np.linspace(-math.pi, math.pi, c.windows, endpoint=False)
        tilts = np.arange(-1.2, 0.6, c.half_height)
        for place, length, z in zip(places, lengths, height, strict=True):
            eye = np.array([*place, z])
            seen = self._visible(eye, self._reach) & ~self._tried_from(place)
            seen[seen] = ~ground.hidden(eye, self.places[seen])
            odds = (self.weights * (1.0 - self._missed(eye)))[seen] * (1.0 - c.opaque)
            if not len(odds):
                continue
            bearing, raised = _directions(self.places[seen] - eye)
            across = _apart(bearing, turns[:, None]) < c.half_view
            upright = abs(raised - tilts[:, None]) < c.half_height
            chances = (across * odds) @ upright.T
            first = np.unravel_index(int(np.argmax(chances)), chances.shape)
            chance = float(chances[first])
            # How many views it takes to try all that can be seen from there.
            views = max(1, round(float(odds.sum()) / chance)) if chance > 0.0 else 1
            drive = c.start_time + length / c.speed if length > 0.0 else 0.0
            rate = max(
                float(odds.sum()) / (drive + views * c.view_time), chance / (drive + c.view_time)
            )
            weighed = rate
            if wanted is not None and np.array_equal(place, wanted):
                weighed *= c.keeping
            if best is None or weighed > worth:
                worth = weighed
                inside = across[first[0]] & upright[first[1]]
                shown = np.zeros(len(self.weights), bool)
                shown[np.flatnonzero(seen)[inside]] = True
                middle = odds[inside] @ self.places[shown] / max(odds[inside].sum(), 1e-12)
                best = Viewpoint(place, middle, chance, rate, shown)
        if best is None:
            nothing = np.zeros(len(self.weights), bool)
            return Viewpoint(places[0], self.mean, 0.0, 0.0, nothing)
        return best

    def _tried_from(self, place: FloatArray) -> BoolArray:
        """Return (N,), which places views have shown already from near a place (2,) [m]."""
        if np.linalg.norm(place - self._eye) > self._config.same:
            return np.zeros(len(self.weights), bool)
        return self._tried

    @property
    def sighted(self) -> bool:
        """Whether the target likely is where it was sighted."""
        if self._spot is None:
            return False
        return self.odds_within(self._spot, 3.0 * self._config.sight_sigma[0]) > 0.5  # noqa: PLR2004

    @property
    def _reach(self) -> float:
        """Farthest distance of a view at rest that tells what is to be known next [m]."""
        near, far = self._config.reach[1], self._config.sight
        return min(max(self.within, near), far) if self.sighted else far

    def _missed(self, eye: FloatArray) -> FloatArray:
        """Return (N,) the odds that a view at rest misses the target at each place."""
        c, distance = self._config, np.linalg.norm(eye - self.places, axis=1)
        return np.interp(distance, (c.reach[1], c.sight), c.missed)

    def _visible(self, eye: FloatArray, reach: float) -> BoolArray:
        """Return (N,), whether the target at each place would show its face to an eye (3,)."""
        away = eye - self.places
        distance = np.linalg.norm(away, axis=1)
        facing = np.sum(away[:, :2] * self._normals, axis=1) / np.hypot(*away[:, :2].T)
        within = (distance > self._config.reach[0]) & (distance < reach)
        within &= facing > math.cos(self._config.slant)
        for x, y, radius in self.hiding:
            spots, line = self._spots(x, y) - eye[:2], -away[:, :2]
            along = np.sum(spots * line, axis=1) / np.sum(line * line, axis=1)
            foot = np.clip(along, 0.0, 1.0)[:, None] * line
            within &= np.linalg.norm(foot - spots, axis=1) > radius
        return within

    def _spots(self, x: float, y: float) -> FloatArray:
        """Return where a place of the site is (N, 2) [m], if the target is at each place."""
        cosine, sine = np.cos(self._frames[:, 2]), np.sin(self._frames[:, 2])
        turned = np.column_stack([cosine * x - sine * y, sine * x + cosine * y])
        return self._frames[:, :2] + turned


def _directions(away: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bearings and elevations (N,) of vectors (N, 3) [rad]."""
    flat = np.hypot(away[:, 0], away[:, 1])
    return np.arctan2(away[:, 1], away[:, 0]), np.arctan2(away[:, 2], flat)


def _apart(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between bearings [rad]."""
    apart = np.abs(first - second) % (2.0 * math.pi)
    return np.minimum(apart, 2.0 * math.pi - apart)
