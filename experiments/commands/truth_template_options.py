"""Options of ``truth-template``."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the template; none."""
