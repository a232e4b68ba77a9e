"""A rover that waits drives out of the way of the other one, which has told that it has no path."""

import math

import numpy as np

from controllers.insertion.camera_station import camera_arm
from controllers.mission.behaviours import DRIVING, Behaviour, drive, following
from controllers.mission.belief import MissionBelief
from controllers.motion.arm_move import ArmMove
from perception.geometry.arrays import FloatArray
from twin.robot import Command, Observation

_FAR = (0.8, 1.2)  # Distances to which it drives [m].
_BEARINGS = np.linspace(-math.pi, math.pi, 16, endpoint=False)
_LONG = 0.5  # Distance from what needs room that is worth a way longer by a metre [m].


class GiveWay:
    """Drives one rover to a place farther from the site and from the other rover.

    Args:
        belief: Estimates of the rover.

    Attributes:
        done: Whether it is there, or knows no such place.
    """

    def __init__(self, belief: MissionBelief) -> None:
        self.done = False
        self._belief, self._navigator = belief, belief.navigator
        self._arm, _ = camera_arm(belief.robot)
        self._rest = ArmMove(DRIVING, footing=self._navigator.footing)
        self._script = self._run()
        next(self._script)

    def step(self, seen: Observation) -> Command:
        """Return the command of the drive."""
        self._navigator.observe(seen)
        command = None if self.done else following(self._script, seen)
        self.done = command is None
        return command or self._rest.command(seen)

    def _run(self) -> Behaviour:
        seen = yield Command()
        place = self._place()
        if place is not None:
            seen = (yield from drive(seen, self._navigator, self._arm, (place, None))).seen
        if self._belief.localization is not None:
            self._belief.stay()
        return seen

    def _place(self) -> FloatArray | None:
        """Return where it drives to (2,), in the frame of the map [m]; None if it gets nowhere."""
        here = self._navigator.place
        around = np.column_stack([-np.sin(_BEARINGS), np.cos(_BEARINGS)])
        places = np.vstack([here + far * around for far in _FAR])
        lengths = self._navigator.lengths_to(places)
        needed = self._belief.structures()[:, :2]
        room = np.linalg.norm(places[:, None] - needed, axis=2).min(axis=1, initial=math.inf)
        worth = np.minimum(room, 2.0) - _LONG * lengths
        best = int(np.argmax(worth))
        return places[best] if np.isfinite(lengths[best]) else None
