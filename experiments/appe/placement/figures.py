"""Figures of ``appe-placement``: a setting before and after, and what is seen in all of them."""

import numpy as np
from matplotlib.figure import Figure

from experiments.appe.placement.trial import REST, PlacementTrial, prepare
from perception.geometry.arrays import FloatArray


def draw_views(trial: PlacementTrial) -> Figure:
    """Show a setting from outside and by the camera, at home and in the word that is planned."""
    scene, plan, _ = prepare(trial)
    if plan is None:
        raise ValueError(f"seed {trial.seed}: BRAID can take no placement there")
    figure = Figure(figsize=(11, 8))
    pictures = [("at home", scene.from_outside(), scene.picture())]
    scene.bench.put(plan.word)
    scene.bench.step(REST)
    word = "".join(map(str, plan.word))
    pictures.append((f"word {word}", scene.from_outside(), scene.picture()))
    for row, (title, outside, inside) in enumerate(pictures):
        for column, picture in enumerate((outside, inside)):
            axes = figure.add_subplot(2, 2, 1 + 2 * row + column)
            axes.imshow(picture)
            axes.set_title(f"{title}: " + ("left camera" if column else "from outside"))
            axes.axis("off")
    figure.tight_layout()
    return figure


def draw_settings(home: FloatArray, seen: FloatArray, random: FloatArray) -> Figure:
    """Show the visible parts of the target: at home, by random words, and as placed."""
    figure = Figure(figsize=(6, 3.6))
    axes = figure.add_subplot(1, 1, 1)
    groups = (("home", home), ("random words", random), ("placed", seen))
    rng = np.random.default_rng(0)
    for index, (_, values) in enumerate(groups):
        axes.plot(index + rng.uniform(-0.2, 0.2, len(values)), values, "o", ms=4, alpha=0.6)
    axes.set_xticks(range(len(groups)), [name for name, _ in groups])
    axes.set(ylabel="visible part of the target", ylim=(-0.05, 1.05))
    axes.grid(alpha=0.3)
    figure.tight_layout()
    return figure
