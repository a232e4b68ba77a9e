"""Every table and figure of the thesis: where it is shown in the page, or why it is not."""

from collections.abc import Collection, Sequence
from html import escape

from experiments.harness.thesis_elements import Element
from experiments.report.html import anchor, link, table
from experiments.report.results import Result


def element_table(
    elements: Sequence[Element], results: Sequence[Result], known: Collection[str]
) -> str:
    """Return the section on all elements.

    Args:
        elements: Elements of the thesis.
        results: Those that the page shows.
        known: Names of all experiments of this version.
    """
    wanted = [element for element in elements if not element.why_not]
    shown = [element for element in wanted if places(element, results)]
    rows = "".join(
        f"<tr><td><strong>{escape(element.name)}</strong></td><td>{escape(element.what)}</td>"
        f"{_state(element, results, known)}</tr>"
        for element in elements
    )
    return (
        '<section id="elements"><h2>The thesis, element by element: '
        f"{len(shown)} of {len(wanted)} shown</h2>"
        f"<p>{len(elements)} tables and figures in all; {len(elements) - len(wanted)} are "
        "photographs, sketches and diagrams, with nothing to measure.</p>"
        f"{table(('element', 'what it shows', 'here'), rows)}</section>"
    )


def places(element: Element, results: Sequence[Result]) -> list[tuple[str, str]]:
    """Return experiment and file name (without ending) of all that shows an element."""
    return [
        (result.name, stem)
        for result in results
        if result.name in element.shown_by
        for stem in dict.fromkeys(path.stem for path in (*result.figures, *result.tables))
        if element.shown_in(stem)
    ]


def captions(elements: Sequence[Element], experiment: str, stem: str) -> str:
    """Return what the thesis shows by a picture or table of that name; empty if it is ours."""
    found = [
        f"{element.name}: {element.what}"
        for element in elements
        if experiment in element.shown_by and not element.why_not and element.shown_in(stem)
    ]
    return "; ".join(found)


def _state(element: Element, results: Sequence[Result], known: Collection[str]) -> str:
    there = {result.name for result in results}
    if element.why_not:
        names = [link(name, name) for name in element.shown_by if name in there]
        see = f" ({', '.join(names)})" if names else ""
        return f'<td class="why">not shown: {escape(element.why_not)}{see}</td>'
    found = places(element, results)
    if found:
        links = (link(anchor(name, stem), stem.replace("_", " ")) for name, stem in found)
        return f"<td>{', '.join(links)}</td>"
    name = element.shown_by[0]
    if name not in known:
        return f'<td class="fail">this version has no {escape(name)} yet</td>'
    if name in there:
        return f"<td>not in this run of {link(name, name)}</td>"
    return f"<td>not run: <code>python -m experiments {escape(name)}</code></td>"
