"""A moving picture of a map growing: ``python -m experiments.ch3.planar.movie OUT.gif``."""

from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from experiments.ch3.planar.figures import ROBOT_COLOURS, picture_points, sector, shades
from experiments.ch3.planar.trial import TARGET, PlanarTrial, Round, build_world, run_trial
from experiments.harness.recording import write_gif
from perception.geometry.arrays import IntArray

SCALE = 2
"""Pixels of a cell."""
FINAL_HOLD = 2000
"""Duration of the last picture [ms]."""


def film(trial: PlanarTrial, every: int) -> list[NDArray[np.uint8]]:
    """Return pictures of the map after every few rounds, and after the last.

    Args:
        trial: Trial to run.
        every: Rounds from one picture to the next.
    """
    frames: list[NDArray[np.uint8]] = []
    trails: list[list[IntArray]] = [[] for _ in range(trial.robots)]

    def take(shown: Round) -> None:
        for trail, cell, view in zip(trails, shown.cells, shown.views, strict=True):
            trail.append(np.array([cell]) if view is None else view.path)
        if shown.index % every == 0 or shown.fraction >= trial.target:
            frames.append(_draw(shown, trails, trial))

    run_trial(trial, build_world(trial), take)
    return frames


def _draw(shown: Round, trails: list[list[IntArray]], trial: PlanarTrial) -> NDArray[np.uint8]:
    """Draw the map, trails, poses and fields of view."""
    grey = (255 * shades(shown.map.states())[::-1]).astype(np.uint8)
    picture = np.repeat(grey.repeat(SCALE, axis=0).repeat(SCALE, axis=1)[:, :, None], 3, axis=2)
    grid = shown.map.grid
    for robot, (cell, heading) in enumerate(zip(shown.cells, shown.headings)):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        at = picture_points(np.array(cell), grid)
        trail = picture_points(np.concatenate(trails[robot]), grid)
        for line in (trail, sector(at, heading, trial.sensor, grid)):
            cv2.polylines(picture, [np.rint(SCALE * line).astype(np.int32)], False, colour, 1)
        cv2.circle(picture, np.rint(SCALE * at).astype(int).tolist(), 4, colour, -1)
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
    trial = PlanarTrial(world, seed, "information", 75.0, 10.0, 600, robots, target=TARGET)
    frames = [Image.fromarray(frame) for frame in film(trial, every)]
    write_gif(out, frames, frames[-1].quantize(24), 1000 / rate, FINAL_HOLD)


if __name__ == "__main__":
    tyro.cli(main)
