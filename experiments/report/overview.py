"""What was found: a card for each experiment, with its picture and its first figures."""

from collections.abc import Sequence
from html import escape
from typing import Any

from experiments.harness.summary import format_metric
from experiments.harness.thesis_elements import Element
from experiments.report.elements import captions
from experiments.report.html import link, plain_key
from experiments.report.images import embed
from experiments.report.results import Result

SHOWN = 3
"""Figures of a card, those that the thesis has as well first."""
CARD = 720
"""Width of a card's picture [px]: twice that of the card."""


def overview(results: Sequence[Result], thesis: Sequence[Element]) -> str:
    """Return the section that the page begins with.

    Args:
        results: All results.
        thesis: All elements of the thesis, whose pictures go before others.

    Raises:
        ExperimentError: If a picture is damaged.
    """
    cards = "".join(_card(result, thesis) for result in results)
    return f'<section id="found"><h2>What was found</h2><div class="cards">{cards}</div></section>'


def _card(result: Result, thesis: Sequence[Element]) -> str:
    measured, beside = result.metrics["measured"], result.metrics["thesis"]
    keys = [*beside, *(key for key in measured if key not in beside)][:SHOWN]
    lines = "".join(_line(key, measured.get(key), beside.get(key)) for key in keys)
    return (
        f"<article><h3>{link(result.name, result.title or result.name)}</h3>"
        f"{_picture(result, thesis)}<ul>{lines}</ul><p>{_judged(result)}</p></article>"
    )


def _line(key: str, ours: Any, thesis: Any) -> str:
    centre, interval = format_metric(ours)
    text = f"<strong>{escape(centre)}</strong>"
    text += f" ({escape(interval)})" if interval else ""
    text += "" if thesis is None else f", thesis {escape(format_metric(thesis)[0])}"
    return f"<li>{escape(plain_key(key))}: {text}</li>"


def _judged(result: Result) -> str:
    checks = result.metrics["checks"]
    if result.config.get("quick"):
        return "A quick run: not judged."
    held = sum(bool(check["ok"]) for check in checks)
    return f"{held} of {len(checks)} checks hold." if checks else "Nothing is checked."


def _picture(result: Result, thesis: Sequence[Element]) -> str:
    paths = sorted(result.figures, key=lambda path: not captions(thesis, result.name, path.stem))
    if not paths:
        return ""
    picture = embed(paths[0], CARD)
    return f'<img alt="" width="{picture.width}" height="{picture.height}" src="{picture.url}">'
