"""Several planar vision systems on one map: each for itself, or claiming what they will see."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from controllers.mapping.planar_planner import PlannerConfig, View, ViewPlanner
from perception.planar.beams import fan
from perception.planar.map import BoolArray, PlanarMap
from perception.planar.raycast import expected_view


@dataclasses.dataclass
class PlanarTeam:
    """Robots that share a map and choose their next poses in rounds.

    A round: every robot chooses a pose, goes there and scans. Cooperating robots choose one after
    the other; each claims the cells that its view should see, so that the next ones do not count
    them. Independent robots choose by the map alone. Robots are points to each other: they neither
    hide ground nor block ways.

    Attributes:
        planners: One for each robot.
        cooperative: Whether claims are made.
    """

    planners: Sequence[ViewPlanner]
    cooperative: bool = True

    def choose(self, world: PlanarMap, cells: Sequence[tuple[int, int]]) -> list[View | None]:
        """Choose the next pose of every robot.

        Args:
            world: The common map.
            cells: Present row and column of each robot.

        Returns:
            A view for each, or None where nothing new is left for it.

        Raises:
            ValueError: If there is not one cell for each robot.
        """
        if len(cells) != len(self.planners):
            raise ValueError(f"cells: expected {len(self.planners)}, got {len(cells)}")
        claimed: BoolArray = np.zeros(world.grid.shape, dtype=bool)
        opaque = world.measured & (world.probability() >= world.model.occupied_above)
        views: list[View | None] = []
        for planner, cell in zip(self.planners, cells):
            view = planner.choose(world, cell, claimed if self.cooperative else None)
            views.append(view)
            if view is not None and self.cooperative:
                sensor, rays = planner.config.sensor, planner.config.rays
                table = fan(sensor.depth, world.grid.cell, rays)
                claimed |= expected_view(opaque, view.cell, view.heading, sensor.fov, table)
        return views


def make_team(
    robots: int, config: PlannerConfig, generator: np.random.Generator, cooperative: bool = True
) -> PlanarTeam:
    """Return a team of equal robots, each with random numbers of its own.

    Args:
        robots: How many.
        config: Of every planner.
        generator: Split among the robots.
        cooperative: Whether claims are made.

    Raises:
        ValueError: If there is no robot.
    """
    if robots < 1:
        raise ValueError(f"robots: expected 1 or more, got {robots}")
    return PlanarTeam(
        [ViewPlanner(config, child) for child in generator.spawn(robots)], cooperative
    )
