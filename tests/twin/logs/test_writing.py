"""Logs of our own runs, read back by us and by the format's own library."""

import json

import numpy as np
import pyarrow.parquet
import pytest
from mcap.reader import make_reader

from tests.twin import scene
from tests.twin.logs import formats
from twin.logs.fields import read_fields
from twin.logs.lerobot import write_lerobot
from twin.logs.log import Log, LogError, Signal
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


def test_any_log_becomes_one_of_ours_to_the_bit(tmp_path):
    run = formats.Run(1)
    run.gyro[3, 1] = np.nan
    (tmp_path / "map.toml").write_text(formats.CSV_MAPPING)
    mapping = read_mapping(tmp_path / "map.toml")
    log = read_log(formats.write_csv(run, tmp_path / "run.csv"), mapping)
    write_mcap(log, tmp_path / "run.mcap")
    again = read_log(tmp_path / "run.mcap")
    assert list(again.signals) == list(log.signals)
    for name, signal in log.signals.items():
        other = again.signals[name]
        np.testing.assert_array_equal(other.values, signal.values)
        np.testing.assert_allclose(other.stamps, signal.stamps, atol=1e-9)
        assert (other.role, other.unit, other.frame) == (signal.role, signal.unit, signal.frame)


def test_lerobot_dataset_holds_a_log_in_single_precision(tmp_path):
    log, _ = logged(tmp_path / "run.mcap")
    write_lerobot(log, tmp_path / "dataset", 50)
    table = pyarrow.parquet.read_table(tmp_path / "dataset" / "data")
    info = json.loads((tmp_path / "dataset" / "meta" / "info.json").read_text())
    names = info["features"]["observation.state"]["names"]
    assert info["total_frames"] == table.num_rows and info["fps"] == 50
    state = np.array(table["observation.state"].to_pylist())
    times = np.arange(table.num_rows) / 50.0
    np.testing.assert_array_equal(table["timestamp"].to_numpy(), times.astype(np.float32))
    first = max(each.stamps[0] for each in log.signals.values())
    angles = log.signals["rover1/arm_angles"]
    expected = np.interp(first + times, angles.stamps, angles.values[:, 2])
    column = state[:, names.index("rover1/arm_angles.2")]
    np.testing.assert_array_equal(column, expected.astype(np.float32))
    assert info["features"]["action"]["names"][:2] == ["rover1/wheels.0", "rover1/wheels.1"]
    episodes = pyarrow.parquet.read_table(tmp_path / "dataset" / "meta" / "episodes").to_pylist()
    assert [each["length"] for each in episodes] == [table.num_rows]
    stats = json.loads((tmp_path / "dataset" / "meta" / "stats.json").read_text())
    np.testing.assert_allclose(stats["observation.state"]["mean"], state.mean(axis=0), rtol=1e-5)


def test_command_of_a_frame_is_the_last_one_before_it(tmp_path):
    stamps = np.array([0.0, 0.1, 0.25])
    log = Log(
        {
            "motor": Signal("actuator", stamps, np.array([[1.0], [2.0], [3.0]])),
            "angle": Signal("sensor", np.array([0.0, 0.3]), np.array([[0.0], [3.0]])),
        }
    )
    write_lerobot(log, tmp_path / "dataset", 20)
    fields = read_fields(tmp_path / "dataset")
    np.testing.assert_array_equal(fields["action"].values, [1.0, 1.0, 2.0, 2.0, 2.0, 3.0])
    np.testing.assert_allclose(
        fields["observation.state"].values, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5], atol=1e-6
    )
    with pytest.raises(LogError, match="too little for 1 Hz"):
        write_lerobot(log, tmp_path / "slow", 1)
    with pytest.raises(LogError, match="no sensor"):
        write_lerobot(Log({"motor": log.signals["motor"]}), tmp_path / "blind", 20)
