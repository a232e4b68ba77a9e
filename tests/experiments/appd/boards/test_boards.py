"""Faults of emulated boards, a damaged line, and the experiment around them."""

import dataclasses
import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments.appd.boards import boards as appd_boards
from experiments.appd.boards import trial as appd_boards_trial
from experiments.appd.boards.figures import dead_band, draw_calls, draw_pace, draw_stops
from experiments.appd.boards.line import DamagedCalls, call_damaged
from experiments.appd.boards.live import IdentityTrial, LoopPace, compare_boards
from experiments.appd.boards.trial import (
    KINDS,
    STOPPING,
    WRAP,
    Batch,
    BoardBench,
    deal,
    run_batch,
)
from experiments.harness.catalogue import EXPERIMENTS
from experiments.harness.output import Output
from twin.hardware.board_robot import BoardRobot
from twin.hardware.board_set import WiredBoards
from twin.hardware.emulator.amplifier import AmplifierConfig
from twin.hardware.emulator.faults import RobotFault
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.client import RoboClawBus

pytestmark = pytest.mark.real_time

SEED = 11


def test_every_fault_of_a_robot_and_its_host_is_tried_equally_often():
    assert {kind.value for kind in RobotFault} < set(KINDS)
    assert len(KINDS) == len(set(KINDS)) == 12 and set(STOPPING) == set(KINDS) - {WRAP}
    batches = deal(200, list(range(8)))
    dealt = [kind for batch in batches for kind in batch.kinds]
    counts = {kind: dealt.count(kind) for kind in KINDS}
    assert sum(counts.values()) == 200 and set(counts.values()) == {16, 17}
    assert len(deal(3, list(range(8)))) == 3


@pytest.mark.slow
def test_robot_that_ignores_an_e_stop_is_found_out(monkeypatch):
    monkeypatch.setattr(BoardRobot, "_check_in_turn", lambda self: None)
    (result,) = run_batch(Batch(("e_stop",), SEED))
    assert result.stop_time == float("inf")


def test_speeds_that_do_not_wrap_are_found_out(monkeypatch):
    """A wrap counts 50 too many."""
    honest = codec.signed_difference
    monkeypatch.setattr(
        "twin.hardware.board_samples.codec.signed_difference",
        lambda later, earlier: honest(later, earlier) + 50 * (later * earlier < 0),
    )
    (result,) = run_batch(Batch((WRAP,), SEED))
    assert result.wrong > 0


def test_same_seed_gives_the_same_faults():
    class Still(BoardBench):
        def __init__(self):
            pass

    def drawn():
        rng = np.random.default_rng(SEED)
        trials = [appd_boards_trial._FaultInjection(Still(), kind, rng) for kind in KINDS]
        return [(t._address, t._lead, t._duration, t._gives_up) for t in trials]

    assert drawn() == drawn()
    assert len({address for address, _, _, _ in drawn()}) > 1


def test_damaged_line_gives_no_wrong_value_and_its_failures_are_counted():
    result = call_damaged(0.3, 200, SEED)
    assert result.wrong == 0 and result.damaged > 40 and result.retries > 20
    assert result.call_ms.shape == (200,)


def test_wrong_values_of_a_client_without_checksums_are_counted(monkeypatch):
    """Without checksums, damaged encoders come through."""
    monkeypatch.setattr(
        "twin.hardware.roboclaw.client.codec.decode_reply",
        lambda address, command, reply: (
            struct.unpack(">ii", reply[:8]) if len(reply) == 10 else tuple(reply) or None
        ),
    )
    monkeypatch.setattr(RoboClawBus, "_stands_alone", lambda self: True)
    assert call_damaged(0.5, 100, SEED).wrong > 0


@pytest.mark.chosen_seed  # The same as in the process of the boards, where nothing shifts it.
@pytest.mark.slow
def test_cycles_are_alike_on_a_damaged_line_until_a_sample_is_lost(monkeypatch):
    config = IdentityTrial(0.1, SEED, (0.3, 0.2, 0.1))
    result = compare_boards(config)
    assert result.identical == result.cycles == 60 and result.damaged > 20
    calls = iter(range(10_000))
    honest = WiredBoards.wrench
    monkeypatch.setattr(
        WiredBoards, "wrench", lambda boards: None if next(calls) == 40 else honest(boards)
    )
    lost = compare_boards(config)
    assert lost.cycles == 60 and 30 < lost.identical <= 40


def test_dead_band_is_the_microsecond_that_the_bridge_misses():
    card = AmplifierConfig()
    # 1 us of the clock's 50 us, at a duty of 97 % for 5 V; then the next of 4096 steps.
    least = 1e-6 / (np.log(2) * (68e3 + 2 * 2.2e3) * 1e-9) / (70.2 / 72.4) * 5.0
    assert least <= dead_band(card) < least + 5.0 / 4096


def test_figures_show_what_they_are_given(tmp_path):
    output = Output("boards", appd_boards.Options(out=tmp_path))
    stops = draw_stops({"e_stop": [0.01, 0.02], "bus_silent": [float("inf")]}, 0.21)
    drawn = stops.axes[0].get_lines()
    np.testing.assert_allclose(drawn[0].get_xdata(), [10.0, 20.0])
    assert drawn[2].get_xdata()[0] > 210.0
    calls = draw_calls([DamagedCalls(0.1, np.array([1.0, 50.0, 2.0]), 0, 0, 0, 0)], 60.0)
    np.testing.assert_allclose(calls.axes[0].get_lines()[0].get_xdata(), [1.0, 2.0, 50.0])
    pace = LoopPace(4, 1, np.array([0.01, 0.02, 9.0]), np.full(4, 0.003), "", 0)
    figure = draw_pace(pace, 0.01)
    heights = [bar.get_height() for bar in figure.axes[0].patches]
    assert sum(heights) == 3 and heights[-1] == 1
    for name, each in (("stops", stops), ("calls", calls), ("pace", figure)):
        output.figure(name, each)


def test_robot_that_stopped_has_missed_what_it_did_not_do(tmp_path):
    output = Output("boards", appd_boards.Options(out=tmp_path))
    pace = LoopPace(300, 5, np.full(299, 0.01), np.full(300, 0.003), "stopped", 0)
    appd_boards._measure_pace(pace, 5.0, output)
    metrics = output.metrics()
    assert metrics["measured"]["miss_fraction"] == pytest.approx(205 / 500)
    assert not metrics["checks"][0]["ok"]


def test_robot_that_stopped_before_its_first_period_has_missed_all(tmp_path):
    output = Output("boards", appd_boards.Options(out=tmp_path))
    pace = LoopPace(1, 0, np.empty(0), np.full(1, 0.003), "stopped", 0)
    appd_boards._measure_pace(pace, 5.0, output)
    measured = output.metrics()["measured"]
    assert measured["miss_fraction"] == pytest.approx(499 / 500)
    assert measured["stopped_after_s"] == pytest.approx(0.01) and "period_ms" not in measured


def test_experiment_is_in_the_catalogue_and_breaks_no_real_boards():
    assert EXPERIMENTS["appd-boards"].module == "experiments.appd.boards.boards"
    assert "robot" not in {field.name for field in dataclasses.fields(appd_boards.Options)}


@pytest.mark.slow
def test_quick_run_stops_the_motors_after_each_fault_and_writes_everything(tmp_path):
    command = [
        sys.executable,
        "-m",
        "experiments",
        "appd-boards",
        "--quick",
        "--out",
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "appd-boards"
    metrics = json.loads((folder / "metrics.json").read_text())
    measured = metrics["measured"]
    assert measured["stopped_fraction"]["median"] == 1.0 and measured["stopped_fraction"]["n"] == 11
    for kind in STOPPING:
        assert 0.0 < measured[f"stop_time/{kind}"]["median"]
        assert measured[f"stop_time_worst/{kind}"] <= 0.21 + 1e-9
    assert measured["went_on_fraction/counter_wrap"]["median"] == 1.0
    assert measured["wrong_values"] == 0
    assert measured["identical_cycles/clean"] >= 100 <= measured["identical_cycles/faulted"]
    # The speed of a busy machine is not tested here, but that it is reported.
    assert {"worst_call_ms", "miss_fraction"} < set(measured)
    assert {"adapter_ms", "stopped_after_s"} & set(measured)
    fast = [
        check
        for check in metrics["checks"]
        if "in ms" in check["name"] or "100 Hz" in check["name"]
    ]
    assert len(fast) == 2
    assert all(check["ok"] for check in metrics["checks"] if check not in fast)
    named = " ".join(check["name"] for check in metrics["checks"])
    assert "motors driven when a fault began" in named and "through a counter's wrap" in named
    drawn = {"fault_stops", "calls", "figure_d-3"} | (
        {"pace"} if "adapter_ms" in measured else set()
    )
    for name in drawn:
        assert (folder / "figures" / f"{name}.png").is_file()
    faults = Path(folder / "tables" / "faults.csv").read_text().splitlines()
    assert len(faults) == 1 + len(KINDS)
    assert (folder / "tables" / "calls.csv").read_text().count("\n") == 1 + len(appd_boards.RATES)
