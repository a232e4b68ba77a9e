"""Findings of the doctor."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line of the doctor's report.

    Attributes:
        what: Name of the thing examined.
        value: State in which it was found.
        remedy: Remedy for a problem; empty when there is none.
        required: True if the project cannot work without the thing.
    """

    what: str
    value: str
    remedy: str = ""
    required: bool = True

    @property
    def fatal(self) -> bool:
        """True when something required is missing."""
        return bool(self.remedy) and self.required

    @property
    def line(self) -> str:
        """Line of the printed report."""
        mark = "PROBLEM" if self.fatal else "note" if self.remedy else "ok"
        remedy = f"  -> {self.remedy}" if self.remedy else ""
        return f"{mark:8}{self.what:24}{self.value}{remedy}"
