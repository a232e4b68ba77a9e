"""A twin beside a rover on emulated boards, and how that is scored."""

import json

import pytest

from experiments.harness.output import Output
from experiments.living.boards import OnBoards, watch_boards
from experiments.living.living_twin import MISSES, measure_boards
from experiments.living.living_twin_options import Options


@pytest.mark.parametrize(
    ("late", "alarms", "well"), [(MISSES, (), True), (0.02, ("battery",), False)]
)
def test_misses_and_alarms_are_held_against_their_bars(tmp_path, late, alarms, well):
    output = Output("living-twin", Options(out=tmp_path), [])
    measure_boards(OnBoards(60.0, 6000, late, alarms), output)
    output.finish()
    output.close()
    metrics = json.loads((tmp_path / "living-twin" / "metrics.json").read_text())
    measured = metrics["measured"]
    assert measured["deadline_miss_fraction"] == late
    assert measured["false_alarms_on_boards"] == len(alarms)
    assert [check["ok"] for check in metrics["checks"]] == [well, well]


@pytest.mark.slow
@pytest.mark.real_time
def test_a_twin_takes_all_ticks_of_a_rover_on_boards():
    found = watch_boards(1, 3.0, 1.0)
    assert found.ticks == 400  # noqa: PLR2004
    assert found.alarms == ()
    # A machine that stalls makes it late, not lose ticks.
    assert 0.0 <= found.late < 1.0
