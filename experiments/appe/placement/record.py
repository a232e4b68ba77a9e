"""A placement that BRAID carries out, as a recording for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from controllers.braid.bus.drive import WireDrive
from experiments.appe.mechanism.bench import TICK
from experiments.appe.mechanism.braid_record import BraidRecord
from experiments.appe.placement.trial import PlacementTrial, prepare
from experiments.harness.recording import recording
from twin.layout import scene_view, side_by_side

EVERY, IMAGE_EVERY = 4, 40
"""Ticks of the drive from one pose, and from one camera picture, to the next."""
_QUALITY = 70


def record_placement(trial: PlacementTrial, path: Path) -> None:
    """Write the rover, the blocks, the planned camera and what the left camera sees meanwhile.

    Args:
        trial: A setting in which BRAID can take a placement.
        path: File to write.

    Raises:
        ValueError: If it cannot.
    """
    scene, plan, _ = prepare(trial)
    if plan is None:
        raise ValueError(f"seed {trial.seed}: BRAID can take no placement there")
    layout = side_by_side(
        scene_view("world", "Rover with BRAID", (-0.3, -1.6, 0.9), (0.4, 0.0, 0.25)),
        rrb.Vertical(
            rrb.Spatial2DView(origin="camera", name="Left camera"),
            rrb.TimeSeriesView(origin="curves/legs", name="Legs: -1 short, 1 long"),
        ),
    )
    with recording(path, layout) as stream:
        record = BraidRecord(stream, scene.bench)
        line = [plan.view.position, scene.bench.data.geom("target").xpos.copy()]
        stream.log("world/placement", rr.LineStrips3D([line], colors=[(230, 60, 40)]), static=True)
        drive = WireDrive(np.zeros(trial.stages, dtype=np.int64))
        drive.change(plan.word)
        ticks = round(drive.duration / TICK)
        for tick in range(ticks):
            scene.bench.heat(drive.levels((tick + 0.5) * TICK))
            scene.bench.step(TICK)
            if tick % EVERY == 0:
                record.take((tick + 1) * TICK)
            if tick % IMAGE_EVERY == 0 or tick == ticks - 1:
                stream.set_time("sim_time", duration=(tick + 1) * TICK)
                stream.log("camera", rr.Image(scene.picture()).compress(_QUALITY))
