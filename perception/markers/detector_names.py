"""Names of the marker detectors, apart from what they do: options need no more."""

from typing import Final

DETECTOR_NAMES: Final = ("tht", "blob")
"""The thesis' detector and one of today, by the names of the metrics; `bodies.DETECTORS`."""
