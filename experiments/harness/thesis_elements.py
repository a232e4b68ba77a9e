"""Every table and figure of the thesis, and why a result is not what it was to be.

Both are data: ``thesis_elements.toml`` and ``shortfall_reasons.toml`` beside this file.
"""

import dataclasses
import fnmatch
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ELEMENTS_FILE = HERE / "thesis_elements.toml"
REASONS_FILE = HERE / "shortfall_reasons.toml"
_NAME = re.compile(r"(Figure|Table) ([1-9A-E]-[1-9][0-9]?)")
_TOKEN = re.compile(r"([1-9a-e]-[1-9][0-9]?)[a-z]?")


@dataclasses.dataclass(frozen=True)
class Element:
    """A table or figure of the thesis.

    Attributes:
        name: Name in the thesis, for instance "Figure 3-26".
        what: Content of the element.
        shown_by: Experiments whose results show it, or that deal with the matter.
        also: Names of pictures and tables that show it under another name.
        why_not: Why there is nothing to show; empty if there is.
    """

    name: str
    what: str
    shown_by: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    why_not: str = ""

    def __post_init__(self) -> None:
        """Refuse an element that is neither shown nor excused.

        Raises:
            ValueError: Naming the element.
        """
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"element {self.name!r}: expected 'Figure 2-4' or 'Table C-1'")
        if not (self.shown_by or self.why_not):
            raise ValueError(f"element {self.name}: neither shown_by nor why_not is given")

    def shown_in(self, stem: str) -> bool:
        """Tell whether a picture or table shows this element.

        Args:
            stem: File name without ending; "figure_a-5_a-6" shows two elements.
        """
        if stem in self.also:
            return True
        kind, *tokens = stem.lower().split("_")
        wanted, number = self.name.lower().split()
        matches = [_TOKEN.fullmatch(token) for token in tokens]
        return kind == wanted and any(match and match[1] == number for match in matches)


@dataclasses.dataclass(frozen=True)
class Reason:
    """Why results of an experiment miss their bar or differ from the thesis.

    Attributes:
        experiment: Name of the experiment.
        about: Patterns (as in a shell) of names of checks, or of metrics that the thesis has.
        why: The reason.
    """

    experiment: str
    about: tuple[str, ...]
    why: str


def elements(path: Path = ELEMENTS_FILE) -> list[Element]:
    """Return all elements in the thesis' order.

    Raises:
        ValueError: If an entry is damaged or there twice.
    """
    found = [Element(**_tuples(entry)) for entry in _read(path, "elements")]
    names = [element.name for element in found]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{path.name}: {name} is there twice")
    return found


def reasons(path: Path = REASONS_FILE) -> list[Reason]:
    """Return all reasons."""
    return [Reason(**_tuples(entry)) for entry in _read(path, "reasons")]


def why(known: Iterable[Reason], experiment: str, name: str) -> str:
    """Return the reason for one check or metric; empty if none is known."""
    for reason in known:
        if reason.experiment == experiment and any(
            fnmatch.fnmatchcase(name, pattern) for pattern in reason.about
        ):
            return reason.why
    return ""


def _read(path: Path, key: str) -> list[dict[str, Any]]:
    with path.open("rb") as stream:
        return tomllib.load(stream)[key]


def _tuples(entry: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(item) if isinstance(item, list) else item for key, item in entry.items()}
