"""What falls short of its bar and what differs from the thesis, with the reasons."""

from collections.abc import Sequence
from html import escape
from typing import Any

from experiments.harness.summary import format_metric
from experiments.harness.thesis_elements import Reason, why
from experiments.report.html import check_cells, folded, link, numbers, plain_key, table
from experiments.report.results import Result

TOLERANCE = 0.01
"""Ours agrees if the thesis' figure is in its interval, or this part of itself off it."""
UNKNOWN = "The cause is not known."


def shortfalls(results: Sequence[Result], reasons: Sequence[Reason]) -> str:
    """Return the section on what falls short; quick runs are smaller than what bars are for."""
    judged = [result for result in results if not result.config.get("quick")]
    checks = [(result, check) for result in judged for check in result.metrics["checks"]]
    failed = [(result, check) for result, check in checks if not check["ok"]]
    if not checks:
        return ""
    if not failed:
        return (
            '<section class="good" id="shortfalls">'
            f"<h2>All {len(checks)} checks hold</h2></section>"
        )
    rows = "".join(
        f"<tr><td>{link(result.name, result.name)}</td>{check_cells(check)}"
        f'<td class="why">{escape(_why(reasons, result, str(check["name"])))}</td></tr>'
        for result, check in failed
    )
    return (
        '<section class="short" id="shortfalls">'
        f"<h2>What falls short: {len(failed)} of {len(checks)} checks</h2>"
        f"{table(('experiment', 'check', 'ours', 'bound', 'why'), rows)}</section>"
    )


def differences(results: Sequence[Result], reasons: Sequence[Reason]) -> str:
    """Return the section on figures that are not the thesis'; empty without any to compare."""
    parts: list[str] = []
    compared = differing = 0
    for result in results:
        if result.config.get("quick"):
            continue
        measured, thesis = result.metrics["measured"], result.metrics["thesis"]
        apart = [key for key in thesis if not agrees(measured.get(key), thesis[key])]
        compared, differing = compared + len(thesis), differing + len(apart)
        if apart:
            parts.append(_apart(result, apart, reasons))
    if not compared:
        return ""
    kind = "short" if differing else "good"
    return (
        f'<section class="{kind}" id="differences"><h2>What differs from the thesis: {differing} '
        f"of {compared} figures</h2><p>Ours agrees where the thesis&rsquo; figure lies in the "
        f"95&nbsp;% interval, or within {100 * TOLERANCE:g}&nbsp;% of it. To differ is not to be "
        f"worse.</p>{''.join(parts)}</section>"
    )


def agrees(ours: Any, thesis: Any) -> bool:
    """Return whether a metric agrees with the thesis, within its interval.

    Args:
        ours: A value, or a distribution.
        thesis: The thesis' value.
    """
    low, high = (ours.get("low"), ours.get("high")) if isinstance(ours, dict) else (ours, ours)
    if not all(isinstance(each, int | float) for each in (low, high, thesis)):
        return ours == thesis
    slack = TOLERANCE * abs(thesis)
    return low - slack <= thesis <= high + slack


def _apart(result: Result, keys: Sequence[str], reasons: Sequence[Reason]) -> str:
    """Return one experiment's figures that differ, grouped by the reason."""
    measured, thesis = result.metrics["measured"], result.metrics["thesis"]
    groups: dict[str, list[str]] = {}
    for key in keys:
        groups.setdefault(_why(reasons, result, key), []).append(key)
    parts = [
        f"<h3>{link(result.name, result.name)}: {len(keys)} of {len(thesis)} figures differ</h3>"
    ]
    for text, names in groups.items():
        rows = "".join(
            f"<tr><td>{escape(plain_key(key))}</td>"
            f"{numbers((format_metric(thesis[key])[0], *format_metric(measured.get(key))))}</tr>"
            for key in names
        )
        headings = ("quantity", "thesis", "ours", "95 % interval")
        parts.append(f"<p>{escape(text)}</p>")
        parts.append(folded(f"{len(names)} of them", table(headings, rows)))
    return "".join(parts)


def _why(reasons: Sequence[Reason], result: Result, name: str) -> str:
    return why(reasons, result.name, name) or UNKNOWN
