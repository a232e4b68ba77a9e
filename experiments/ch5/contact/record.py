"""An insertion as a recording for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from controllers.insertion.guide import Phase
from experiments.ch5.contact.bench import shape_of
from experiments.ch5.contact.figures import card_outline, wall_outlines
from experiments.harness.recording import recording
from perception.geometry.arrays import FloatArray
from twin.recording.layout import side_by_side

GREEN, GREY = (40, 150, 80), (120, 120, 120)
EVERY = 5
"""Samples of the course from one shown to the next."""


def record_insertion(width: float, course: FloatArray, path: Path) -> None:
    """Write one insertion: slot, card, wrench and phase; lengths in mm, y downward in the view.

    Args:
        width: Width of the slot [m].
        course: (n, 11) course as in `InsertionResult.course`.
        path: File to write.
    """
    shape = shape_of(width)
    layout = side_by_side(
        rrb.Spatial2DView(origin="slot", name="Card and slot [mm]"),
        rrb.Vertical(
            rrb.TimeSeriesView(origin="curves/force", name="Contact force [N]"),
            rrb.TimeSeriesView(origin="curves/moment", name="Moment [N m]"),
            rrb.TextLogView(origin="phase", name="Phase"),
        ),
    )
    with recording(path, layout) as stream:
        flip = np.array([1e3, -1e3])
        walls = [wall * flip for wall in wall_outlines(shape)]
        stream.log("slot", rr.LineStrips2D(walls, colors=[GREY]), static=True)
        phase = -1
        for row in course[::EVERY]:
            stream.set_time("sim_time", duration=float(row[0]))
            outline = card_outline(shape, row[4:7]) * flip
            stream.log("slot/card", rr.LineStrips2D([outline], colors=[GREEN]))
            for name, value in zip(("force/across", "force/along", "moment"), row[7:10]):
                stream.log(f"curves/{name}", rr.Scalars(value))
            if int(row[10]) != phase:
                phase = int(row[10])
                stream.log("phase", rr.TextLog(list(Phase)[phase].value))
