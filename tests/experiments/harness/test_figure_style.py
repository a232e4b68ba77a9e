"""Colours: one for each method of a figure, told apart by the colour-blind as well."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from controllers.mapping import METHODS
from experiments.ch2.simulation.results import ESTIMATORS
from experiments.ch4.montecarlo.trial import PLACEMENTS
from experiments.harness.figure_style import COLOURS, plain_name, rgb, use_style

# Machado, Oliveira and Fernandes 2009: linear RGB as eyes without one kind of cones see it.
PROTANOPIA = [
    [0.152286, 1.052583, -0.204868],
    [0.114503, 0.786281, 0.099216],
    [-0.003882, -0.048116, 1.051998],
]
DEUTERANOPIA = [
    [0.367322, 0.860646, -0.227968],
    [0.280085, 0.672501, 0.047413],
    [-0.011820, 0.042940, 0.968881],
]


def seen_as(colour, eye):
    """Return what an eye makes of a colour, as sRGB."""
    coded = np.array(to_rgb(colour))
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(eye) @ linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("methods", [METHODS, ESTIMATORS, PLACEMENTS, ("master", "slave")])
@pytest.mark.parametrize("eye", [np.eye(3), PROTANOPIA, DEUTERANOPIA])
def test_methods_of_one_figure_are_told_apart(methods, eye):
    seen = [seen_as(COLOURS[method], eye) for method in methods]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 0.15


def test_a_colour_is_the_same_in_figures_and_recordings():
    assert np.allclose(np.array(rgb(COLOURS["master"])) / 255.0, to_rgb(COLOURS["master"]))


def test_style_colours_lines_by_its_own_cycle():
    use_style()
    (line,) = Figure().subplots().plot([0, 1])
    assert to_rgb(line.get_color()) == to_rgb(COLOURS["ours"])


def test_names_are_plain():
    assert plain_name("max_new") == "maximum new region" and plain_name("optimal") == "optimal"
    assert plain_name("some_other") == "some other"
