"""A planar mapping run as a recording for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from experiments.ch3.planar.figures import ROBOT_COLOURS, picture_points, sector, shades
from experiments.ch3.planar.trial import PlanarRun, PlanarTrial, Round, build_world, run_trial
from experiments.harness.recording import recording, viridis
from perception.planar.map import Grid
from perception.planar.raycast import RangeSensor
from twin.recording.layout import side_by_side

ROUND = 1.0
"""Duration of a round on the recording's time line [s]; planar runs have no time of their own."""


def record_trial(trial: PlanarTrial, path: Path) -> PlanarRun:
    """Run a trial and write it: the map growing, poses, paths, candidates by rating, curves.

    Pictures have the world's far side on top; a pixel is a cell.

    Args:
        trial: Trial to run.
        path: File to write.

    Returns:
        The run.
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
    picture = (255 * shades(shown.map.states())[::-1]).astype(np.uint8)
    stream.reset_time()
    stream.set_time("sim_time", duration=shown.index * ROUND)
    stream.set_time("step", sequence=shown.index)
    stream.log("map", rr.Image(picture, color_model="L").compress(95))
    for robot, (cell, heading, view) in enumerate(zip(shown.cells, shown.headings, shown.views)):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        at = picture_points(np.array(cell), grid)
        name = f"map/robot{robot + 1}"
        stream.log(f"{name}/pose", rr.Points2D(at[None], radii=1.5, colors=[colour]))
        outline = sector(at, heading, sensor, grid)
        stream.log(f"{name}/view", rr.LineStrips2D([outline], colors=[colour]))
        if view is None:
            continue
        path = picture_points(view.path, grid)
        stream.log(f"{name}/path", rr.LineStrips2D([path], colors=[colour]))
        dots, colours = picture_points(view.candidates, grid), _rating_colours(view.ratings)
        stream.log(f"{name}/candidates", rr.Points2D(dots, radii=0.8, colors=colours))
    stream.log("curves/fraction", rr.Scalars(shown.fraction))
    stream.log("curves/metres", rr.Scalars(shown.metres))


def _rating_colours(ratings: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return colours by rating from dark to bright; views that bring nothing are darkest."""
    finite = np.isfinite(ratings)
    scaled = np.zeros(len(ratings))
    if finite.any():
        low, high = ratings[finite].min(), ratings[finite].max()
        scaled[finite] = (ratings[finite] - low) / max(high - low, 1e-12)
    return viridis(scaled)
