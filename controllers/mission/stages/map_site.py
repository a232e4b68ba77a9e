"""Stage ``map``, chapter 3: the master maps the site from where its search has led it."""

import numpy as np

from controllers.mapping.arm_views import ViewConfig
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mapping.stereo_view import MapperConfig
from controllers.mission.behaviours import DRIVING
from controllers.mission.belief import MissionBelief
from controllers.motion.arm_move import ArmMove
from twin.robot import Command, Observation

_CLEAR = (0.3, -0.02)
"""Radius about the arm's base, and least height above it, of the space that the rover holds when it
has driven somewhere [m]."""
_VIEWS = ViewConfig(survey=tuple(DRIVING.tolist()))
"""Folded as on the way, the arm is within that space."""


class MapSite:
    """Drives the rover's arm through views of the site, chosen by their information.

    Args:
        belief: Estimates of the rover, which is localized; its map takes the views.
        scans: Number of views.
        rng: Random generator for candidate views.

    Attributes:
        mapper: Mapper that takes the views.
    """

    name = "map"

    def __init__(self, belief: MissionBelief, scans: int, rng: np.random.Generator) -> None:
        assert belief.localization is not None
        robot, self._navigator = belief.robot, belief.navigator
        guard = self._navigator.tip_guard
        self._name, self._home = robot.name, ArmMove(DRIVING, guard=guard)
        self.mapper = StereoMapper(
            {robot.name: robot},
            belief.map,
            MapperConfig(scans=scans, clear=_CLEAR, views=_VIEWS),
            rng,
            localizations={robot.name: belief.localization},
            guards={} if guard is None else {robot.name: guard},
        )

    @property
    def done(self) -> bool:
        """Whether no view is left."""
        return self.mapper.done

    def step(self, seen: Observation) -> Command:
        """Return the command towards the next view, or to rest after the last."""
        self._navigator.observe(seen)
        if self.mapper.done:
            return self._home.command(seen)
        return self.mapper.step({self._name: seen})[self._name]
