"""Words that BRAID goes to, as a recording for the rerun viewer."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from controllers.braid.arm.stage import STATES
from controllers.braid.bus.drive import DriveConfig, WireDrive
from experiments.appe.mechanism.bench import TICK, BraidBench, make_bench
from experiments.appe.mechanism.trial import ArmTrial
from models.braid.build import BraidConfig
from models.datasheets import BRAID, MUSCLE_WIRE
from twin.loop import Tick
from twin.recording.layout import scene_view, side_by_side
from twin.recording.record import Recorder

LEGS_VIEW = rrb.TimeSeriesView(origin="curves/legs", name="Legs: -1 short, 1 long")


def recorded_ticks(recorder: Recorder, bench: BraidBench, drive: WireDrive) -> Iterator[float]:
    """Carry out a change of word as `BraidBench.ticks` does, and record bodies, wires and legs."""
    for time in bench.ticks(drive):
        recorder.record(Tick(round(bench.data.time / TICK), bench.data.time, {}, {}))
        hot = MUSCLE_WIRE.ambient + bench.data.act[bench.model.actuator_actadr[bench.wires]]
        recorder.log_scalars("curves/hottest_wire", float(hot.max()))
        recorder.log_scalars("curves/legs", (bench.travel() / BRAID.half_stroke).ravel())
        yield time


def record_words(trial: ArmTrial, path: Path) -> None:
    """Write an arm with the stereo head that goes to random words.

    Args:
        trial: The arm and its words.
        path: File to write.
    """
    bench = make_bench(BraidConfig(trial.stages))
    layout = side_by_side(
        scene_view("world", "BRAID", (0.45, -0.45, 0.35), (0.0, 0.0, 0.12)),
        rrb.Vertical(
            LEGS_VIEW,
            rrb.TimeSeriesView(origin="curves/hottest_wire", name="Hottest wire [degC]"),
            rrb.TextLogView(origin="word", name="Word"),
        ),
    )
    rng = np.random.default_rng(trial.seed)
    word = np.zeros(trial.stages, dtype=np.int64)
    bench.put(word)
    drive = WireDrive(word, DriveConfig(at_once=trial.at_once))
    with Recorder(path, simulation=bench, blueprint=layout) as recorder:
        for _ in range(trial.words):
            word = rng.integers(0, STATES, trial.stages)
            drive.change(word)
            recorder.log_text("word", "".join(map(str, word)))
            for _ in recorded_ticks(recorder, bench, drive):
                pass
