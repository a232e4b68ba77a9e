"""Logs of our own runs, read back by us and by the format's own library."""

import json

import numpy as np
from mcap.reader import make_reader

from tests.twin import scene
from twin.logs.mapping import read_log
from twin.logs.writing import SENSORS, LogWriter
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


def test_what_is_no_number_and_before_zero_is_kept(tmp_path):
    with LogWriter(tmp_path / "run.mcap") as writer:
        writer.write("sensor", "tilt", -0.02, [0.5, np.nan], "rad", "base")
        writer.write("sensor", "tilt", 0.02, [np.inf, 0.25], "rad", "base")
    (tilt,) = read_log(tmp_path / "run.mcap").signals.values()
    np.testing.assert_array_equal(tilt.values, [[0.5, np.nan], [np.nan, 0.25]])
    np.testing.assert_allclose(tilt.stamps, [-0.02, 0.02])


def test_a_log_without_samples_is_one(tmp_path):
    with LogWriter(tmp_path / "none.mcap"):
        pass
    with (tmp_path / "none.mcap").open("rb") as stream:
        assert list(make_reader(stream).iter_messages()) == []
