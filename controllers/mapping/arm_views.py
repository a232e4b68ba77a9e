"""Next view of a stereo head on an arm: candidates, their reachability, and their rating.

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
"""Number of paths checked at once: few calls, and few unnecessary checks."""
Collides = Callable[[FloatArray], BoolArray]
"""Collision test of points (N, 3) [m], world: (N,), whether each may be occupied (P >= 0.05)."""


@dataclasses.dataclass(frozen=True)
class ViewConfig:
    """Configuration of the drawing and rating of views.

    Attributes:
        candidates: Number of candidates of each decision.
        price: Weight K of eq. 3-15, relative to the best candidate's information.
        exponent: Exponent n of eq. 3-15.
        step: Greatest turn of a joint between two checks of a path [rad].
        survey: (joints,) posture of the arm in a raster, except yaw and wrist [rad]: the head is
            high, its view half a radian below the horizon.
        raster_yaw: Turn between the columns of a raster [rad], such that views overlap by a third.
        raster_tilt: Turn between the rows of a raster [rad].
        raster_rows: Number of rows of a raster.
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
    """Field of view of a stereo head.

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
        angles: (N, joints) joint angles [rad], the best first.
        ratings: (N,) rating RF of each.
        information: (N,) expected information of each [bit].
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
        arm: Chain of the arm, with the left camera as its tool.
        transform_robot_to_world: Pose of the robot.
        lens: Field of view of the head.
        config: Configuration of the drawing and rating of views.
    """

    arm: SerialChain
    transform_robot_to_world: RigidTransform
    lens: ViewRays
    config: ViewConfig = ViewConfig()

    def cameras(self, angles: FloatArray) -> RigidTransform:
        """Return the transforms from camera to world for angles (N, joints) [rad]."""
        return self.transform_robot_to_world * self.arm.tool_in_robot(angles)

    def body(self, angles: FloatArray) -> FloatArray:
        """Return points (N, K, 3) [m] that cover the arm, world, for angles (N, joints)."""
        points = self.arm.cover_points(angles)
        world = self.transform_robot_to_world.apply(points.reshape(-1, 3))
        return world.reshape(points.shape)

    def is_free(self, angles: FloatArray, collides: Collides) -> BoolArray:
        """Return (N,), whether the arm is free of collision at angles (N, joints) [rad]."""
        bodies = self.body(angles)
        hit = collides(bodies.reshape(-1, 3)).reshape(bodies.shape[:2])
        return np.all(~hit, axis=1)

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
        """Draw views that can be reached from the present posture.

        Args:
            start: (joints,) present angles [rad].
            collides: Collision test of points.
            count: Number of views wanted; fewer are returned where space is narrow.
            rng: Random generator for the views.

        Returns:
            (N, joints) angles [rad].

        Raises:
            ViewError: If no view can be reached.
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
            grid: Coarse grid of the map's states.
            claims: (nx, ny, nz), cells that other robots' next views cover; None for none.
            start: (joints,) present angles [rad].
            angles: (N, joints) angles of the views [rad].
        """
        occupancy = _unclaimed(grid, claims)
        cameras = self.cameras(angles)
        information = view_information(grid, occupancy, cameras, self.lens.rays, self.lens.reach)
        span = np.linalg.norm(np.ptp(self.arm.limits, axis=1))
        distance = np.linalg.norm(angles - start, axis=1) / span
        best = max(float(information.max()), 1e-9)
        ratings = information / best - self.config.price * distance**self.config.exponent
        order = np.argsort(-ratings)
        return RatedViews(angles[order], ratings[order], information[order], cameras[order])

    def claims(self, grid: PlanningGrid, claims: BoolArray | None, angles: FloatArray) -> BoolArray:
        """Return (nx, ny, nz) claimed cells, including those of a view (joints,) [rad]."""
        occupancy = _unclaimed(grid, claims)
        camera = self.cameras(angles[None])[0]
        seen = claimed_by_view(grid, occupancy, camera, self.lens.rays, self.lens.reach)
        return seen if claims is None else np.logical_or(seen, claims)

    def raster(self) -> FloatArray:
        """Return the views (N, joints) of a raster: columns from left to right, row after row.

        All joints but yaw and wrist are those of the survey posture. Some views are unreachable.
        """
        c, limits = self.config, self.arm.limits
        (low, high), step = limits[0], c.raster_yaw
        count = max(1, int(np.floor((high - low) / step)))
        yaws = low + (np.arange(count) + 0.5) * (high - low) / count
        tilts = c.raster_tilt * (np.arange(c.raster_rows) - (c.raster_rows - 1) / 2.0)
        wrists = np.clip(c.survey[3] + tilts, *limits[3])
        return np.array([[yaw, *c.survey[1:3], wrist] for wrist in wrists for yaw in yaws])


def _unclaimed(grid: PlanningGrid, claims: BoolArray | None) -> FloatArray:
    """Return the expected occupancy, 0 in claimed cells so that they give no information."""
    occupancy = expected_occupancy(grid.states)
    if claims is not None:
        occupancy[claims] = 0.0
    return occupancy
