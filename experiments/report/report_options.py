"""Options of ``report``."""

import dataclasses
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the report.

    Attributes:
        out: Folder of results; the report is written to OUT/report.html.
    """

    out: Path = Path("results")
