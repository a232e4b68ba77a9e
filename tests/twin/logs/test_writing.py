"""Logs of our own runs, read back by us and by the format's own library."""

import json

import numpy as np
from mcap.reader import make_reader

from tests.twin import scene
from tests.twin.logs import formats
from twin.logs.log import Log
from twin.logs.mapping import read_log, read_mapping
from twin.logs.writing import SENSORS, LogWriter, write_mcap
from twin.loop import LoopRecorder, run
from twin.robot import Command, WheelMode
from twin.simulation import Simulation


class Weave:
    """Drives ahead, with a wave in its arm."""

    def reset(self):
        pass

    def step(self, observations):
        wave = 0.3 * np.sin(7.0 * observations["rover1"].time + np.arange(4.0))
        return {"rover1": Command(np.full(4, 2.0), wave, wheel_mode=WheelMode.SPEED)}


class Kept(LoopRecorder):
    def __init__(self):
        self.ticks = []

    def record(self, tick):
        self.ticks.append(tick)


def logged(path):
    """Run a rover for half a second; return its log and its ticks."""
    twin, kept = Simulation(scene.compile_scene(), ["rover1"], servo=scene.SERVO, seed=3), Kept()
    with LogWriter(path) as writer:
        run(twin.robots, [Weave()], twin, [writer, kept], duration=0.5)
    return read_log(path), kept.ticks


def test_a_log_holds_what_was_observed_and_applied_to_the_bit(tmp_path):
    log, ticks = logged(tmp_path / "run.mcap")
    names = {f"rover1/{name}" for name in SENSORS}
    assert set(log.signals) == names | {"rover1/wheels", "rover1/arm"}
    for name in SENSORS:
        samples = {}
        for tick in ticks:
            channel = getattr(tick.observations["rover1"], name)
            if channel.usable:
                samples.setdefault(channel.stamp, channel.value)
        signal = log.signals[f"rover1/{name}"]
        np.testing.assert_array_equal(signal.values, np.array(list(samples.values())), name)
        np.testing.assert_allclose(signal.stamps, list(samples), atol=1e-9)
        assert (signal.role, signal.unit, signal.frame) == ("sensor", *SENSORS[name])
    for name in ("wheels", "arm"):
        applied = np.array([getattr(tick.applied["rover1"], name) for tick in ticks])
        signal = log.signals[f"rover1/{name}"]
        np.testing.assert_array_equal(signal.values, applied)
        assert (signal.role, signal.unit) == ("actuator", "1")
    # The inclinometer is slower than the loop: each sample is logged once.
    assert len(log.signals["rover1/inclinometer"].stamps) < len(ticks) / 2


def test_its_file_is_what_the_library_reads(tmp_path):
    log, _ = logged(tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        topics = {channel.topic: channel for channel in summary.channels.values()}
        assert set(topics) == {f"/{name}" for name in log.signals}
        assert topics["/rover1/gyro"].metadata == {
            "role": "sensor", "name": "rover1/gyro", "unit": "rad/s", "frame": "front half",
        }  # fmt: skip
        (schema,) = summary.schemas.values()
        assert schema.encoding == "jsonschema"
        assert json.loads(schema.data)["type"] == "object"
        gyro = [json.loads(m.data) for _, _, m in reader.iter_messages(topics=["/rover1/gyro"])]
    np.testing.assert_array_equal(
        [each["value"] for each in gyro], log.signals["rover1/gyro"].values
    )


def test_a_foreign_log_becomes_one_of_ours(tmp_path):
    run = formats.Run(2)
    (tmp_path / "map.toml").write_text(formats.CSV_MAPPING)
    mapping = read_mapping(tmp_path / "map.toml")
    log = read_log(formats.write_csv(run, tmp_path / "run.csv"), mapping)
    log.signals["joints"].values[3, 1] = np.nan
    write_mcap(log, tmp_path / "ours.mcap")
    back = read_log(tmp_path / "ours.mcap")
    assert set(back.signals) == set(log.signals)
    for name, signal in log.signals.items():
        np.testing.assert_array_equal(back.signals[name].values, signal.values)
        np.testing.assert_allclose(back.signals[name].stamps, signal.stamps, atol=1e-9)
        assert back.signals[name].unit == signal.unit and back.signals[name].frame == signal.frame


def test_a_log_without_samples_is_one(tmp_path):
    write_mcap(Log({}), tmp_path / "none.mcap")
    with (tmp_path / "none.mcap").open("rb") as stream:
        assert list(make_reader(stream).iter_messages()) == []
