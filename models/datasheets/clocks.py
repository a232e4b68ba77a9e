"""The clocks of the robots' computers."""

import dataclasses
from typing import Final


@dataclasses.dataclass(frozen=True)
class ClockSheet:
    """How far a robot's clock is off, at most; drawn uniformly once a robot."""

    offset: float = 0.1  # Ahead at the start [s]. Assumption: set to each other by hand or radio
    drift: float = 50e-6  # To either side. Assumption: an ordinary quartz, trimmed to 50 ppm


CLOCK: Final = ClockSheet()
HARSH_CLOCK: Final = ClockSheet(
    # Assumption: set by a watch; an untrimmed quartz on a cold morning.
    offset=1.0,
    drift=100e-6,
)
