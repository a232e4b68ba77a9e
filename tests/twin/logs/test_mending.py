"""Logs whose writer was killed are completed, and lack less than a second."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from mcap.reader import make_reader

from twin.logs.fields import read_fields
from twin.logs.log import LogError
from twin.logs.mapping import read_log
from twin.logs.mending import is_complete, mend
from twin.logs.writing import LogWriter

TICKS = 400


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a complete log of four seconds, and how long it was after each tick."""
    path = tmp_path_factory.mktemp("logs") / "run.mcap"
    sizes = []
    with LogWriter(path) as writer:
        for tick in range(TICKS):
            writer.write("sensor", "rover1/gyro", 0.01 * tick, [tick, 0.5, 0.25], "rad/s", "")
            for name in ("wheels", "arm"):
                writer.write("actuator", f"rover1/{name}", 0.01 * tick, [tick] * 100, "1", "")
            writer.flush()
            sizes.append(path.stat().st_size)
    return path.read_bytes(), sizes


@pytest.mark.parametrize("cut", [40, 5_000, 30_000, 30_001, -9, -1])
def test_what_was_written_before_the_cut_is_kept(tmp_path, whole, cut):
    content, sizes = whole
    path = tmp_path / "run.mcap"
    path.write_bytes(content[:cut])
    with pytest.raises(LogError, match="ends early; log --mend"):
        read_fields(path)
    latest = mend(path)
    assert is_complete(path)
    with path.open("rb") as stream:
        messages = list(make_reader(stream).iter_messages())
    length = cut if cut > 0 else len(content) + cut
    there = sum(size <= length for size in sizes)
    # A chunk is lost if it was not written to its end.
    assert there - 100 <= len(messages) / 3 <= TICKS
    if messages:
        signal = read_log(path).signals["rover1/gyro"]
        np.testing.assert_array_equal(signal.values[:, 0], np.arange(len(signal.stamps)))
        assert latest == pytest.approx(signal.stamps[-1])
    assert np.isnan(mend(path))


def test_zeros_after_a_lost_chunk_are_cut_off(tmp_path, whole):
    """What a file system leaves after a loss of power."""
    content, _ = whole
    path = tmp_path / "run.mcap"
    path.write_bytes(content[:30_000] + bytes(20_000))
    mend(path)
    expected = tmp_path / "expected.mcap"
    expected.write_bytes(content[:30_000])
    mend(expected)
    signal, other = (read_log(each).signals["rover1/gyro"] for each in (path, expected))
    assert 0 < len(signal.stamps) == len(other.stamps)


def test_a_complete_log_stays_to_the_bit(tmp_path, whole):
    path = tmp_path / "run.mcap"
    path.write_bytes(whole[0])
    assert np.isnan(mend(path))
    assert path.read_bytes() == whole[0]


def test_what_is_no_log_is_left_alone(tmp_path):
    path = tmp_path / "notes.mcap"
    path.write_bytes(b"notes")
    with pytest.raises(LogError, match="no MCAP file"):
        mend(path)
    assert path.read_bytes() == b"notes"


WRITER = """
    import sys, time
    from pathlib import Path
    import numpy as np
    from twin.logs.writing import LogWriter
    from twin.loop import Tick
    from twin.robot import Channel, Observation, Validity, applied_command
    with LogWriter(Path(sys.argv[1])) as writer:
        for step in range(100_000):
            time.sleep(0.002)
            now = 0.01 * step
            rows = np.random.default_rng(step).normal(size=9)
            seen = Observation(now, arm_angles=Channel(rows[:4], now, Validity.MEASURED),
                gyro=Channel(rows[:3], now, Validity.MEASURED),
                arm_base_wrench=Channel(rows[:6], now, Validity.MEASURED))
            applied = applied_command(rows[:4], rows[4:8])
            writer.record(Tick(step, now, {"rover1": seen}, {"rover1": applied}))
            print(now, flush=True)
"""


def test_a_killed_writer_loses_less_than_a_second(tmp_path):
    path = tmp_path / "run.mcap"
    command = [sys.executable, "-c", textwrap.dedent(WRITER), str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        lines = iter(process.stdout.readline, "")
        for line in lines:
            if float(line) > 3.0:
                break
        process.kill()
        last = float([line, *lines][-1])
    latest = mend(path)
    assert 0.0 <= last - latest < 1.0
    assert read_log(path).signals["rover1/gyro"].stamps[-1] == pytest.approx(latest, abs=0.011)
