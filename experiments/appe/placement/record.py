"""A placement that BRAID carries out, as a recording for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from controllers.braid.bus.drive import WireDrive
from experiments.appe.mechanism.record import LEGS_VIEW, recorded_ticks
from experiments.appe.placement.trial import PlacementTrial, prepare
from twin.recording.layout import scene_view, side_by_side
from twin.recording.record import Recorder

IMAGE_EVERY = 40
"""Ticks of the drive from one camera picture to the next."""


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
        rrb.Vertical(rrb.Spatial2DView(origin="camera", name="Left camera"), LEGS_VIEW),
    )
    drive = WireDrive(np.zeros(trial.stages, dtype=np.int64))
    drive.change(plan.word)
    with Recorder(path, simulation=scene.bench, blueprint=layout) as recorder:
        sight = np.linspace(plan.view.position, scene.bench.data.geom("target").xpos, 100)
        recorder.log_points("world/placement", sight, np.ones(len(sight)))
        for tick, _ in enumerate(recorded_ticks(recorder, scene.bench, drive)):
            if tick % IMAGE_EVERY == 0:
                recorder.log_image("camera", np.ascontiguousarray(scene.picture()[..., ::-1]))
        recorder.log_image("camera", np.ascontiguousarray(scene.picture()[..., ::-1]))
