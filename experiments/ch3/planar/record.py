"""A planar mapping run as a recording for the rerun viewer."""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from experiments.ch3.planar.figures import shades
from experiments.ch3.planar.trial import PlanarRun, PlanarTrial, Round, build_world, run_trial
from experiments.harness.recording import recording, viridis
from perception.planar.map import Grid
from perception.planar.raycast import RangeSensor
from twin.layout import side_by_side

COLOURS = ((220, 40, 40), (0, 170, 190), (240, 150, 0), (60, 160, 60), (150, 80, 200))
ARC = 16
"""Corners along the edge of a drawn sector."""
ROUND = 1.0
"""A round's length on the recording's time line [s]; planar runs have no time of their own."""


def record_trial(trial: PlanarTrial, path: Path) -> PlanarRun:
    """Run a trial and write it: the map growing, poses, paths, candidates by rating, curves.

    Pictures have the world's far side on top; a pixel is a cell.

    Args:
        trial: What to run.
        path: File to write.

    Returns:
        What the run returned.
    """
    world = build_world(trial)
    with recording(path, blueprint()) as stream:
        return run_trial(trial, world, lambda shown: _log(stream, trial.sensor, world.grid, shown))


def blueprint() -> rrb.Blueprint:
    """Return the layout: the map, and the curves beside it."""
    return side_by_side(
        rrb.Spatial2DView(origin="map", name="Map"),
        rrb.Vertical(
            rrb.TimeSeriesView(origin="curves/fraction", name="Fraction mapped"),
            rrb.TimeSeriesView(origin="curves/metres", name="Distance moved [m]"),
        ),
    )


def _log(stream: rr.RecordingStream, sensor: RangeSensor, grid: Grid, shown: Round) -> None:
    seconds = shown.index * ROUND
    when = [
        rr.TimeColumn("sim_time", duration=[seconds]),
        rr.TimeColumn("step", sequence=[shown.index]),
    ]
    picture = (255 * shades(shown.map.states())[::-1]).astype(np.uint8)
    stream.reset_time()
    stream.set_time("sim_time", duration=seconds)
    stream.set_time("step", sequence=shown.index)
    stream.log("map", rr.Image(picture, color_model="L").compress(95))
    for robot, (cell, heading) in enumerate(zip(shown.cells, shown.headings)):
        colour = COLOURS[robot % len(COLOURS)]
        at = _pixels(np.array(cell, dtype=float), grid)
        name = f"map/robot{robot + 1}"
        stream.log(f"{name}/pose", rr.Points2D(at[None], radii=1.5, colors=[colour]))
        stream.log(f"{name}/view", rr.LineStrips2D([_sector(at, heading, sensor, grid)],
                                                   colors=[colour]))  # fmt: skip
        view = shown.views[robot]
        if view is None:
            continue
        stream.log(f"{name}/path", rr.LineStrips2D([_pixels(view.path, grid)], colors=[colour]))
        dots = rr.Points2D(
            _pixels(view.candidates, grid), radii=0.8, colors=_rating_colours(view.ratings)
        )
        stream.log(f"{name}/candidates", dots)
    for name, value in (("fraction", shown.fraction), ("metres", shown.metres)):
        stream.send_columns(f"curves/{name}", when, rr.Scalars.columns(scalars=[value]))


def _pixels(cells: NDArray[Any], grid: Grid) -> NDArray[np.float64]:
    """Return the picture's (x, y) of cells (..., 2)."""
    cells = np.asarray(cells, dtype=float)
    return np.stack([cells[..., 1] + 0.5, grid.rows - cells[..., 0] - 0.5], axis=-1)


def _sector(
    at: NDArray[np.float64], heading: float, sensor: RangeSensor, grid: Grid
) -> NDArray[np.float64]:
    angles = heading + np.linspace(-0.5, 0.5, ARC) * sensor.fov
    edge = at + sensor.depth / grid.cell * np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    return np.vstack([at, edge, at])


def _rating_colours(ratings: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colour by rating from dark to bright; what brings nothing is darkest."""
    finite = np.isfinite(ratings)
    scaled = np.zeros(len(ratings))
    if finite.any():
        low, high = ratings[finite].min(), ratings[finite].max()
        scaled[finite] = (ratings[finite] - low) / max(high - low, 1e-12)
    return viridis(scaled)
