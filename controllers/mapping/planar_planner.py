"""Next-best views of planar vision systems: the methods of Thesis 3.3.1 and two common ones.

The thesis rates a view by RF = (NI - K (d/D)^n)(1 - P) (eq. 3-15, with the distance d divided by
the depth of field D so that K is dimensionless). A constant K weights path length against
information by a fixed ratio, which suits one environment only: indoors, where views are partly
occluded, the same K selects near views with little new information.

The utility "going_rate" therefore adapts the weight: K = max V / (d + s), the best ratio of
information to path length among the candidates, where s is the path length equivalent to the time
of a scan. With n = 1 the best view is then the one with the largest V / (d + s). This rule has no
scale of its own, so it suits both environments. V is NI with a larger weight of unknown cells
surrounded by known ones, since a later visit to them needs a path of its own.

Several vision systems choose in rounds, independently or by claiming the cells of their next views.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal, TypeAlias, get_args

import numpy as np
from scipy import ndimage

from controllers.mapping import METHODS, Method
from controllers.mapping.planar_situation import (
    Situation,
    believe,
    draw_candidates,
    frontier_cells,
)
from perception.geometry.arrays import BoolArray, FloatArray, IntArray
from perception.geometry.checks import check_choice, check_numbers
from perception.planar.information import (
    READINGS,
    KnownGround,
    Reading,
    new_information,
    undecided_entropy,
)
from perception.planar.map import PlanarMap
from perception.planar.raycast import RangeSensor, expected_view, fan, ray_sums, sector_sums

Utility: TypeAlias = Literal["going_rate", "fixed"]
UTILITIES: tuple[Utility, ...] = get_args(Utility)

NEAR = 2.0
"""Path length within which half of the candidates lie, in depths of field."""
MIN_NEW = 1e-6
"""Least new information or area of a useful view, over that of the whole sector."""
FRONTIER_BATCH = 64
"""Number of frontier cells that are rated together, the nearest first."""
MIN_FRONTIER_AREA = 0.1
"""New area in view, over that of the sector, that makes method frontier stop at a cell."""


@dataclasses.dataclass(frozen=True)
class PlannerConfig:
    """Configuration of the choice of views.

    Attributes:
        sensor: Field of view and depth of field of the vision system.
        method: (i) random, (ii) raster, (iii) max_new, (iv) min_old, (v) information of Thesis
            3.3.1, or frontier (the nearest) and rate.
        reading: Reading of new information, see `perception.planar.information`.
        utility: Rating by method information: "going_rate", or "fixed" for eq. 3-15.
        candidates: Number of positions that are rated.
        headings: Number of headings at each position.
        rays: Number of rays of a full fan, a multiple of ``headings``.
        price: K of eq. 3-15, utility "fixed" only.
        exponent: n of eq. 3-15, utility "fixed" only.
        scan_path: Path length driven in the time of a scan, over the depth of field.
        isolation: Additional weight of an unknown cell amid known ones, utility "going_rate" only.

    Raises:
        ValueError: If a setting is out of range; the message names it.
    """

    sensor: RangeSensor = RangeSensor()
    method: Method = "information"
    reading: Reading = "entropy"
    utility: Utility = "going_rate"
    candidates: int = 150
    headings: int = 24
    rays: int = 240
    price: float = 0.1
    exponent: float = 2.0
    scan_path: float = 1.2
    isolation: float = 2.0

    def __post_init__(self) -> None:
        check_choice("method", self.method, METHODS)
        check_choice("reading", self.reading, READINGS)
        check_choice("utility", self.utility, UTILITIES)
        if self.candidates < 1 or self.headings < 1 or self.rays % self.headings:
            raise ValueError(
                f"candidates {self.candidates}, headings {self.headings}, rays {self.rays}: "
                "expected 1 or more, and rays a multiple of the headings"
            )
        check_numbers("planner", self, "exponent", "scan_path")
        check_numbers("planner", self, "price", "isolation", zero=True)


@dataclasses.dataclass(frozen=True)
class PlannedView:
    """The pose of a next view.

    Attributes:
        cell: Row and column of the pose.
        heading: Direction of the sector's middle from the x axis [rad].
        path: (n, 2) cells from the present one to ``cell``.
        length: Length of the path [m].
        candidates: (m, 2) cells that were rated.
        ratings: (m,) rating of each candidate in its best heading.
    """

    cell: tuple[int, int]
    heading: float
    path: IntArray
    length: float
    candidates: IntArray
    ratings: FloatArray


class ViewPlanner:
    """Chooses the next pose of one vision system on a map.

    Args:
        config: Method and constants.
        generator: Random generator for the candidates.
    """

    def __init__(self, config: PlannerConfig, generator: np.random.Generator) -> None:
        self.config = config
        self._generator = generator
        self._visited: dict[tuple[int, int], int] = {}

    def choose(
        self, world: PlanarMap, cell: tuple[int, int], claimed: BoolArray | None = None
    ) -> PlannedView | None:
        """Choose the next pose.

        All candidates are free (P < 0.05) and reached by a collision-free path on the map.

        Args:
            world: Map of the plane.
            cell: Present row and column.
            claimed: (rows, columns) cells of other robots' next views; they count as known.

        Returns:
            The next view, or None if no pose gives new information.
        """
        config = self.config
        situation = believe(world, cell, config.sensor, config.rays, claimed)
        if config.method == "raster":
            return self._next_in_raster(situation, cell)
        if config.method == "random":
            return self._anywhere(situation)
        if config.method == "frontier":
            return self._nearest_frontier(situation)
        near = NEAR * config.sensor.depth
        drawn = draw_candidates(situation, config.candidates, near, self._generator)
        view = self._best_view(situation, drawn)
        if view is None:
            # No candidate gives new information; a frontier cell may.
            cells = frontier_cells(situation)
            if len(cells) > config.candidates:
                cells = self._generator.choice(cells, config.candidates, replace=False)
            view = self._best_view(situation, cells)
        return view

    def _best_view(self, situation: Situation, cells: IntArray) -> PlannedView | None:
        if len(cells) == 0:
            return None
        by_area = self.config.method in ("max_new", "min_old")
        rate = _rate_by_area if by_area else _rate_by_information
        ratings, worthwhile = rate(self.config, situation, cells)
        if not worthwhile.any():
            return None
        ratings = np.where(worthwhile, ratings, -np.inf)
        index, heading = divmod(int(np.argmax(ratings)), ratings.shape[1])
        return self._view(situation, cells, index, heading, ratings.max(axis=1))

    def _anywhere(self, situation: Situation) -> PlannedView:
        """Method (i): a random reachable cell and heading."""
        cells = np.argwhere(np.isfinite(situation.paths.lengths))
        index = int(self._generator.integers(len(cells)))
        heading = int(self._generator.integers(self.config.headings))
        return self._view(situation, cells[index : index + 1], 0, heading, np.zeros(1))

    def _next_in_raster(self, situation: Situation, cell: tuple[int, int]) -> PlannedView | None:
        """Method (ii): a full turn at each free lattice point, row by row, then a finer lattice."""
        turn = math.ceil(2.0 * math.pi / self.config.sensor.fov - 1e-9)
        count = self._visited.get(cell, 0)
        if count >= turn:
            target = self._next_lattice_point(situation, cell)
            if target is None:
                return None
            cell, count = target, 0
        self._visited[cell] = count + 1
        heading = round(count * self.config.headings / turn)
        return self._view(situation, np.array([cell]), 0, heading, np.zeros(1))

    def _next_lattice_point(
        self, situation: Situation, cell: tuple[int, int]
    ) -> tuple[int, int] | None:
        free = np.isfinite(situation.paths.lengths)
        pitch = max(1, round(self.config.sensor.depth / situation.cell))
        while pitch >= 1:
            first = pitch // 2
            points = first + pitch * np.argwhere(free[first::pitch, first::pitch])
            points = [(int(r), int(c)) for r, c in points if (int(r), int(c)) not in self._visited]
            if points:
                return next((point for point in points if point > cell), points[0])
            pitch //= 2
        return None

    def _nearest_frontier(self, situation: Situation) -> PlannedView | None:
        """Choose the nearest frontier cell with enough new area in view.

        Without this threshold every small unknown area nearby would get a scan of its own. Where no
        cell has enough, the one with the largest new area is chosen.
        """
        cells = frontier_cells(situation)
        cells = cells[np.argsort(situation.distance(cells), kind="stable")]
        gains = np.zeros((len(cells), self.config.headings))
        for first in range(0, len(cells), FRONTIER_BATCH):
            batch = slice(first, first + FRONTIER_BATCH)
            gains[batch], _ = new_and_old_area(self.config, situation, cells[batch])
            if gains[batch].max() >= MIN_FRONTIER_AREA:
                break
        best = gains.max(axis=1, initial=0.0)
        if not (best > MIN_NEW).any():
            return None
        enough = best >= MIN_FRONTIER_AREA
        index = int(np.argmax(enough if enough.any() else best))
        return self._view(situation, cells, index, int(np.argmax(gains[index])), best)

    def _view(
        self, situation: Situation, cells: IntArray, index: int, heading: int, ratings: FloatArray
    ) -> PlannedView:
        cell = int(cells[index, 0]), int(cells[index, 1])
        path = situation.paths.to(cell)
        angle = 2.0 * math.pi * heading / self.config.headings
        return PlannedView(cell, angle, path, float(situation.paths.lengths[cell]), cells, ratings)


def new_and_old_area(
    config: PlannerConfig, situation: Situation, cells: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the unknown and the known area in view, over that of the whole sector.

    Args:
        config: Sensor and headings.
        situation: Estimate of the map.
        cells: (n, 2) rows and columns of the views.

    Returns:
        New and old area, both (n, headings).
    """
    layers = np.stack([~situation.known, situation.known]).astype(float)
    sums = ray_sums(layers, situation.opaque, cells, situation.table)
    new, old = sector_sums(sums, config.sensor.fov, config.headings) / config.sensor.area
    return new, old


Rated: TypeAlias = tuple[FloatArray, BoolArray]
"""(n, headings) ratings, and whether each view gives new information."""


def _rate_by_area(config: PlannerConfig, situation: Situation, cells: IntArray) -> Rated:
    """Rate views by area: methods (iii) max_new and (iv) min_old.

    Method (iii) maximises the expected new area, whatever the path to it. Method (iv) minimises the
    known area among views with any new area: without that condition it would always face the
    nearest wall.
    """
    new, old = new_and_old_area(config, situation, cells)
    return new if config.method == "max_new" else -old, new > MIN_NEW


def _rate_by_information(config: PlannerConfig, situation: Situation, cells: IntArray) -> Rated:
    """Rate views by expected information against the length of the path: methods (v) and rate."""
    distance = situation.distance(cells) / config.sensor.depth
    occupied = situation.probability[cells[:, 0], cells[:, 1]]
    information, undecided, weight = expected_information(config, situation, cells)
    if config.method == "information" and config.utility == "fixed":
        rating = fixed_price_rating(information, distance, occupied, config.price, config.exponent)
    else:
        worth = information if config.method == "rate" else information * weight
        rating = rate_rating(worth, distance, occupied, config.scan_path)
    return rating, undecided > MIN_NEW


def expected_information(
    config: PlannerConfig, situation: Situation, cells: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the expected information of views.

    Args:
        config: Sensor, reading and headings.
        situation: Estimate of the map.
        cells: (n, 2) rows and columns of the views.

    Returns:
        Three arrays (n, headings), which are NI in the configured reading; NI in the reading
        "entropy", 0 where all is decided; and the mean isolation weight of the undecided ground
        in view, the same for every reading.
    """
    sensor = config.sensor
    worth = undecided_entropy(situation.probability, situation.known)
    width = round(sensor.depth / situation.cell)
    weights = isolation_weights(situation.known, width, config.isolation)
    layers = np.stack([worth, worth * weights])
    sums = ray_sums(layers, situation.opaque, cells, situation.table)
    undecided, weighted = sector_sums(sums, sensor.fov, config.headings) / sensor.area
    weight = np.where(undecided > MIN_NEW, weighted / np.maximum(undecided, MIN_NEW), 1.0)
    if config.reading == "entropy":
        return undecided, undecided, weight
    ground = KnownGround(situation.probability, situation.known, situation.opaque)
    information = new_information(
        config.reading, ground, cells, situation.table, sensor, config.headings
    )
    return information, undecided, weight


def fixed_price_rating(
    information: FloatArray,
    distance: FloatArray,
    probability: FloatArray,
    price: float,
    exponent: float,
) -> FloatArray:
    """Rate views by Thesis eq. 3-15, a fixed price of distance.

    (1 - P) multiplies positive ratings only: it would raise a negative one of an occupied cell.

    Args:
        information: (n, headings) NI.
        distance: (n,) length of the path there over the depth of field, d / D.
        probability: (n,) P that the pose is occupied.
        price: Price K of the distance.
        exponent: Exponent n of the distance.

    Returns:
        (n, headings) ratings.
    """
    rating = information - price * distance[:, None] ** exponent
    return np.where(rating > 0.0, rating * (1.0 - probability[:, None]), rating)


def rate_rating(
    information: FloatArray, distance: FloatArray, probability: FloatArray, scan_path: float
) -> FloatArray:
    """Rate views by information over path and time, NI (1 - P) / (d / D + s / D).

    Args:
        information: (n, headings) NI or a weighted one.
        distance: (n,) length of the path there over the depth of field, d / D.
        probability: (n,) P that the pose is occupied.
        scan_path: Path length equivalent to a scan over the depth of field, s / D = v t_scan / D.

    Returns:
        (n, headings) ratings.
    """
    return information * ((1.0 - probability) / (distance + scan_path))[:, None]


def isolation_weights(known: BoolArray, width: int, gain: float) -> FloatArray:
    """Return the weight of cells by the share of known cells around them.

    Args:
        known: (rows, columns) measured cells; outside the map all cells count as known.
        width: Side of the square neighbourhood [cells], made odd.
        gain: Additional weight of a cell amid known ones only.

    Returns:
        (rows, columns) 1 + gain * share of known cells around.
    """
    share = ndimage.uniform_filter(known.astype(float), width | 1, mode="constant", cval=1.0)
    return 1.0 + gain * np.clip(share, 0.0, 1.0)


class PlanarTeam:
    """Equal robots that share a map and choose their next poses in rounds.

    In a round every robot chooses a pose, drives there and scans. Cooperating robots choose one
    after the other; each claims the cells expected in its view, which the next ones then ignore.
    Independent robots choose by the map alone. Robots neither occlude each other's views nor block
    each other's paths.

    Args:
        robots: Number of robots.
        config: Configuration of every planner.
        generator: Random generator that is split among the robots.
        cooperative: Whether robots claim the cells of their next views.

    Raises:
        ValueError: If there is no robot.
    """

    def __init__(
        self,
        robots: int,
        config: PlannerConfig,
        generator: np.random.Generator,
        cooperative: bool = True,
    ) -> None:
        if robots < 1:
            raise ValueError(f"robots: expected 1 or more, got {robots}")
        self._config, self._cooperative = config, cooperative
        self._planners = [ViewPlanner(config, child) for child in generator.spawn(robots)]

    def choose(
        self, world: PlanarMap, cells: Sequence[tuple[int, int]]
    ) -> list[PlannedView | None]:
        """Choose the next pose of every robot.

        Args:
            world: Common map of the robots.
            cells: Present row and column of each robot.

        Returns:
            Next view of each robot; None where no pose gives new information.

        Raises:
            ValueError: If the number of cells is not that of the robots.
        """
        if len(cells) != len(self._planners):
            raise ValueError(f"cells: expected {len(self._planners)}, got {len(cells)}")
        sensor = self._config.sensor
        table = fan(sensor.depth, world.grid.cell, self._config.rays)
        opaque = world.measured & (world.probability() >= world.model.occupied_above)
        claimed = np.zeros(world.grid.shape, dtype=bool) if self._cooperative else None
        views: list[PlannedView | None] = []
        for planner, cell in zip(self._planners, cells):
            view = planner.choose(world, cell, claimed)
            views.append(view)
            if view is not None and claimed is not None:
                claimed |= expected_view(opaque, view.cell, view.heading, sensor.fov, table)
        return views
