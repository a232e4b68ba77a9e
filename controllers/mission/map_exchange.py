"""What both rovers of a mission have mapped of the ground, exchanged over their radio.

What is received is kept apart from the own map, and completes what paths are planned on.
"""

import numpy as np

from controllers.mapping.map_sharing import FRAGMENT, RECEIPT, MapSharing, MapSharingConfig
from controllers.mission.belief import MissionBelief
from controllers.mission.radio import MissionRadio
from perception.elevation.map import ElevationMap

BUDGET = 8_500
"""Most bytes of messages that a rover sends: with their frames less than 10 kB on the air."""
_PERIOD = 5.0  # Time between two comparisons of the own map with what was noted of it [s].
_PACE = 0.1  # Time between two decisions what to send [s]; five messages a second are sent.


class MapExchange:
    """One rover's end of the exchange of maps; both rovers have to be localized by the panel.

    Args:
        belief: Estimates of the rover; its navigator gets what is received.
        radio: The rover's end of the radio.
        number: Number of the rover in its messages.
    """

    def __init__(self, belief: MissionBelief, radio: MissionRadio, number: int) -> None:
        self._belief, self._radio = belief, radio
        self._noted = ElevationMap(belief.navigator.ground.grid)
        self._sharing = MapSharing(self._noted, number, MapSharingConfig(budget_bytes=BUDGET))
        belief.navigator.received = self._sharing.received
        self._next = self._next_message = -np.inf

    def step(self, now: float) -> None:
        """Take what has arrived, and send what is due.

        Args:
            now: Time of the rover's own clock [s].
        """
        for message in self._radio.take((FRAGMENT, RECEIPT)):
            self._sharing.receive(message)
        if now >= self._next:
            self._next = now + _PERIOD
            self._note_changes()
        if now >= self._next_message:
            self._next_message = now + _PACE
            if (message := self._sharing.next_message(now)) is not None:
                self._radio.send(message)

    def _note_changes(self) -> None:
        """Note which cells of the own map have changed, or are known no more."""
        heights, noted = self._belief.navigator.ground.heights, self._noted
        same = (heights == noted.heights) | (np.isnan(heights) & np.isnan(noted.heights))
        noted.heights[~same] = heights[~same]
        noted.variances[~same] = self._belief.navigator.ground.variances[~same]
        if not same.all():
            self._sharing.take(np.flatnonzero(~same))
