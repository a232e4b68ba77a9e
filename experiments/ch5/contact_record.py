"""An insertion as a recording for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from controllers.insertion.guide import Phase
from experiments.ch5.contact_bench import shape_of
from experiments.ch5.contact_figures import card_outline, wall_outlines
from experiments.harness.recording import recording
from twin.layout import side_by_side

GREEN, GREY = (40, 150, 80), (120, 120, 120)
EVERY = 5
"""Samples of the course from one shown to the next."""


def record_insertion(width: float, course: NDArray[np.float64], path: Path) -> None:
    """Write one insertion: slot, card, wrench and phase; lengths in mm, y downward in the view.

    Args:
        width: Width of the slot [m].
        course: (n, 11) as `ch5_contact_trial.run_insertion` returns it.
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
            stream.log("curves/force/across", rr.Scalars(row[7]))
            stream.log("curves/force/along", rr.Scalars(row[8]))
            stream.log("curves/moment", rr.Scalars(row[9]))
            if int(row[10]) != phase:
                phase = int(row[10])
                stream.log("phase", rr.TextLog(list(Phase)[phase].value))
