"""A rover that waits drives out of the way of the other one, which has told that it has no path."""

import math

import numpy as np

from controllers.mission.behaviours import Behaviour, DrivingPart, drive
from perception.geometry.arrays import FloatArray
from twin.robot import Observation

_FAR = (0.8, 1.2)  # Distances to which it drives [m].
_BEARINGS = np.linspace(-math.pi, math.pi, 16, endpoint=False)
_LONG = 0.5  # Distance from what needs room that is worth a way longer by a metre [m].


class GiveWay(DrivingPart):
    """Drives one rover to a place farther from the site and from the other rover.

    It ends where it is if it knows no such place.
    """

    def _run(self, seen: Observation) -> Behaviour:
        place = self._place()
        if place is not None:
            seen = (yield from drive(seen, self._navigator, self._arm, lambda: (place, None))).seen
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
