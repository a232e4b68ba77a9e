"""Stages of a mission, and what of it can be left out."""

import dataclasses

OMITTABLE = ("paths", "occluders", "panel", "guard", "cooperation")
"""What an ablation takes away: points of the map that paths avoid, or those by which the camera
station is chosen; the panel, once it has localized a rover; the guard against tipping over; or what
the master sees of card and slot (the slave goes by its own map alone)."""
STAGES = ("identify", "search", "map", "place", "approach", "insert")
"""Stages in their order; both rovers end each together."""


@dataclasses.dataclass(frozen=True)
class MissionConfig:
    """Configuration of a mission.

    Attributes:
        without: Part of `OMITTABLE` that is left out; empty for none.
        scans: Number of views with which the master maps the site.
    """

    without: str = ""
    scans: int = 5
