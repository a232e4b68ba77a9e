"""One test of ``ch4-montecarlo`` as a recording for the rerun viewer."""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from experiments.ch4.montecarlo.figures import SHOWN
from experiments.ch4.montecarlo.scenario import SCENARIO, ObstacleWorld, draw_worlds
from experiments.ch4.montecarlo.trial import PLACEMENTS, draw_chance, guide
from experiments.harness.recording import closed, recording
from perception.geometry.arrays import FloatArray
from twin.recording.layout import content_alone

BLUE, GREEN, RED, PURPLE, GREY = (
    (40, 90, 200), (40, 150, 60), (210, 40, 40), (130, 80, 170), (110, 110, 110),
)  # fmt: skip


def record_test(seed: int, path: Path) -> None:
    """Write one test with all placements: obstacles, object, camera and sightings over time.

    Args:
        seed: Seed of the test.
        path: File to write.
    """
    chance = draw_chance(seed)
    world = draw_worlds(chance.candidates)[SHOWN]
    views: list[Any] = [rrb.Spatial2DView(origin=name, name=name) for name in PLACEMENTS]
    curves = rrb.TimeSeriesView(origin="error_mm", name="Error across the slot [mm]")
    layout = content_alone(rrb.Vertical(rrb.Horizontal(*views), curves))
    with recording(path, layout) as stream:
        for index, placement in enumerate(PLACEMENTS):
            _, track = guide(SCENARIO, world, chance, index, True)
            _log_world(stream, placement, world)
            for step, row in enumerate(track):
                _log_step(stream, placement, step, row)


def _log_world(stream: rr.RecordingStream, placement: str, world: ObstacleWorld) -> None:
    """Log the static scene, mirrored as pictures have y downwards."""
    outlines = [closed(corners) * (1, -1) for corners in world.corners]
    stream.log(f"{placement}/obstacles", rr.LineStrips2D(outlines, colors=GREY), static=True)
    half = 0.5 * SCENARIO.width
    slot = rr.LineStrips2D([[[-half, 0.0], [half, 0.0]]], colors=PURPLE, radii=0.006)
    stream.log(f"{placement}/slot", slot, static=True)


def _log_step(stream: rr.RecordingStream, placement: str, step: int, row: FloatArray) -> None:
    gap, x, y, seen, error, _ = row
    stream.set_time("sim_time", duration=step * SCENARIO.period)
    stream.set_time("step", sequence=step)
    low = [error - 0.5 * SCENARIO.width, -gap - SCENARIO.length]
    box = rr.Boxes2D(mins=[low], sizes=[[SCENARIO.width, SCENARIO.length]], colors=PURPLE)
    stream.log(f"{placement}/object", box)
    if np.isfinite(x):
        colour = (RED, BLUE, GREEN)[int(seen)]
        stream.log(f"{placement}/camera", rr.Points2D([[x, -y]], colors=colour, radii=0.025))
    side = 0.5 * SCENARIO.width + SCENARIO.ear
    goal = [side if seen == 1 else -side, -0.5 * gap]
    lines = [[[x, -y], goal]] if seen else []
    stream.log(f"{placement}/sight", rr.LineStrips2D(lines, colors=BLUE if seen == 1 else GREEN))
    stream.log(f"error_mm/{placement}", rr.Scalars(1e3 * error))
