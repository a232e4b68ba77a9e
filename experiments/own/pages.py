"""What an identification found, as a page, figures, tables, JSON and a model that loads."""

import csv
import dataclasses
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from experiments.harness.figure_style import use_style
from experiments.own.curves import DRAWN, TUNED, Panel, plot_panels
from experiments.own.identification import Estimate, Identified, Residual, Runs
from experiments.report.html import numbers, table
from experiments.report.images import embed
from experiments.report.style import STYLE

UNWHITE = 0.01
"""Probability below which residuals are no noise."""
CAPTIONS = {
    "parameters": "Parameters, over their values as drawn",
    "fitted": "Runs that were fitted",
    "unseen": "Runs that were held out",
}
"""What a figure shows."""


def write_all(found: Identified, folder: Path) -> Path:
    """Write everything into a folder, and return the page.

    Raises:
        OSError: If it cannot be written.
    """
    use_style()
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    (folder / "tables").mkdir(exist_ok=True)
    (folder / "model.xml").write_text(found.model().to_xml())
    (folder / "identified.json").write_text(json.dumps(as_json(found), indent=1) + "\n")
    write_table(folder / "tables" / "parameters.csv", found.estimates)
    write_table(folder / "tables" / "residuals.csv", found.seen.residuals())
    plot_bands(found.estimates, folder / "figures" / "parameters.png")
    plot_runs(found.seen, folder / "figures" / "fitted.png")
    pictures = ["parameters.png", "fitted.png"]
    if found.unseen is not None:
        plot_runs(found.unseen, folder / "figures" / "unseen.png")
        write_table(folder / "tables" / "residuals_unseen.csv", found.unseen.residuals())
        pictures.append("unseen.png")
    page = folder / "page.html"
    page.write_text(_page(found, [folder / "figures" / name for name in pictures]))
    return page


def as_json(found: Identified) -> dict[str, Any]:
    """Return what was found as plain data."""
    count = len(found.estimates)
    return {
        "good": not found.doubts,
        "doubts": list(found.doubts),
        "chi_square": found.fit.chi_square,
        "converged": found.fit.converged,
        "hold_out_ratio": None if found.unseen is None else found.unseen.ratio,
        "parameters": [dataclasses.asdict(each) for each in found.estimates],
        "covariance": found.fit.covariance[:count, :count].tolist(),
        "not_told_before": list(found.before.unknown),
        "not_told_combinations": [dict(each) for each in found.after.combinations],
        "residuals": [dataclasses.asdict(each) for each in found.seen.residuals()],
    }


def write_table(path: Path, rows: Sequence[Estimate] | Sequence[Residual]) -> None:
    """Write dataclasses as a CSV file."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([field.name for field in dataclasses.fields(rows[0])])
        writer.writerows(dataclasses.astuple(each) for each in rows)


def plot_bands(estimates: Sequence[Estimate], path: Path) -> None:
    """Plot each parameter's 95 % band over its value as drawn; those that are zero are left out."""
    shown = [each for each in estimates if each.drawn != 0.0]
    figure, axes = plt.subplots(figsize=(6.4, 1.2 + 0.22 * len(shown)), layout="constrained")
    for row, each in enumerate(shown):
        low, value, high = (end / each.drawn for end in (each.low, each.value, each.high))
        colour = TUNED if each.told else "0.6"
        axes.plot([low, high], [row, row], color=colour, lw=2)
        axes.plot(value, row, "o", color=colour, ms=4)
    axes.axvline(1.0, color=DRAWN, lw=1)
    axes.set_yticks(range(len(shown)), [each.name for each in shown])
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_xlabel("fitted over drawn, with 95 % band (grey: not told)")
    figure.savefig(path)
    plt.close(figure)


def plot_runs(runs: Runs, path: Path) -> None:
    """Plot what was measured and predicted, and the error as fitted, for the first channels."""
    panels: list[Panel] = []
    for (run, channel), place in runs.predictor.channels.items():
        measured, tuned = runs.predictor.measured[place], runs.tuned[place]
        curves = {"measured": measured, "as drawn": runs.drawn[place], "as fitted": tuned}
        error = (measured - tuned) / runs.predictor.sigma[place]
        panels.append(Panel(channel, runs.predictor.stamps(run, channel), curves, error))
    plot_panels(panels, "error as fitted, over the noise's deviation", path, band=2.0)


def _page(found: Identified, pictures: Sequence[Path]) -> str:
    doubts = "".join(f"<li>{escape(each)}</li>" for each in found.doubts)
    verdict = f"<ul>{doubts}</ul>" if doubts else "<p>Converged, and confirmed on unseen runs.</p>"
    kind, word = ("short", "Not good") if doubts else ("good", "Good")
    told = "".join(
        f"<li>{escape(' '.join(f'{weight:+.2f} {name}' for name, weight in each.items()))}</li>"
        for each in found.after.combinations
    )
    unknown = (
        f"<section><h2>What the logs do not tell</h2><ul>{told}</ul></section>" if told else ""
    )
    images = ""
    for path in pictures:
        image, caption = embed(path), CAPTIONS[path.stem]
        images += (
            f'<figure><img src="{image.url}" width="{image.width}" height="{image.height}" '
            f'alt="{caption}"><figcaption>{caption}</figcaption></figure>'
        )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>identification</title><style>{STYLE}</style></head>'
        "<body><header><h1>Identification</h1></header><main>"
        f'<section class="{kind}"><h2>{word}</h2>{verdict}'
        f"<p>chi^2 per sample {found.fit.chi_square:.4g} after {found.fit.steps} steps.</p>"
        "</section>"
        f"<section><h2>Parameters</h2>{_estimates(found.estimates)}</section>{unknown}"
        f"<section><h2>Residuals of the runs fitted</h2>{_residuals(found.seen.residuals())}"
        f"</section>{_unseen(found.unseen)}<section><h2>Figures</h2>{images}</section>"
        "</main></body></html>\n"
    )


def _unseen(runs: Runs | None) -> str:
    if runs is None:
        return ""
    return (
        f"<section><h2>Unseen runs</h2><p>Error above the noise: {runs.ratio:.3g} of that as drawn."
        f"</p>{_residuals(runs.residuals())}</section>"
    )


def _estimates(estimates: Sequence[Estimate]) -> str:
    rows = "".join(
        f"<tr>{numbers([each.name])}"
        + numbers(
            [
                f"{each.drawn:.5g}",
                f"{each.value:.5g}",
                f"{each.low:.4g} to {each.high:.4g}",
                each.unit,
                f"{each.bits:.1f}",
                "yes" if each.told else "no",
            ]
        )
        + "</tr>"
        for each in estimates
    )
    heads = ["parameter", "as drawn", "as fitted", "95 % band", "unit", "bits", "told"]
    return table(heads, rows)


def _residuals(residuals: Sequence[Residual]) -> str:
    rows = "".join(
        "<tr>"
        + numbers(
            [
                str(each.run + 1),
                each.channel,
                f"{each.noise:.3g}",
                f"{each.drawn:.3g}",
                f"{each.tuned:.3g}",
                f"{each.white:.2g}" + (" (no noise)" if each.white < UNWHITE else ""),
            ]
        )
        + "</tr>"
        for each in residuals
    )
    heads = ["run", "channel", "noise [SI]", "error as drawn / noise", "as fitted / noise", "white"]
    return table(heads, rows)
