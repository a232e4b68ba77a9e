"""An arm that goes from word to word as a recording for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from controllers.braid.arm.stage import STATES
from controllers.braid.bus.drive import DriveConfig, WireDrive
from experiments.appe.mechanism.bench import TICK, make_bench
from experiments.appe.mechanism.braid_record import BraidRecord
from experiments.appe.mechanism.trial import WordTrial
from experiments.harness.recording import recording
from models.braid.build import BraidConfig
from twin.layout import scene_view, side_by_side

EVERY = 4
"""Ticks of the drive from one picture to the next."""


def record_words(trial: WordTrial, path: Path) -> None:
    """Write an arm with the stereo head in random words.

    Args:
        trial: The arm and its words.
        path: File to write.
    """
    bench = make_bench(BraidConfig(trial.stages))
    layout = side_by_side(
        scene_view("world", "BRAID", (0.45, -0.45, 0.35), (0.0, 0.0, 0.12)),
        rrb.Vertical(
            rrb.TimeSeriesView(origin="curves/legs", name="Legs: -1 short, 1 long"),
            rrb.TimeSeriesView(origin="curves/hottest_wire", name="Hottest wire [degC]"),
            rrb.TextLogView(origin="word", name="Word"),
        ),
    )
    with recording(path, layout) as stream:
        record = BraidRecord(stream, bench)
        rng = np.random.default_rng(trial.seed)
        word = np.zeros(trial.stages, dtype=np.int64)
        bench.put(word)
        drive = WireDrive(word, DriveConfig(at_once=trial.at_once))
        time = 0.0
        for _ in range(trial.words):
            word = rng.integers(0, STATES, trial.stages)
            drive.change(word)
            stream.set_time("sim_time", duration=time)
            stream.log("word", rr.TextLog("".join(map(str, word))))
            for tick in range(round(drive.duration / TICK)):
                bench.heat(drive.levels((tick + 0.5) * TICK))
                bench.step(TICK)
                time += TICK
                if tick % EVERY == 0:
                    record.take(time)
