"""A moving picture of a map growing: ``python -m experiments.ch3.planar.movie OUT.gif``."""

from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from experiments.ch3.planar.figures import shades
from experiments.ch3.planar.trial import TARGET, PlanarTrial, Round, build_world, run_trial

SCALE = 2
"""Pixels of a cell."""
COLOURS = ((220, 40, 40), (0, 120, 220), (240, 150, 0), (60, 160, 60), (150, 80, 200))
FOV_DEG, DEPTH = 75.0, 10.0
FINAL_HOLD = 2000
"""How long the last picture stays [ms]."""


def film(trial: PlanarTrial, every: int) -> list[NDArray[np.uint8]]:
    """Return pictures of the map after every few rounds, and after the last.

    Args:
        trial: What to run.
        every: Rounds from one picture to the next.
    """
    world = build_world(trial)
    frames: list[NDArray[np.uint8]] = []
    trails: list[list[tuple[int, int]]] = [[] for _ in range(trial.robots)]

    def take(shown: Round) -> None:
        for robot, view in enumerate(shown.views):
            cells = [shown.cells[robot]] if view is None else view.path.tolist()
            trails[robot] += [_pixel(cell, world.grid.rows) for cell in cells]
        if shown.index % every == 0 or shown.fraction >= trial.target:
            frames.append(_draw(shown, trails, trial))

    run_trial(trial, world, take)
    return frames


def _pixel(cell: tuple[int, int] | list[int], rows: int) -> tuple[int, int]:
    return int(SCALE * (cell[1] + 0.5)), int(SCALE * (rows - cell[0] - 0.5))


def _draw(
    shown: Round, trails: list[list[tuple[int, int]]], trial: PlanarTrial
) -> NDArray[np.uint8]:  # fmt: skip
    """Draw the map, trails, poses and fields of view."""
    grey = (255 * shades(shown.map.states())[::-1]).astype(np.uint8)
    large = np.repeat(np.repeat(grey, SCALE, axis=0), SCALE, axis=1)
    picture = np.repeat(large[:, :, None], 3, axis=2)
    grid = shown.map.grid
    reach = round(SCALE * trial.depth / grid.cell)
    for robot, (cell, heading) in enumerate(zip(shown.cells, shown.headings)):
        colour = COLOURS[robot % len(COLOURS)]
        cv2.polylines(picture, [np.array(trails[robot])], False, colour, 1)
        at = _pixel(cell, grid.rows)
        middle, half = -float(np.degrees(heading)), trial.fov_deg / 2.0
        arc = cv2.ellipse2Poly(at, (reach, reach), round(middle), round(-half), round(half), 5)
        cv2.polylines(picture, [np.vstack([[at], arc])], True, colour, 1)
        cv2.circle(picture, at, 4, colour, -1)
    strip = np.full((22, picture.shape[1], 3), 255, dtype=np.uint8)
    text = f"scan {shown.index + 1}   {shown.fraction:.0%} mapped   {shown.metres:.0f} m"
    cv2.putText(strip, text, (4, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([picture, strip])


def main(
    out: Annotated[Path, tyro.conf.Positional],
    world: Literal["unstructured", "indoor"] = "indoor",
    robots: int = 2,
    every: int = 2,
    rate: float = 10.0,
    seed: int = 0,
) -> None:
    """Write a GIF of robots that map a world by expected information.

    Args:
        out: File to write.
        world: Kind of world.
        robots: Number of robots, cooperating.
        every: Rounds from one picture to the next.
        rate: Pictures a second [1/s].
        seed: Random seed of world and candidates.
    """
    trial = PlanarTrial(world, seed, "information", FOV_DEG, DEPTH, 600, robots, target=TARGET)
    frames = film(trial, every)
    colours = Image.fromarray(frames[-1]).quantize(24)
    images = [
        Image.fromarray(f).quantize(palette=colours, dither=Image.Dither.NONE) for f in frames
    ]
    times = [round(1000 / rate)] * (len(images) - 1) + [FINAL_HOLD]
    images[0].save(out, save_all=True, append_images=images[1:], duration=times, loop=0)


if __name__ == "__main__":
    tyro.cli(main)
