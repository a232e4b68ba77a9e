"""The radio's trials, the talk of two rovers, and the experiment end to end."""

import dataclasses

import numpy as np
import pytest

from experiments.appd.radio import radio as appd_radio
from experiments.appd.radio.demo import ROBOTS, converse
from experiments.appd.radio.trial import FATES, LINKS, TrialConfig, run_trial
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from twin.hardware.emulator.modem import ModemConfig


@pytest.mark.parametrize("link", LINKS)
def test_trial_without_errors_delivers_all_at_the_rate_of_the_protocol(link):
    result = run_trial(TrialConfig(link, 0.0, 0.005, 50, seed=1))
    # 63 bytes one after another and 40 delays; or 28 bytes a frame, back to back.
    each = 61 / 960 + 40 * 0.005 if link == "handshake" else 28 / 960
    assert result.intact == 50 and result.stalls == 0
    assert result.goodput == pytest.approx(20 / each, rel=0.03)


@pytest.mark.parametrize("link", LINKS)
def test_every_message_has_one_fate_and_only_the_handshake_lies(link):
    result = run_trial(TrialConfig(link, 0.03, 0.005, 200, seed=2))
    assert sum(getattr(result, fate) for fate in FATES) == result.sent == 200
    lies = result.wrong + result.vanished + result.duplicates + result.disordered
    assert (lies > 10) == (link == "handshake")
    assert (lies == 0) == (link == "framed")
    assert len(result.arrival) == len(result.latency) == result.intact
    assert np.all(result.latency > 0.0)


def test_trial_is_fixed_by_its_seed():
    config = TrialConfig("framed", 0.03, 0.005, 50, seed=3)
    first, second, other = map(run_trial, (config, config, dataclasses.replace(config, seed=4)))
    np.testing.assert_array_equal(first.arrival, second.arrival)
    assert first.duration != other.duration


def test_hosts_that_poll_slow_the_handshake_but_not_the_frames():
    for link, low, high in (("handshake", 0.4, 0.8), ("framed", 0.97, 1.01)):
        fast = run_trial(TrialConfig(link, 0.0, 0.005, 60, seed=1))
        slow = run_trial(TrialConfig(link, 0.0, 0.005, 60, seed=1, poll=0.01))
        assert low < slow.goodput / fast.goodput < high


def test_rovers_receive_each_others_messages_over_a_clean_radio():
    result = converse(ModemConfig(), 1.5, seed=1)
    for name, other in zip(ROBOTS, reversed(ROBOTS)):
        sent, heard = result.rovers[name].sent, result.rovers[other].received
        assert len(sent) == 6 and len(heard) == 6
        np.testing.assert_allclose(heard[:, 1:], sent, atol=1e-3)
        ages = result.rovers[other].age
        assert np.nanmax(ages) < 0.35
        assert np.nanmin(ages) >= 28 / 960 + 0.005  # not before the radio has carried it
        assert result.rovers[name].missed == 0
        truth = result.truth[-1, 1:3] if name == ROBOTS[0] else result.truth[-1, 3:]
        assert np.linalg.norm(truth - sent[-1, 1:]) < 0.1
        used = result.rovers[name].bytes_sent[-1] / (960 * 1.5)
        assert used == pytest.approx(0.225, abs=0.01)


@pytest.mark.slow
def test_experiment_measures_what_it_promises(tmp_path, monkeypatch):
    monkeypatch.setattr(appd_radio, "DELAYS", (0.005,))
    monkeypatch.setattr(appd_radio, "RATES", (0.0, 1e-2))
    monkeypatch.setattr(appd_radio, "COUNTS", (20, 20))
    monkeypatch.setattr(appd_radio, "TALK", (1.0, 1.0))
    monkeypatch.setattr(appd_radio, "sweep", lambda job, configs, *_, **__: list(map(job, configs)))
    options = appd_radio.Options(quick=True, seeds=2, out=tmp_path)
    output = Output("appd-radio", options)
    appd_radio.run(options, output)
    output.finish()
    measured, checks = output.metrics()["measured"], output.metrics()["checks"]
    for link in LINKS:
        assert measured[f"silent_errors/{link}"]["n"] == 40
        assert measured[f"goodput/{link}"]["median"] > 0.0
        for rate in ("0", "0.01"):
            assert f"delivered_fraction/{link}/{rate}" in measured
            assert f"latency_ms/{link}/{rate}" in measured
    assert measured["silent_errors/framed"]["median"] == 0.0
    assert any("of 40 at a byte error rate of 0.01" in check["name"] for check in checks)
    figures = {path.name for path in (tmp_path / "appd-radio" / "figures").iterdir()}
    names = ("fates", "goodput", "stalls", "latency", "talk")
    assert figures == {f"radio_{name}.png" for name in names}
    assert (tmp_path / "appd-radio" / "tables" / "radio_fates.csv").exists()


def test_bad_options_are_refused():
    with pytest.raises(OptionError, match="--delay: expected 0 to 0.05 s, got 1.0"):
        appd_radio.Options(delay=1.0)
