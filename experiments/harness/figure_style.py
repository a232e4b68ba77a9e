"""How figures look: one style sheet, and one colour for a method wherever it is drawn.

Colours are those of Okabe and Ito, which the colour-blind tell apart as well. Black is the truth or
the thesis, blue what this project proposes. In maps white is free, grey unknown, black occupied.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import matplotlib.style

STYLE = Path(__file__).with_name("figures.mplstyle")
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, GREY, YELLOW = "#CC79A7", "#56B4E9", "#404040", "#F0E442"
COLOURS: Mapping[str, str] = MappingProxyType(
    {
        # views and excitations
        "information": BLUE,
        "constant": RED,
        "random": ORANGE,
        "raster": GREEN,
        "max_new": RED,
        "min_old": PURPLE,
        "frontier": SKY,
        "rate": GREY,
        # estimators
        "ours": BLUE,
        "kalman": ORANGE,
        "pseudo_inverse": GREY,
        # camera placements
        "optimal": BLUE,
        "fixed": RED,
        # robots
        "master": BLUE,
        "slave": ORANGE,
        # links
        "framed": BLUE,
        "handshake": RED,
    }
)
"""Colour of each method and robot."""

NAMES: Mapping[str, str] = MappingProxyType(
    {
        "max_new": "maximum new region",
        "min_old": "minimum old region",
        "frontier": "nearest frontier",
        "rate": "information per metre",
        "kalman": "Kalman filter",
        "pseudo_inverse": "pseudo-inverse",
    }
)
"""Plain names of methods that are called otherwise on the command line and in metrics."""


def plain_name(method: str) -> str:
    """Return the name of a method for a legend."""
    return NAMES.get(method, method.replace("_", " "))


def use_style() -> None:
    """Let figures that are made from now on have this style."""
    matplotlib.style.use(STYLE)


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour as red, green and blue, 0 to 255, for recordings and pictures.

    Args:
        colour: Colour as ``#RRGGBB``.
    """
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
