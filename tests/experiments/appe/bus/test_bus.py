"""The bus' trials and the experiment end to end."""

import dataclasses

import numpy as np
import pytest

from experiments.appe.bus import bus as appe_bus
from experiments.appe.bus.trial import FATES, PROTOCOLS, BusTrialConfig, run_trial
from experiments.harness.output import Output


def test_every_word_has_one_fate_and_the_seed_fixes_it():
    config = BusTrialConfig("thesis", 40, seed=1, missed=0.01)
    first, second = run_trial(config), run_trial(config)
    assert sum(first.fates[fate] for fate in FATES) == 40
    assert 0 < first.fates["right"] < 40
    np.testing.assert_array_equal(first.wrong_bits, second.wrong_bits)
    assert np.count_nonzero(first.wrong_bits) == 40 - first.fates["right"]


def test_clean_words_all_arrive_over_the_rc_buffer_too_but_later():
    flag = run_trial(BusTrialConfig("thesis", 30, seed=2, lasting=True))
    rc = run_trial(BusTrialConfig("thesis", 30, seed=2, buffer="rc", lasting=True))
    assert flag.fates["right"] == rc.fates["right"] == 30
    assert np.median(rc.seconds) > 2.0 * np.median(flag.seconds)


@pytest.mark.parametrize("kind", ["missed", "extra", "missed_flag"])
def test_one_fault_a_word_always_strikes_the_thesis_protocol_and_never_parity(kind):
    thesis = run_trial(BusTrialConfig("thesis", 30, seed=3, fault=kind))
    parity = run_trial(BusTrialConfig("parity", 30, seed=3, fault=kind))
    assert thesis.fates["right"] == 0 and thesis.fates["told"] == 0
    assert parity.fates["right"] == 30 and parity.resent >= 30


def test_unknown_fault_is_refused():
    with pytest.raises(ValueError, match="fault 'lost': expected one of missed"):
        run_trial(BusTrialConfig("thesis", 1, seed=0, fault="lost"))


@pytest.mark.slow
def test_experiment_measures_what_it_promises(tmp_path, monkeypatch):
    few = dataclasses.replace(
        appe_bus.QUICK, clean=dict.fromkeys(appe_bus.FULL.clean, 20), fault=20, rate=6, lasting=10
    )
    monkeypatch.setattr(appe_bus, "QUICK", few)
    monkeypatch.setattr(appe_bus, "STAGES", (2, 3))
    monkeypatch.setattr(appe_bus, "sweep", lambda job, configs, *_, **__: list(map(job, configs)))
    options = appe_bus.Options(quick=True, out=tmp_path)
    output = Output("appe-bus", options)
    appe_bus.run(options, output)
    output.finish()
    measured, checks = output.metrics()["measured"], output.metrics()["checks"]
    assert measured["word_errors/thesis/flag"]["n"] == 20
    for name in PROTOCOLS:
        assert f"fate/missed/{name}/right" in measured
        assert f"change_ms/{name}/3" in measured
    assert all(check["ok"] for check in checks)
    folder = tmp_path / "appe-bus"
    figures = {path.name for path in (folder / "figures").iterdir()}
    assert {"figure_e-8_waveform.png", "bus_word_errors.png", "bus_change_time.png"} <= figures
    assert (folder / "tables" / "bus_one_fault.csv").exists()
