"""A log read back as the ticks of which it was written, complete or while it is written."""

import numpy as np
import pytest

from models.compose import RobotPlacement
from tests.twin.logs.test_writing import Weave, logged
from twin.connect import connect
from twin.logs.log import LogError
from twin.logs.mapping import read_log
from twin.logs.ticks import TickStream
from twin.logs.writing import SENSORS, LogWriter, write_mcap
from twin.loop import run

CUT = 12_000
"""Bytes of a log that are there at first."""


def assert_like(found, ticks):
    assert len(found) == len(ticks)
    for (robot, seen, applied), tick in zip(found, ticks, strict=True):
        assert robot == "rover1"
        true = tick.observations["rover1"]
        assert seen.time == pytest.approx(true.time, abs=1e-9)
        for name in SENSORS:
            channel, expected = getattr(seen, name), getattr(true, name)
            assert channel.usable == expected.usable
            if expected.usable:
                assert channel.stamp == pytest.approx(expected.stamp, abs=1e-9)
                np.testing.assert_array_equal(channel.value, expected.value, name)
        np.testing.assert_array_equal(applied.wheels, tick.applied["rover1"].wheels)
        np.testing.assert_array_equal(applied.arm, tick.applied["rover1"].arm)


def test_ticks_are_what_the_controller_saw_and_what_was_applied(tmp_path):
    _, ticks = logged(tmp_path / "run.mcap")
    assert_like(list(TickStream(tmp_path / "run.mcap")), ticks)


def test_a_log_that_was_written_anew_gives_the_same_ticks(tmp_path):
    log, ticks = logged(tmp_path / "run.mcap")
    write_mcap(log, tmp_path / "again.mcap")
    assert_like(list(TickStream(tmp_path / "again.mcap")), ticks)


def test_a_log_is_read_as_it_grows(tmp_path):
    path = tmp_path / "run.mcap"
    _, ticks = logged(path)
    content = path.read_bytes()
    path.write_bytes(content[:CUT])
    lengths = iter(range(CUT + 100, len(content) + 1_100, 1_000))

    def more():
        path.write_bytes(content[: next(lengths)])
        return True

    assert_like(list(TickStream(path, more)), ticks)


def test_a_log_that_is_not_complete_is_named_and_what_is_there_is_read(tmp_path):
    path = tmp_path / "run.mcap"
    _, ticks = logged(path)
    path.write_bytes(path.read_bytes()[:CUT])
    found = []
    with pytest.raises(LogError, match=r"run.mcap: damaged: it ends early; log --mend"):
        found.extend(TickStream(path))
    assert 5 < len(found) < len(ticks)
    assert_like(found, ticks[: len(found)])


def test_it_says_how_its_rovers_were_connected(tmp_path):
    path = tmp_path / "run.mcap"
    robot = RobotPlacement("rover1", card=True)
    with connect("sim", robots=[robot], seed=4) as connection:
        with LogWriter(path, connection.settings) as writer:
            run(connection.robots, [Weave()], connection.clock, [writer], 0.1)
        stream = TickStream(path)
        assert stream.settings is None
        next(iter(stream))
        assert stream.settings == connection.settings


def test_a_log_without_rovers_has_no_ticks(tmp_path):
    log, _ = logged(tmp_path / "run.mcap")
    del log.signals["rover1/arm"]
    write_mcap(log, tmp_path / "none.mcap")
    assert list(TickStream(tmp_path / "none.mcap")) == []
    assert set(read_log(tmp_path / "none.mcap").signals) == set(log.signals)


@pytest.mark.parametrize("content", [b"", b"notes", b"\x89MCAP0\r\n" + bytes(100)])
def test_what_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match="ends early"):
        list(TickStream(path))
    with pytest.raises(LogError, match="No such file"):
        list(TickStream(tmp_path / "none.mcap"))
