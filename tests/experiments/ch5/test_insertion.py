"""Whole insertions in physics: what must succeed, what must stop, and what is written."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from experiments.ch5 import insertion as ch5_insertion
from experiments.ch5.insertion_faults import ENDS_IN, Fault
from experiments.ch5.insertion_setting import InsertionTrial
from experiments.ch5.insertion_trial import COURSE, STAGES, run_trial
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from models.datasheets import CARD_AND_SLOT

TURN_SHARE = 0.7
"""As `identify_slip` finds it."""


def test_unknown_detector_and_part_are_refused(tmp_path):
    with pytest.raises(OptionError, match="blob"):
        ch5_insertion.Options(out=tmp_path, detector="eyes")
    with pytest.raises(OptionError, match="impossible"):
        ch5_insertion.Options(out=tmp_path, parts=("table", "chair"))


@pytest.mark.slow
@pytest.mark.parametrize("fault", [Fault.HIDDEN, Fault.WRENCH])
def test_fault_ends_as_stated_with_bounded_force(fault):
    trial = InsertionTrial(
        CARD_AND_SLOT.slot_widths[1], True, 11, TURN_SHARE, fault=fault.name, trace=True
    )
    result = run_trial(trial)
    inserted, reason = ENDS_IN[fault]
    assert result["success"] == inserted, result
    assert result["reason"].startswith(reason)
    assert result["finite"] and result["peak"] <= ch5_insertion.MOST_FORCE
    course = result["course"]
    assert course.shape[1] == len(COURSE)
    assert STAGES[int(course[-1, -1])].value == result["stage"]
    assert np.isfinite(course[:, :5]).all()


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_quick_run_inserts_at_the_narrowest_slot_and_writes_everything(tmp_path):
    options = ch5_insertion.Options(quick=True, seed=1, jobs=1, out=tmp_path)
    output = Output("ch5-insertion", options)
    ch5_insertion.run(options, output)
    output.finish()
    folder = tmp_path / "ch5-insertion"
    measured = json.loads((folder / "metrics.json").read_text())["measured"]
    assert measured["success/optimal/4.375"]["mean"] == 1.0
    assert measured["success/impossible"]["mean"] == 0.0
    assert measured["largest_force"] <= ch5_insertion.MOST_FORCE
    assert measured["largest_force/impossible"] <= ch5_insertion.MOST_FORCE
    assert measured["hand_over_mm"]["median"] < 1.5
    assert 0.3 < measured["guidance_nees/optimal"]["median"] < 3.0
    assert 0.0 < measured["turn_share"] < 1.0
    assert not math.isnan(measured["mcnemar_p/4.375"])
    for name in ("table_5-1", "figure_5-11", "figure_5-12", "figure_5-13"):
        assert (folder / "figures" / f"{name}.png").is_file()
    assert (folder / "insertion.gif").stat().st_size > 10_000
