"""Options of ``bench-table``."""

import dataclasses
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the table.

    Attributes:
        out: Folder of results; OUT/bench is read.
        write: File that gets the table between its marks, for instance docs/benchmarks.md; without
            it the table is printed.
    """

    out: Path = Path("results")
    write: Path | None = None
