"""Whole insertions in physics: what must succeed, what must stop, and what is written."""

import csv
import json
import math

import numpy as np
import PIL.Image
import PIL.ImageSequence
import pytest

from experiments.ch5 import insertion as ch5_insertion
from experiments.ch5.insertion_faults import ENDS_IN, Fault
from experiments.ch5.insertion_setting import InsertionTrial
from experiments.ch5.insertion_trial import COURSE, STAGES, run_trial
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from models.datasheets import CARD_AND_SLOT
from twin.logs.mapping import read_log

STRIKE = 25.0
"""Largest contact force of a card in a slot that is too narrow for it [N].

A jammed card may snap out of the slot and strike its face: with another renderer's kernels one
course gave 15.2 N for one tick, while the wrench sensor felt 3 N. How often the force stays within
`MOST_FORCE` is a figure of the experiment.
"""


def test_unknown_detector_and_part_are_refused(tmp_path):
    with pytest.raises(OptionError, match="blob"):
        ch5_insertion.Options(out=tmp_path, detector="eyes")
    with pytest.raises(OptionError, match="impossible"):
        ch5_insertion.Options(out=tmp_path, parts=("table", "chair"))


def test_each_width_has_seeds_of_its_own_and_more_of_them_extend_the_list(tmp_path):
    options = ch5_insertion.Options(out=tmp_path, seeds=8)
    by_width = [ch5_insertion.width_seeds(options, w) for w in CARD_AND_SLOT.slot_widths]
    assert len({seed for seeds in by_width for seed in seeds}) == 8 * len(by_width)
    fewer = ch5_insertion.Options(out=tmp_path, seeds=3)
    for width, seeds in zip(CARD_AND_SLOT.slot_widths, by_width, strict=True):
        assert ch5_insertion.width_seeds(fewer, width) == seeds[:3]


@pytest.mark.slow
@pytest.mark.parametrize("fault", [Fault.HIDDEN, Fault.WRENCH])
def test_fault_ends_as_stated_with_bounded_force(fault):
    trial = InsertionTrial(CARD_AND_SLOT.slot_widths[1], True, 11, fault=fault.name, trace=True)
    result = run_trial(trial)
    inserted, reason = ENDS_IN[fault]
    assert result.success == inserted, result
    assert result.reason.startswith(reason)
    assert result.finite and result.peak <= ch5_insertion.MOST_FORCE
    course = result.course
    assert course.shape[1] == len(COURSE)
    assert STAGES[int(course[-1, -1])] is result.stage
    assert np.isfinite(course[:, :5]).all()


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_quick_run_inserts_at_the_narrowest_slot_and_writes_everything(tmp_path):
    """On each processor it takes another course; a second and third one are for mishaps."""
    inserted = any(quick_run_inserts(tmp_path / str(seed), seed) for seed in (1, 2, 3))
    assert inserted


def quick_run_inserts(out, seed):
    """Hold a quick run to what any course gives, and return whether a well-watched card got in."""
    options = ch5_insertion.Options(quick=True, seed=seed, jobs=1, out=out, log=True)
    output = Output("ch5-insertion", options)
    ch5_insertion.run(options, output)
    output.finish()
    folder = out / "ch5-insertion"
    measured = json.loads((folder / "metrics.json").read_text())["measured"]
    assert measured["success/impossible"]["mean"] == 0.0
    assert measured["largest_force"] <= ch5_insertion.MOST_FORCE
    assert measured["largest_force/impossible"] <= STRIKE
    assert not math.isnan(measured["mcnemar_p/4.375"])
    assert (folder / "figures" / "table_5-1.png").is_file()
    with (folder / "tables" / "insertions.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert [row["placement"] for row in rows] == ["optimal", "random"]
    for row in rows:
        # What got in was before the slot's mouth, and what did not has a reason.
        if row["success"] == "True":
            assert abs(float(row["across [mm]"])) < 3.0
        else:
            assert row["reason"]
    if rows[0]["success"] != "True":
        return False
    for name in ("figure_5-11", "figure_5-12", "figure_5-13"):
        assert (folder / "figures" / f"{name}.png").is_file()
    with PIL.Image.open(folder / "insertion.gif") as film:
        frames = [
            np.asarray(frame.convert("L"), float) for frame in PIL.ImageSequence.Iterator(film)
        ]
    signals = read_log(folder / "run.mcap").signals
    assert {"rover1/arm", "rover2/arm", "rover2/arm_base_wrench"} <= set(signals)
    assert np.ptp(signals["rover2/arm_angles"].values, axis=0).max() > 0.1
    # The card moves, in a picture that is more than one colour.
    assert len(frames) > 5 and min(frame.std() for frame in frames) > 5.0
    assert np.abs(frames[-1] - frames[0]).max() > 30.0
    return True
