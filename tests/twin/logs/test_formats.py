"""The same run in each format, written by the format's own library, is the same log."""

import numpy as np
import pytest

from tests.twin.logs import formats
from twin.logs import tables
from twin.logs.fields import read_fields
from twin.logs.mapping import read_log, read_mapping

EXACT = 1e-12
WRITERS = {
    "csv": (formats.write_csv, "run.csv", formats.CSV_MAPPING, EXACT),
    "json mcap": (formats.write_json_mcap, "run.mcap", formats.ROS_MAPPING, EXACT),
    "sqlite bag": (formats.write_bag, "bag", formats.ROS_MAPPING, EXACT),
    "mcap bag": (
        lambda run, path: formats.write_bag(run, path, "mcap"), "bag", formats.ROS_MAPPING, EXACT,
    ),
    "ros mcap": (
        lambda run, path: next(formats.write_bag(run, path, "mcap").glob("*.mcap")),
        "bag", formats.ROS_MAPPING, EXACT,
    ),
    "lerobot": (formats.write_lerobot, "dataset", formats.LEROBOT_MAPPING, 1e-6),
    "recording": (formats.write_recording, "run.rrd", formats.RECORDING_MAPPING, EXACT),
}  # fmt: skip


def log_of(tmp_path, kind, run):
    write, name, mapping, _ = WRITERS[kind]
    (tmp_path / "map.toml").write_text(mapping)
    return read_log(write(run, tmp_path / name), read_mapping(tmp_path / "map.toml"))


@pytest.mark.parametrize("kind", WRITERS)
def test_the_same_run_is_the_same_log(tmp_path, kind):
    run, tolerance = formats.Run(1), WRITERS[kind][3]
    log = log_of(tmp_path, kind, run)
    expected = {"joints": run.angles, "gyro": run.gyro, "motors": run.torques}
    assert set(log.signals) == set(expected)
    for name, values in expected.items():
        signal = log.signals[name]
        np.testing.assert_allclose(signal.values, values, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(signal.stamps, run.times, atol=max(tolerance, 1e-9))
    assert [log.signals[name].role for name in expected] == ["sensor", "sensor", "actuator"]
    assert [log.signals[name].unit for name in expected] == ["rad", "rad/s", "N m"]
    assert log.signals["gyro"].frame == "base"


def test_a_header_stamps_a_message_that_was_logged_late(tmp_path):
    run = formats.Run(1)
    path = formats.write_bag(run, tmp_path / "bag", late=3_000_000)
    (tmp_path / "map.toml").write_text(formats.ROS_MAPPING)
    log = read_log(path, read_mapping(tmp_path / "map.toml"))
    for signal in log.signals.values():
        np.testing.assert_allclose(signal.stamps, run.times, atol=1e-9)


def test_stamps_of_a_robots_own_clock_stay_as_they_are(tmp_path):
    run = formats.Run(1, begin=3.25)
    log = log_of(tmp_path, "json mcap", run)
    np.testing.assert_allclose(log.signals["joints"].stamps[0], 3.25, atol=1e-9)


def test_a_delay_moves_stamps_back(tmp_path):
    run = formats.Run(1)
    path = formats.write_csv(run, tmp_path / "run.csv")
    text = formats.CSV_MAPPING + 'delay = "4 ms"\n'
    (tmp_path / "map.toml").write_text(text)
    log = read_log(path, read_mapping(tmp_path / "map.toml"))
    np.testing.assert_allclose(log.signals["motors"].stamps, run.times - 0.004, atol=1e-12)
    np.testing.assert_allclose(log.signals["gyro"].stamps, run.times, atol=1e-12)


def test_types_of_a_table_may_show_late(tmp_path, monkeypatch):
    """Whole numbers, and a column without any, until the file has been read halfway."""
    monkeypatch.setattr(tables, "BLOCK", 300)
    rows = [f"{n},{n if n < 50 else n + 0.5},{'' if n < 50 else n}" for n in range(100)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["t,a,b", *rows]) + "\n")
    fields = read_fields(path)
    assert fields["a"].values[[0, -1]].tolist() == [0.0, 99.5]
    assert fields["b"].stamps[0] == 50.0 and len(fields["b"].values) == 50
