"""Next view of a stereo head on an arm: candidates, whether they can be reached, and their rating.

Thesis section 3.2.4: a candidate must be free of collision (P < 0.05) and reached by a path free
of collision, and is rated by RF = (NI - K (d / D)^n) (1 - P) (eq. 3-15).
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import BoolArray, FloatArray
from perception.voxels.views import (
    PlanningGrid,
    claimed_by_view,
    expected_occupancy,
    view_information,
)

_PATHS = 50
"""Paths checked at once: enough that calls cost little, few enough that little is in vain."""
Collides = Callable[[FloatArray], BoolArray]
"""Of points (N, 3) [m] in the world, which may not be free (P >= 0.05)."""


@dataclasses.dataclass(frozen=True)
class ViewConfig:
    """How views are drawn and rated.

    Attributes:
        candidates: Drawn for each decision.
        price: K of eq. 3-15, against the best candidate's information.
        exponent: n of eq. 3-15.
        step: Greatest turn of a joint between two checks of a path [rad].
        survey: (joints,) where the arm stands for a raster but for its yaw and wrist [rad]: the
            head high, its view half a radian below the horizon.
        raster_yaw: Turn between the columns of a raster [rad]: views overlap by a third.
        raster_tilt: Turn between its rows [rad].
        raster_rows: How many there are.
    """

    candidates: int = 200
    price: float = 0.1
    exponent: float = 2.0
    step: float = 0.1
    survey: tuple[float, float, float, float] = (0.0, 1.3, -0.9, -0.9)
    raster_yaw: float = 0.5
    raster_tilt: float = 0.4
    raster_rows: int = 3


@dataclasses.dataclass(frozen=True)
class ViewRays:
    """What a stereo head sees.

    Attributes:
        rays: (R, 3) unit vectors over the field of view, camera frame.
        reach: Nearest and farthest measurable distance [m].
    """

    rays: FloatArray
    reach: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class RatedViews:
    """Candidates of one decision.

    Attributes:
        angles: (N, joints) [rad].
        ratings: (N,); the first is the best.
        information: (N,) [bit].
        cameras: N transforms from camera to world.
    """

    angles: FloatArray
    ratings: FloatArray
    information: FloatArray
    cameras: RigidTransform


class ViewError(RuntimeError):
    """No view can be reached."""


@dataclasses.dataclass(frozen=True)
class ArmViews:
    """Views that one robot's arm can take.

    Attributes:
        arm: Its kinematics.
        transform_robot_to_world: Where the robot stands.
        lens: What the head sees.
        config: How views are drawn and rated.
    """

    arm: SerialChain
    transform_robot_to_world: RigidTransform
    lens: ViewRays
    config: ViewConfig = ViewConfig()

    def cameras(self, angles: FloatArray) -> RigidTransform:
        """Return the transforms from camera to world for angles (N, joints) [rad]."""
        return self.transform_robot_to_world * self.arm.tool_in_robot(angles)

    def body(self, angles: FloatArray) -> FloatArray:
        """Return points (N, K, 3) [m] that stand for the arm, world, for angles (N, joints)."""
        points = self.arm.cover_points(angles)
        world = self.transform_robot_to_world.apply(points.reshape(-1, 3))
        return world.reshape(points.shape)

    def is_free(self, angles: FloatArray, collides: Collides) -> BoolArray:
        """Return (N,), whether the arm touches nothing with angles (N, joints) [rad]."""
        bodies = self.body(angles)
        hit = collides(bodies.reshape(-1, 3)).reshape(bodies.shape[:2])
        return np.logical_not(np.any(hit, axis=1))

    def path(self, start: FloatArray, goal: FloatArray) -> FloatArray:
        """Return (M, joints) angles of a straight path in joint space, both ends included [rad]."""
        count = max(2, 1 + int(np.ceil(np.abs(goal - start).max() / self.config.step)))
        return np.linspace(start, goal, count)

    def are_reachable(self, start: FloatArray, goals: FloatArray, collides: Collides) -> BoolArray:
        """Return (N,), whether the straight paths to goals (N, joints) [rad] are free."""
        paths = [self.path(start, goal) for goal in goals]
        free = self.is_free(np.concatenate(paths), collides)
        begins = np.cumsum([0, *(len(path) for path in paths[:-1])])
        return np.logical_and.reduceat(free, begins)

    def draw(
        self, start: FloatArray, collides: Collides, count: int, rng: np.random.Generator
    ) -> FloatArray:
        """Draw views that can be reached from where the arm is.

        Args:
            start: (joints,) present angles [rad].
            collides: Tells what is not free.
            count: Number of views wanted; fewer come back where space is narrow.
            rng: Source of randomness.

        Returns:
            (N, joints) angles [rad].

        Raises:
            ViewError: If there is none.
        """
        low, high = self.arm.limits.T
        found: list[FloatArray] = []
        # Most of the joint space lies in the ground or in the robot itself.
        for _ in range(20):
            drawn = rng.uniform(low, high, (4 * count, len(low)))
            free = drawn[self.is_free(drawn, collides)]
            for first in range(0, len(free), _PATHS):
                goals = free[first : first + _PATHS]
                found.extend(goals[self.are_reachable(start, goals, collides)])
                if len(found) >= count:
                    return np.array(found[:count])
        if not found:
            raise ViewError("no view can be reached without touching what may not be free")
        return np.array(found)

    def rate(
        self,
        grid: PlanningGrid,
        claims: BoolArray | None,
        start: FloatArray,
        angles: FloatArray,
    ) -> RatedViews:
        """Rate views by eq. 3-15, and sort them, the best first.

        Args:
            grid: What is known.
            claims: (nx, ny, nz), which cells another robot is about to see; None for none.
            start: (joints,) present angles [rad].
            angles: (N, joints) of the views [rad].
        """
        occupancy = unclaimed(grid, claims)
        cameras = self.cameras(angles)
        information = view_information(grid, occupancy, cameras, self.lens.rays, self.lens.reach)
        span = np.linalg.norm(np.ptp(self.arm.limits, axis=1))
        distance = np.linalg.norm(angles - start, axis=1) / span
        best = max(float(information.max()), 1e-9)
        ratings = information / best - self.config.price * distance**self.config.exponent
        order = np.argsort(-ratings)
        return RatedViews(angles[order], ratings[order], information[order], cameras[order])

    def claims(self, grid: PlanningGrid, claims: BoolArray | None, angles: FloatArray) -> BoolArray:
        """Return (nx, ny, nz) claims with those of one view (joints,) [rad] added."""
        occupancy = unclaimed(grid, claims)
        camera = self.cameras(angles[None])[0]
        seen = claimed_by_view(grid, occupancy, camera, self.lens.rays, self.lens.reach)
        return seen if claims is None else np.logical_or(seen, claims)

    def raster(self) -> FloatArray:
        """Return the views (N, joints) of a raster: columns from left to right, row after row.

        The arm keeps its survey posture but for yaw and wrist. Whether a view can be reached is
        asked when its turn comes.
        """
        c, limits = self.config, self.arm.limits
        yaws = _steps(limits[0, 0], limits[0, 1], c.raster_yaw)
        tilts = c.raster_tilt * (np.arange(c.raster_rows) - (c.raster_rows - 1) / 2.0)
        rows = [
            [yaw, c.survey[1], c.survey[2], np.clip(c.survey[3] + tilt, *limits[3])]
            for tilt in tilts
            for yaw in yaws
        ]
        return np.array(rows)


def unclaimed(grid: PlanningGrid, claims: BoolArray | None) -> FloatArray:
    """Return the expected occupancy, 0 in claimed cells: there is nothing left to learn."""
    occupancy = expected_occupancy(grid.states)
    if claims is not None:
        occupancy[claims] = 0.0
    return occupancy


def _steps(low: float, high: float, step: float) -> FloatArray:
    count = max(1, int(np.floor((high - low) / step)))
    return low + (np.arange(count) + 0.5) * (high - low) / count
