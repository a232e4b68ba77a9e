"""Curves of runs: what was measured beside what a model reads, and the error beside them."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import matplotlib.pyplot as plt

from perception.geometry.arrays import FloatArray

SHOWN = 12
"""Most signals of a figure."""
DRAWN, TUNED = "tab:orange", "tab:blue"
_STYLES: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "measured": {"color": "0.2", "lw": 1.5},
        "as drawn": {"color": DRAWN, "lw": 0.8},
        "as fitted": {"color": TUNED, "lw": 0.8, "ls": "--"},
        "simulated": {"color": TUNED, "lw": 0.8, "ls": "--"},
    }
)


@dataclasses.dataclass(frozen=True)
class Panel:
    """One signal.

    Attributes:
        name: Its name.
        stamps: (n,) times [s].
        curves: (n,) values, by one of the names measured, as drawn, as fitted and simulated.
        error: (n,) what is drawn beside them.
    """

    name: str
    stamps: FloatArray
    curves: Mapping[str, FloatArray]
    error: FloatArray


def plot_panels(panels: Sequence[Panel], error: str, path: Path, band: float = 0.0) -> None:
    """Plot the first signals, each with its error to the right.

    Args:
        panels: The signals.
        error: What the errors are.
        path: Picture to write.
        band: Half of a band about zero in which errors are usual; 0 for none.
    """
    shown = panels[:SHOWN]
    size = (8.0, 0.4 + 1.1 * len(shown))
    figure, grid = plt.subplots(
        len(shown), 2, figsize=size, sharex="col", squeeze=False, layout="constrained"
    )
    for (left, right), each in zip(grid, shown, strict=True):
        for label, values in each.curves.items():
            left.plot(each.stamps, values, label=label, **_STYLES[label])
        name = each.name.replace("/", "\n").replace(".", "\n")
        left.set_ylabel(f"{name}\n[SI]", fontsize="x-small")
        right.plot(each.stamps, each.error, color=TUNED, lw=0.6)
        if band:
            right.axhspan(-band, band, color="0.9")
    grid[0, 0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    grid[0, 1].set_title(error)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    figure.savefig(path)
    plt.close(figure)
