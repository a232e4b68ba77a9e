"""Axes of ``mission-envelope``: what becomes harder, and the knowledge that should matter there.

Insertions begin where missions had left the rovers; what makes a field harder takes whole missions.
"""

import dataclasses
import math
from collections.abc import Mapping


@dataclasses.dataclass(frozen=True)
class Axis:
    """One way in which an insertion, or a whole mission, becomes harder.

    Attributes:
        title: What varies, with its unit.
        levels: Its values, the last the hardest; the first is the default, which whole missions
            leave out: `mission` runs it.
        knowledge: What is left out there, some of what can be, what should matter most first.
        scale: Value in SI units over a level.
        whole: Whether it takes whole missions.
    """

    title: str
    levels: tuple[float, ...]
    knowledge: tuple[str, ...]
    scale: float = 1.0
    whole: bool = False


AXES: Mapping[str, Axis] = {
    "springs": Axis("slave's springs / drawn", (1.0, 0.5, 0.3, 0.2), ("identification", "force")),
    "left_springs": Axis("its left springs / right", (1.0, 0.3), ("identification", "force")),
    "load": Axis("load on its base [kg]", (0.0, 1.0, 2.0, 4.0), ("identification", "force")),
    "clearance": Axis("clearance [mm]", (0.8, 1.6, 0.4),
                      ("force", "replanning", "placement", "cooperation"), 1e-3),
    "relief": Axis("relief [mm]", (20.0, 40.0, 60.0), ("force", "replanning", "placement"), 1e-3),
    "slope": Axis("slope across [deg]", (0.0, 5.0, 10.0, 15.0), ("force", "identification"),
                  math.radians(1.0)),
    "errors": Axis("sensors' errors / default", (1.0, 2.0, 4.0), ("force", "identification")),
    "head_errors": Axis("heads' errors / default", (1.0, 3.0, 6.0), ("force", "placement")),
    "delay": Axis("delay of vision [s]", (0.0, 0.5, 1.0), ("force", "replanning")),
    "loss": Axis("radio's loss", (0.0, 0.2, 0.5), ("replanning", "force")),
    "clutter": Axis("rocks and blocks / default", (0.0, 2.0), ("paths",), whole=True),
    "friction": Axis("least friction", (0.2,), ("panel",), whole=True),
    "distance": Axis("farthest initial pose [m]", (10.0,), ("paths",), whole=True),
}  # fmt: skip
"""Axes by name: those of insertions but the clearance are fields of `Hardship`, the others of
`Field`."""
