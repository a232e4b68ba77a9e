"""An approach of the panel as a recording for the rerun viewer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from controllers.placement.planar.search import rating_field
from experiments.ch4.planar.motion import STEP, MappedSite, Moment
from experiments.harness import figure_style
from experiments.harness.figure_style import BLUE, RED, rgb
from experiments.harness.recording import closed, recording, viridis
from perception.geometry.arrays import FloatArray
from twin.recording.layout import side_by_side

SPACING = 2.0
"""Distance between the rated positions that are shown [m]."""
SPEED = 1.0
"""Speed of the panel on the recording's time line [m/s]."""
COLOURS = {"primary": rgb(RED), "secondary": rgb(BLUE)}
GREEN, ORANGE, GREY = rgb(figure_style.GREEN), rgb(figure_style.ORANGE), (150, 150, 150)


def record_approach(site: MappedSite, moments: Sequence[Moment], path: Path) -> None:
    """Write the approach: estimated map, hulls, ratings of positions, targets, panel, chosen view.

    Pictures have the world's far side on top; a pixel is a cell.

    Args:
        site: Mapped site of the approach.
        moments: States after each step of the approach.
        path: File to write.
    """
    layout = side_by_side(
        rrb.Spatial2DView(origin="map", name="Map, hulls and ratings of positions"),
        rrb.Vertical(
            rrb.TimeSeriesView(origin="curves/rating", name="Rating [1/m]"),
            rrb.TimeSeriesView(origin="curves/free_cap", name="Target field visibility [deg]"),
        ),
    )
    with recording(path, layout) as stream:
        for moment in moments:
            _log(stream, site, moment)


def _log(stream: rr.RecordingStream, site: MappedSite, moment: Moment) -> None:
    task, cell = moment.task, site.world.grid.cell
    rows = site.world.grid.rows

    def pixels(points: FloatArray) -> FloatArray:
        """Return the picture's (x, y) of points (..., 2) [m]."""
        points = np.asarray(points, dtype=float) / cell
        return np.stack([points[..., 0], rows - points[..., 1]], axis=-1)

    stream.set_time("sim_time", duration=moment.step * STEP / SPEED)
    stream.set_time("step", sequence=moment.step)
    grey = (255.0 * (1.0 - task.space.probability[::-1])).astype(np.uint8)
    stream.log("map", rr.Image(grey, color_model="L").compress(95))
    stream.log("map/panel/true", rr.LineStrips2D([closed(pixels(moment.panel))], colors=[ORANGE]))
    for target in task.targets:
        hulls = task.expanded(target)
        strips = [closed(pixels(target.position + hulls.hull(i))) for i in range(len(hulls.names))]
        stream.log(f"map/targets/{target.name}/hulls", rr.LineStrips2D(strips, colors=[GREY]))
        line = pixels(target.position + target.outline)
        colour = COLOURS[target.name]
        mark = rr.LineStrips2D([line], colors=[colour], radii=1.0, labels=[target.name])
        stream.log(f"map/targets/{target.name}/outline", mark)
    side = np.arange(0.5 * SPACING, rows * cell, SPACING)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    ratings = rating_field(task, places).max(axis=0)
    seen = ratings > 0.0
    shade = np.sqrt(ratings[seen] / max(float(ratings.max()), 1e-12))
    stream.log("map/ratings", rr.Points2D(pixels(places[seen]), radii=0.9, colors=viridis(shade)))
    view = moment.view
    if view is None:
        stream.log("map/camera", rr.Clear(recursive=True))
        return
    line = pixels(np.stack([view.position, task.target(view.target).position]))
    stream.log("map/camera/place", rr.Points2D(line[:1], radii=3.0, colors=[GREEN]))
    stream.log("map/camera/axis", rr.LineStrips2D([line], colors=[COLOURS[view.target]]))
    stream.log("curves/rating", rr.Scalars(view.rating))
    stream.log("curves/free_cap", rr.Scalars(np.degrees(view.free_cap)))
