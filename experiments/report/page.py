"""The HTML of the report: plain HTML and CSS, every picture inside, no scripts."""

import csv
import io
from collections.abc import Collection, Sequence
from html import escape
from pathlib import Path
from typing import Any

from experiments.harness.contract import ExperimentError
from experiments.harness.summary import format_metric, format_number
from experiments.harness.thesis_elements import Element, elements, reasons
from experiments.report.elements import captions, element_table
from experiments.report.findings import agrees, differences, shortfalls
from experiments.report.html import (
    anchor,
    check_cells,
    command,
    folded,
    link,
    numbers,
    plain_key,
    table,
)
from experiments.report.images import embed
from experiments.report.overview import overview
from experiments.report.results import Result
from experiments.report.style import STYLE
from perception.geometry.files import RESULTS, read_text

FEW = 10  # checks that are not folded
ROWS_SHOWN = 60  # of a CSV table; the file has them all
PARTS = {
    "found": "What was found",
    "shortfalls": "What falls short",
    "differences": "What differs from the thesis",
    "elements": "The thesis, element by element",
}


def page(results: Sequence[Result], known: Collection[str]) -> str:
    """Return the whole page.

    Args:
        results: Results in the order in which they appear.
        known: Names of all experiments of this version.

    Raises:
        ExperimentError: If a picture or table is damaged.
    """
    thesis, excuses = elements(), reasons()
    parts = overview(results, thesis)
    parts += shortfalls(results, excuses) + differences(results, excuses)
    parts += element_table(thesis, results, known)
    sections = "".join(section(result, thesis) for result in results)
    entries = [(name, text) for name, text in PARTS.items() if f'id="{name}"' in parts]
    entries += [(result.name, result.name) for result in results]
    contents = "".join(f"<li>{link(name, text)}</li>" for name, text in entries)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>fieldtwin results</title><style>{STYLE}</style></head><body>"
        "<header><h1>fieldtwin</h1><p>Every table and figure of <cite>Compensating for Model "
        "Uncertainty in the Control of Cooperative Field Robots</cite> (2002), and ours beside "
        "it.</p>"
        f"<nav><ul class='contents'>{contents}</ul></nav></header>"
        f"<main>{parts}{sections}</main></body></html>\n"
    )


def section(result: Result, thesis: Sequence[Element]) -> str:
    """Return one experiment's section.

    Args:
        result: Result of the experiment.
        thesis: All elements of the thesis, for the captions.
    """
    element = f'<p class="element">{escape(result.thesis_element)}</p>'
    quick = '<span class="tag">quick run</span>' if result.config.get("quick") else ""
    beside = [path for path in result.tables if captions(thesis, result.name, path.stem)]
    others = [path for path in result.tables if path not in beside]
    return (
        f'<section id="{escape(result.name)}"><h2>{escape(result.name)} {quick}</h2>'
        f"<p>{escape(result.title)}</p>{element if result.thesis_element else ''}"
        f"<p><code>{escape(command(result))}</code></p>"
        f"{comparison(result)}{checks(result)}"
        f"{''.join(table_file(result, path, thesis) for path in beside)}"
        f"{figures(result, thesis)}"
        f"{''.join(table_file(result, path, thesis) for path in others)}"
        f"{provenance(result)}</section>"
    )


def comparison(result: Result) -> str:
    """Return the thesis' values beside ours, and all other metrics folded."""
    measured, thesis = result.metrics["measured"], result.metrics["thesis"]
    rows = "".join(metric_row(key, measured.get(key), thesis[key]) for key in thesis)
    headings = ("quantity", "thesis", "ours", "95 % interval", "n", "ours / thesis")
    compared = table(headings, rows) if rows else ""
    others = {key: value for key, value in measured.items() if key not in thesis}
    rows = "".join(metric_row(key, value, None) for key, value in others.items())
    if not rows:
        return compared
    few = not compared and len(others) <= ROWS_SHOWN
    text = f"{len(others)} further metrics"
    return compared + folded(text, table(headings, rows), unfolded=few, extra=not few)


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
    differs = thesis is not None and not agrees(ours, thesis)
    kind = ' class="differs"' if differs else ""
    return f"<tr{kind}><td>{escape(plain_key(key))}</td>{numbers(cells)}</tr>"


def checks(result: Result) -> str:
    """Return the checks of one experiment; those that hold are folded where they are many."""
    held, failed = (
        [check for check in result.metrics["checks"] if bool(check["ok"]) == ok]
        for ok in (True, False)
    )
    short = ("quick", "not judged") if result.config.get("quick") else ("fail", "falls short")
    parts = [_check_table(failed, *short)] if failed else []
    if held:
        rows = _check_table(held, "ok", "holds")
        parts.append(folded(f"{len(held)} checks hold", rows, unfolded=len(held) <= FEW))
    return "".join(parts)


def _check_table(checks: Sequence[dict[str, Any]], kind: str, text: str) -> str:
    rows = "".join(
        f"<tr>{check_cells(check)}<td class='{kind}'>{text}</td></tr>" for check in checks
    )
    return table(("check", "ours", "bound", ""), rows)


def figures(result: Result, thesis: Sequence[Element]) -> str:
    """Return all pictures, embedded, those of the thesis first."""
    named = [(captions(thesis, result.name, path.stem), path) for path in result.figures]
    images = "".join(
        _figure(result, path, caption)
        for caption, path in sorted(named, key=lambda pair: not pair[0])
    )
    return f'<div class="figures">{images}</div>' if images else ""


def _figure(result: Result, path: Path, caption: str) -> str:
    picture = embed(path)
    text = caption or path.stem.replace("_", " ")
    return (
        f'<figure id="{escape(anchor(result.name, path.stem))}"><img alt="{escape(text)}" '
        f'width="{picture.width}" height="{picture.height}" src="{picture.url}">'
        f"<figcaption>{escape(text)}</figcaption></figure>"
    )


def table_file(result: Result, path: Path, thesis: Sequence[Element]) -> str:
    """Return a CSV table, folded unless it is one of the thesis; long ones are cut, and say so."""
    try:
        lines = io.StringIO(read_text(path, RESULTS), newline="")
        headings, *rows = list(csv.reader(lines)) or [[]]
    except (OSError, ValueError, csv.Error) as error:
        raise ExperimentError(f"{path}: no table ({error})") from None
    body = "".join(
        f"<tr>{numbers([_short(cell) for cell in row])}</tr>" for row in rows[:ROWS_SHOWN]
    )
    cut = f"<p>The first {ROWS_SHOWN} of {len(rows)} rows.</p>" if len(rows) > ROWS_SHOWN else ""
    caption = captions(thesis, result.name, path.stem)
    place = anchor(result.name, path.stem)
    if any(picture.stem == path.stem for picture in result.figures):
        place += ".csv"
    text = caption or path.stem.replace("_", " ")
    rest = table(headings, body) + cut
    inside = folded(text, rest, unfolded=bool(caption), extra=not caption)
    return f'<div id="{escape(place)}">{inside}</div>'


def _short(cell: str) -> str:
    """Return a number of a table with the digits that are worth reading."""
    try:
        return format_number(float(cell)) if "." in cell or "e" in cell else cell
    except ValueError:
        return cell


def provenance(result: Result) -> str:
    """Return how the result was made, folded; not where on the disk."""
    options = {f"option {key}": value for key, value in result.config.items() if key != "out"}
    versions = {f"{name} version": text for name, text in result.run.get("versions", {}).items()}
    shown = ("versions", "command", "files")
    rest = {key: item for key, item in result.run.items() if key not in shown}
    body = "".join(
        f"<tr><td>{escape(key)}</td><td>{escape(format_number(value))}</td></tr>"
        for key, value in {**options, **rest, **versions}.items()
    )
    duration = format_number(result.run.get("wall_time_s"))
    text = f"how it was made ({duration} s, seed {result.config.get('seed')})"
    return folded(text, table((), body), extra=True)


def _ratio(ours: Any, thesis: Any) -> str:
    """Return ours over the thesis' value, where both are numbers."""
    ours, thesis = (
        value.get("median") if isinstance(value, dict) else value for value in (ours, thesis)
    )
    if not isinstance(ours, int | float) or not isinstance(thesis, int | float) or thesis == 0:
        return ""
    return format_number(float(ours / thesis))
