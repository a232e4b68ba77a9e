"""``play``, and the whole loop by commands: design, play on boards, log, identify, replay."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.own.hidden.rover_loop import ARM, write_files
from experiments.own.motion_file import read_motion, write_motion
from models.datasheets import ARM_MOTOR, POWER_STAGE
from twin.hardware.emulator.amplifier import motor_resistance
from twin.logs.mapping import read_log

HOME = np.array([0.0, 0.9, -1.4, 0.1])


def waves(duration, sizes, rates):
    stamps = np.arange(0.0, duration, 0.01)
    way = np.clip(np.minimum(stamps, duration - stamps), 0.0, 1.0)[:, None]
    return stamps, HOME + way * sizes * np.sin(2.0 * np.pi * np.outer(stamps, rates))


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_a_motion_is_read_as_it_was_written(tmp_path, suffix):
    stamps, angles = waves(1.0, np.full(4, 0.2), np.ones(4))
    write_motion(tmp_path / f"motion{suffix}", ARM, stamps, angles)
    found = read_motion(tmp_path / f"motion{suffix}")
    assert tuple(found) == ARM
    np.testing.assert_array_equal(found[ARM[2]].values, angles[:, 2])
    np.testing.assert_allclose(found[ARM[2]].stamps, stamps, atol=1e-9)


def test_a_rover_plays_a_motion_and_logs_it(tmp_path, capsys):
    stamps, angles = waves(2.0, np.full(4, 0.2), np.ones(4))
    names = [each.rpartition("/")[2] for each in ARM]
    write_motion(tmp_path / "motion.csv", names, stamps, angles)
    files = ["--motion", f"{tmp_path}/motion.csv", "--log", f"{tmp_path}/run.mcap"]
    assert main(["play", *files]) == 0
    log = read_log(tmp_path / "run.mcap")
    moved = np.ptp(log.signals["rover1/arm_angles"].values, axis=0)
    assert np.all(moved > 0.1) and np.ptp(log.signals["rover1/wheels"].values) == 0.0
    assert main(["play", *files]) == 2
    assert "is there already; name another file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("knee", 0.0, "no positions of elbow; there are base_yaw, shoulder, knee, wrist"),
        ("elbow", 3.0, "elbow goes from 3 to 3 rad; its limits are -2.6 and 2.6"),
    ],
)
def test_a_motion_for_another_arm_is_refused_in_one_line(tmp_path, capsys, column, value, said):
    stamps = np.arange(0.0, 1.0, 0.1)
    names = ["base_yaw", "shoulder", column, "wrist"]
    rows = np.tile([0.0, 0.9, value, 0.1], (len(stamps), 1))
    write_motion(tmp_path / "motion.csv", names, stamps, rows)
    words = ["--motion", f"{tmp_path}/motion.csv", "--log", f"{tmp_path}/run.mcap"]
    assert main(["play", *words]) == 1
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not (tmp_path / "run.mcap").exists()


@pytest.mark.slow
def test_a_hidden_rover_on_boards_is_identified_by_commands_alone(tmp_path, capsys, monkeypatch):
    """As made: play in its gears, other masses, springs and friction, errors of its sensors."""
    monkeypatch.chdir(tmp_path)
    write_files(tmp_path)
    friction = [f"joint.{joint}_joint.friction" for joint in ARM]
    words = ["--model", "servo.xml", "--limits", "limits.toml", "--parameters", *friction]
    words += ["--duration", "3.1", "--highest", "1", "--period", "0.01", "--generations", "1"]
    assert main(["excite", *words, "--out", "motion.csv"]) == 0
    unseen = waves(2.5, np.array([0.5, 0.3, 0.4, 0.5]), np.array([0.6, 0.45, 0.7, 0.9]))
    write_motion(tmp_path / "unseen.csv", ARM, *unseen)
    made = ["--robot", "emulated", "--realism", "default", "--seed", "5"]
    for name in ("motion", "unseen"):
        assert main(["play", "--motion", f"{name}.csv", "--log", f"{name}.mcap", *made]) == 0
    resistances = [f"actuator.{joint}.resistance:0.4" for joint in ARM]
    words = ["--model", "drawn.xml", "--mapping", "mapping.toml", "--log", "motion.mcap"]
    words += ["--hold-out", "unseen.mcap", "--start", "held", "--out", "found"]
    words += ["--parameters", *resistances, *friction]
    main(["identify", *words])
    found = json.loads((tmp_path / "found" / "identified.json").read_text())
    values = {each["name"]: each["value"] for each in found["parameters"]}
    # The current also flows through two switches of the bridge, which the drawing does not have.
    whole = motor_resistance(ARM_MOTOR) + 2.0 * POWER_STAGE.switch_resistance
    for joint in ARM[1:3]:  # These bear the arm's weight.
        assert values[f"actuator.{joint}.resistance"] == pytest.approx(whole, rel=0.08)
    assert found["hold_out_ratio"] < 0.2
    off = [unseen_error(model) for model in ("drawn.xml", "found/model.xml")]
    assert off[1] < 0.2 * off[0]


def unseen_error(model):
    """Return the largest r.m.s. error of a joint in a replay of the unseen run [rad]."""
    words = ["--log", "unseen.mcap", "--mapping", "mapping.toml", "--start", "held"]
    assert main(["replay", *words, "--model", model, "--out", "again"]) == 0
    rows = json.loads(Path("again/replay.json").read_text())
    return max(each["rms"] for each in rows if "position" in each["name"])


def test_a_motion_to_the_ground_is_refused(tmp_path, capsys):
    stamps = np.arange(0.0, 3.0, 0.01)
    part = 0.5 - 0.5 * np.cos(np.pi * stamps / stamps[-1])
    angles = HOME + part[:, None] * [0.0, -1.2, 0.8, 0.0]
    write_motion(tmp_path / "motion.csv", ARM, stamps, angles)
    words = ["play", "--motion", f"{tmp_path}/motion.csv", "--log", f"{tmp_path}/run.mcap"]
    assert main(words) == 1
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert "brings the arm of rover1 to the ground with 100%, more than --risk 0.05" in last


@pytest.mark.parametrize(("seconds", "refused"), [(0.35, True), (0.6, False)])
def test_a_motion_that_would_tip_the_rover_over_is_refused(tmp_path, capsys, seconds, refused):
    stamps = np.arange(0.0, 2.0, 0.01)
    # The arm comes down at the rover's left side, and stops stretched out.
    part = 0.5 - 0.5 * np.cos(np.pi * np.clip((stamps - 0.2) / seconds, 0.0, 1.0))
    angles = np.array([1.5, 1.6, -0.2, 0.0]) + part[:, None] * [0.0, -1.5, 0.0, 0.0]
    write_motion(tmp_path / "motion.csv", ARM, stamps, angles)
    words = ["play", "--motion", f"{tmp_path}/motion.csv", "--log", f"{tmp_path}/run.mcap"]
    assert main(words) == (1 if refused else 0)
    if refused:
        last = capsys.readouterr().err.strip().splitlines()[-1]
        assert re.search(r"motion.csv: tips rover1 over with \d+%, more than --risk 0.05", last)
        assert not (tmp_path / "run.mcap").exists()
        assert main([*words, "--risk", "1"]) == 0
    tilts = read_log(tmp_path / "run.mcap").signals["rover1/inclinometer"].values
    assert (np.abs(tilts - tilts[0]).max() > np.radians(10.0)) == refused
