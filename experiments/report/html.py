"""Pieces of HTML that all parts of the report are made of."""

import shlex
from collections.abc import Sequence
from html import escape
from typing import Any

from experiments.harness.summary import format_number
from experiments.report.results import Result

LONG = 24  # characters of a cell; longer ones are broken into lines
LONGEST = 200  # characters; what is longer is cut, the files have it all
WIDE = 10  # columns of a table; with more it is printed small
UNITS = {
    "percent": "%", "fraction": "-", "mm": "mm", "mm2": "mm^2", "m": "m", "metres": "m",
    "deg": "deg", "mrad": "mrad", "s": "s", "ms": "ms", "us": "us", "hz": "Hz", "n": "N", "N": "N",
    "kg": "kg", "g": "g", "px": "px", "bytes": "bytes", "bits": "bit",
}  # fmt: skip
"""Units behind the names of metrics."""
_LOCAL = {"--out": True, "--jobs": True, "--scheduler": True, "--backend": True, "--resume": False}
"""Options that change no result, and whether a word follows them."""


def table(headings: Sequence[str], rows: str) -> str:
    """Return a table in a box that scrolls by itself.

    Args:
        headings: Headings of the columns; may be empty.
        rows: HTML of the rows.
    """
    heads = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    head = f"<thead><tr>{heads}</tr></thead>" if headings else ""
    kind = ' class="wide"' if len(headings) > WIDE else ""
    return f'<div class="scroll"><table{kind}>{head}<tbody>{rows}</tbody></table></div>'


def numbers(cells: Sequence[str]) -> str:
    """Return cells of numbers, and of text, where it is long enough to need lines."""
    return "".join(
        f'<td class="{"number" if len(cell) <= LONG else "text"}">{escape(cut(cell))}</td>'
        for cell in cells
    )


def cut(text: str) -> str:
    """Return a text, cut where it is too long to be read in a table."""
    return text if len(text) <= LONGEST else f"{text[:LONGEST].rstrip()} ..."


def plain_key(key: str) -> str:
    """Return a metric's name in words, with its unit in brackets.

    Args:
        key: Name as in metrics.json, for instance ``sag_mm/5/no_head``.
    """
    quantity, *parts = key.split("/")
    words = quantity.split("_")
    if len(words) > 1 and words[-1] in UNITS:
        words[-1] = f"[{UNITS[words[-1]]}]"
    return ", ".join([" ".join(words), *(part.replace("_", " ") for part in parts)])


def check_cells(check: dict[str, Any]) -> str:
    """Return name, value and bound of a check as cells."""
    cells = numbers((format_number(check["value"]), format_number(check["bound"])))
    return f"<td>{escape(str(check['name']))}</td>{cells}"


def folded(summary: str, body: str, *, unfolded: bool = False, extra: bool = False) -> str:
    """Return what is folded under a line.

    Args:
        summary: Text of the line.
        body: HTML.
        unfolded: Whether the part begins unfolded.
        extra: Whether the part is for the screen only; all else is unfolded on paper.
    """
    state = (' class="extra"' if extra else "") + (" open" if unfolded else "")
    return f"<details{state}><summary>{escape(summary)}</summary>{body}</details>"


def link(target: str, text: str) -> str:
    """Return a link to a place in the page."""
    return f'<a href="#{escape(target)}">{escape(text)}</a>'


def anchor(experiment: str, stem: str) -> str:
    """Return the name of the place of a picture or table in the page."""
    return f"{experiment}/{stem}"


def command(result: Result) -> str:
    """Return the command that makes a result, without options of its folder and workers.

    The command of versions that did not store it is made of its common options.
    """
    config, words = result.config, result.run.get("command")
    if not isinstance(words, list):
        words = [result.name, *(["--quick"] if config.get("quick") else [])]
        for name in ("seeds", "seed"):
            words += [f"--{name}", str(config[name])] if config.get(name) else []
    kept: list[str] = []
    rest = iter(str(word) for word in words)
    for word in rest:
        name, equals, _ = word.partition("=")
        if name not in _LOCAL:
            kept.append(word)
        elif _LOCAL[name] and not equals:
            next(rest, None)
    return shlex.join(["python", "-m", "experiments", *kept])
