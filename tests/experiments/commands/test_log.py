"""The command ``log``: what a log holds, what is wrong in it, and errors in one line."""

import numpy as np
import pytest

from experiments.__main__ import main
from tests.twin.logs import formats
from twin.logs.log import Log, Signal
from twin.logs.writing import write_mcap


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")


def test_a_foreign_log_shows_its_fields(tmp_path, capsys):
    path = formats.write_bag(formats.Run(1), tmp_path / "bag")
    assert main(["log", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "/joint_states.position[elbow]" in printed
    assert "/imu.angular_velocity.x" in printed
    assert "50" in printed and "100 Hz" in printed
    assert "--mapping FILE" in printed


def test_a_sound_log_shows_its_signals(tmp_path, capsys):
    path = formats.write_csv(formats.Run(1), tmp_path / "run.csv")
    (tmp_path / "map.toml").write_text(formats.CSV_MAPPING)
    assert main(["log", str(path), "--mapping", str(tmp_path / "map.toml")]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    (gyro,) = (row for row in rows if "gyro" in row)
    assert [each for each in gyro if each != "│"][:7] == [
        "sensor", "gyro", "3", "rad/s", "base", "50", "100",
    ]  # fmt: skip


def test_what_is_wrong_is_named_and_told_by_the_exit_status(tmp_path, capsys):
    run = formats.Run(1)
    run.gyro[4, 0] = float("nan")
    path = formats.write_csv(run, tmp_path / "run.csv")
    (tmp_path / "map.toml").write_text(formats.CSV_MAPPING)
    assert main(["log", str(path), "--mapping", str(tmp_path / "map.toml")]) == 1
    assert "wrong gyro: 1 of 50 samples are no numbers, first at 0.04 s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.csv", "No such file"),
        ("notes.txt", "not a log; expected .csv, .mcap or .rrd"),
        ("folder", "not a log"),
        ("half.mcap", "damaged: it ends early; log --mend keeps what was written before"),
        ("words.csv", "no column time or t or stamp or timestamp for the stamps; there are a, b"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path, capsys, name, said):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "folder").mkdir()
    (tmp_path / "half.mcap").write_bytes(b"\x89MCAP0\r\n\x01")
    (tmp_path / "words.csv").write_text("a,b\n1,2\n")
    assert main(["log", str(tmp_path / name)]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {tmp_path / name}: ") and said in error
    assert error.count("\n") == 1


def test_signals_are_written_for_other_tools(tmp_path, capsys):
    path = formats.write_csv(formats.Run(1), tmp_path / "run.csv")
    (tmp_path / "map.toml").write_text(formats.CSV_MAPPING)
    words = ["log", str(path), "--mapping", f"{tmp_path}/map.toml", "--write"]
    assert main([*words, f"{tmp_path}/again.mcap"]) == 0
    assert main([*words, f"{tmp_path}/dataset", "--rate", "100"]) == 0
    assert (tmp_path / "dataset" / "meta" / "info.json").exists()
    assert "wrote" in capsys.readouterr().out
    assert main(["log", f"{tmp_path}/again.mcap"]) == 0
    assert "gyro" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--write", "PATH/run.csv", "--rate", "10"], "there already"),
        (["--write", "PATH/none/a.mcap"], "there is no folder"),
        (["--write", "PATH/a.mcap", "--rate", "10"], "--rate: needed to write a LeRobot"),
        (["--write", "PATH/a"], "--rate: needed to write a LeRobot"),
        (["--write", "PATH/a", "--rate", "0"], "--rate: expected 1 Hz or more"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, words, message, capsys):
    path = formats.write_csv(formats.Run(1), tmp_path / "run.csv")
    words = [word.replace("PATH", str(tmp_path)) for word in words]
    assert main(["log", str(path), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_log_whose_writer_was_killed_is_mended(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    write_mcap(Log({"gyro": Signal("sensor", np.arange(3.0), np.eye(3), "rad/s")}), path)
    path.write_bytes(path.read_bytes()[:-20])
    assert main(["log", str(path), "--mend"]) == 0
    assert "mended, up to 2.00 s" in capsys.readouterr().out
    assert main(["log", str(path), "--mend"]) == 0
    assert "complete, nothing to mend" in capsys.readouterr().out
    assert main(["log", str(tmp_path / "run.csv"), "--mend"]) != 0
    assert "--mend: of a file .mcap only" in capsys.readouterr().err
