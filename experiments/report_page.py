"""The HTML of the report: plain HTML and CSS, every image inside, no scripts."""

from __future__ import annotations

import base64
import csv
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.report_style import STYLE
from experiments.summary import format_metric, format_number

if TYPE_CHECKING:
    from experiments.report import Result

ROWS_SHOWN = 60  # of a CSV table; the file has them all


def page(results: Sequence[Result]) -> str:
    """Return the whole page.

    Args:
        results: In the order in which they appear.
    """
    contents = "".join(
        f'<li><a href="#{escape(result.name)}">{escape(result.name)}</a></li>' for result in results
    )
    sections = "".join(section(result) for result in results)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>fieldtwin results</title><style>{STYLE}</style></head><body>"
        f"<header><h1>fieldtwin</h1><p>The thesis&rsquo; results beside ours.</p>"
        f"<ul class='contents'>{contents}</ul></header>"
        f"<main>{shortfalls(results)}{sections}</main></body></html>\n"
    )


def shortfalls(results: Sequence[Result]) -> str:
    """Return the section on what falls short; it comes first."""
    checks = [(result, check) for result in results for check in result.metrics["checks"]]
    failed = [(result, check) for result, check in checks if not check["ok"]]
    if not checks:
        return ""
    if not failed:
        return f'<section class="good"><h2>All {len(checks)} checks hold</h2></section>'
    rows = "".join(
        f'<tr><td><a href="#{escape(result.name)}">{escape(result.name)}</a></td>'
        f"{_check_cells(check)}</tr>"
        for result, check in failed
    )
    return (
        f'<section class="short"><h2>What falls short: {len(failed)} of {len(checks)} checks</h2>'
        f"{_table(('experiment', 'check', 'ours', 'bound'), rows)}</section>"
    )


def section(result: Result) -> str:
    """Return one experiment's section."""
    element = f'<p class="element">{escape(result.thesis_element)}</p>'
    quick = '<span class="tag">quick run</span>' if result.config.get("quick") else ""
    return (
        f'<section id="{escape(result.name)}"><h2>{escape(result.name)} {quick}</h2>'
        f"<p>{escape(result.title)}</p>{element if result.thesis_element else ''}"
        f"{comparison(result)}{checks(result)}{figures(result)}"
        f"{''.join(table_file(path) for path in result.tables)}{provenance(result)}</section>"
    )


def comparison(result: Result) -> str:
    """Return the thesis' values beside ours, and all other metrics folded."""
    measured, thesis = result.metrics["measured"], result.metrics["thesis"]
    rows = "".join(metric_row(key, measured.get(key), thesis[key]) for key in thesis)
    headings = ("quantity", "thesis", "ours", "95 % interval", "n", "ours / thesis")
    compared = _table(headings, rows) if rows else ""
    others = {key: value for key, value in measured.items() if key not in thesis}
    rows = "".join(metric_row(key, value, None) for key, value in others.items())
    if not rows:
        return compared
    unfolded = "" if compared else " open"
    return (
        f"{compared}<details{unfolded}><summary>{len(others)} further metrics</summary>"
        f"{_table(headings, rows)}</details>"
    )


def metric_row(key: str, ours: Any, thesis: Any) -> str:
    """Return one row of the comparison."""
    centre, interval = format_metric(ours)
    number = ours.get("n", "") if isinstance(ours, dict) else ""
    cells = (
        "" if thesis is None else format_metric(thesis)[0],
        centre,
        interval,
        format_number(number),
        _ratio(ours, thesis),
    )
    return f"<tr><td>{escape(key)}</td>{_numbers(cells)}</tr>"


def checks(result: Result) -> str:
    """Return the checks of one experiment, failed ones first."""
    ordered = sorted(result.metrics["checks"], key=lambda check: bool(check["ok"]))
    rows = "".join(
        f"<tr>{_check_cells(check)}<td class='{'ok' if check['ok'] else 'fail'}'>"
        f"{'holds' if check['ok'] else 'falls short'}</td></tr>"
        for check in ordered
    )
    return _table(("check", "ours", "bound", ""), rows) if rows else ""


def figures(result: Result) -> str:
    """Return all figures, embedded."""
    images = "".join(
        f'<figure><img alt="{escape(path.stem)}" src="data:image/png;base64,'
        f'{base64.b64encode(path.read_bytes()).decode()}">'
        f"<figcaption>{escape(path.stem.replace('_', ' '))}</figcaption></figure>"
        for path in result.figures
    )
    return f'<div class="figures">{images}</div>' if images else ""


def table_file(path: Path) -> str:
    """Return a CSV table, folded; long ones are cut, and say so."""
    with path.open(newline="", encoding="utf-8") as stream:
        headings, *rows = list(csv.reader(stream)) or [[]]
    body = "".join(f"<tr>{_numbers(row)}</tr>" for row in rows[:ROWS_SHOWN])
    cut = f"<p>The first {ROWS_SHOWN} of {len(rows)} rows.</p>" if len(rows) > ROWS_SHOWN else ""
    name = escape(path.stem.replace("_", " "))
    return f"<details><summary>{name}</summary>{_table(headings, body)}{cut}</details>"


def provenance(result: Result) -> str:
    """Return how the result was made, folded."""
    options = {f"option {key}": value for key, value in result.config.items()}
    versions = {f"{name} version": text for name, text in result.run.get("versions", {}).items()}
    rest = {key: value for key, value in result.run.items() if key != "versions"}
    body = "".join(
        f"<tr><td>{escape(key)}</td><td>{escape(format_number(value))}</td></tr>"
        for key, value in {**options, **rest, **versions}.items()
    )
    duration = format_number(result.run.get("wall_time_s"))
    title = f"how it was made ({duration} s, seed {escape(str(result.config.get('seed')))})"
    return f"<details><summary>{title}</summary>{_table((), body)}</details>"


def _table(headings: Sequence[str], rows: str) -> str:
    heads = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    head = f"<thead><tr>{heads}</tr></thead>" if headings else ""
    return f'<div class="scroll"><table>{head}<tbody>{rows}</tbody></table></div>'


def _check_cells(check: dict[str, Any]) -> str:
    cells = _numbers((format_number(check["value"]), format_number(check["bound"])))
    return f"<td>{escape(str(check['name']))}</td>{cells}"


def _numbers(cells: Sequence[str]) -> str:
    return "".join(f'<td class="number">{escape(cell)}</td>' for cell in cells)


def _ratio(ours: Any, thesis: Any) -> str:
    """Return ours over the thesis' value, where both are numbers."""
    ours, thesis = (
        value.get("median") if isinstance(value, dict) else value for value in (ours, thesis)
    )
    if not isinstance(ours, int | float) or not isinstance(thesis, int | float) or thesis == 0:
        return ""
    return format_number(float(ours / thesis))
