"""``replay``: our own logs to the bit, others beside a model."""

import dataclasses
import json

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from experiments.__main__ import main
from experiments.ch2.rover.rover import record_run
from experiments.ch2.rover.rover_options import Options
from experiments.harness.recording import RunFiles
from experiments.own.replay import replay_own
from models.compose import FieldConfig, RobotPlacement
from tests.experiments.own import hidden
from tests.experiments.own.test_identify import write_runs
from twin.connect import connect
from twin.logs.log import LogError
from twin.logs.settings import read_settings
from twin.logs.writing import LogWriter
from twin.loop import run
from twin.robot import ArmMode, Command, WheelMode

FIELD = FieldConfig(relief=0.02, rocks=10, seed=4, texture_pixels=16, slope=(0.05, -0.03))


class Wandering:
    """Wheel speeds and arm positions that change, by one robot's own observations."""

    def __init__(self, names):
        self._names = names

    def reset(self):
        pass

    def step(self, observations):
        found = {}
        for number, name in enumerate(self._names):
            seen = observations[name]
            wave = np.sin(2.0 * seen.time + number)
            wheels = np.array([3.0, -1.0, 3.0, -1.0]) * wave
            arm = seen.arm_angles.value + 0.1 * wave if seen.arm_angles.usable else np.zeros(4)
            found[name] = Command(wheels, arm, WheelMode.SPEED, ArmMode.POSITION)
        return found


def logged(path, target, duration, names=("rover1", "rover2"), realism="default"):
    robots = [RobotPlacement(name, (0.8 * place, 0.0)) for place, name in enumerate(names)]
    with (
        connect(target, robots=robots, field=FIELD, realism=realism, seed=7) as connection,
        LogWriter(path, connection.settings) as writer,
    ):
        run(connection.robots, [Wandering(names)], connection.clock, [writer], duration)
        return connection.settings


@pytest.mark.parametrize("target", ["sim", "quantised", "emulated"])
def test_log_of_a_robot_of_ours_is_replayed_to_the_bit(tmp_path, target, capsys):
    path = tmp_path / "run.mcap"
    names = ("rover1",) if target == "emulated" else ("rover1", "rover2")
    settings = logged(path, target, 2.0, names)
    assert read_settings(path) == settings
    assert main(["replay", "--log", str(path), "--out", f"{tmp_path}/found"]) == 0
    assert "the same to the bit" in capsys.readouterr().out
    found = json.loads((tmp_path / "found" / "replay.json").read_text())
    assert {each["bits_different"] for each in found} == {0}
    assert sum(each["samples"] for each in found) > 2000 * len(names)
    last = names[-1]
    assert {f"{last}/arm_angles[3]", f"{last}/inclinometer[1]", f"{last}/wheels[0]"} <= {
        each["name"] for each in found
    }


def test_logged_experiment_is_replayed_to_the_bit(tmp_path):
    files = RunFiles(log=str(tmp_path / "run.mcap"))
    record_run(Options(robot="sim", seed=3), files)
    curves = replay_own(tmp_path / "run.mcap")
    assert sum(each.bits for each in curves) == 0
    assert max(np.ptp(each.measured) for each in curves if "arm_angles" in each.name) > 0.1


def test_another_seed_differs(tmp_path, monkeypatch):
    """What is compared would show another robot."""
    path = tmp_path / "run.mcap"
    settings = dataclasses.replace(logged(path, "sim", 1.0), seed=8)
    monkeypatch.setattr("experiments.own.replay.read_settings", lambda _: settings)
    differing = {each.name for each in replay_own(path) if each.bits}
    assert {
        "rover1/inclinometer[0]",
        "rover2/arm_angles[2]",
        "rover1/arm_base_wrench[0]",
    } <= differing


def test_log_of_another_robot_drives_a_model(tmp_path, capsys):
    write_runs(tmp_path, "cart", 2.0, lambda spec: None, "a")
    words = ["--log", f"{tmp_path}/a.csv", "--mapping", f"{tmp_path}/robot.toml"]
    words += ["--model", hidden.robot("cart"), "--out", f"{tmp_path}/found"]
    assert main(["replay", *words]) == 0
    assert "tip_gyro[1]" in capsys.readouterr().out
    found = {
        each["name"]: each for each in json.loads((tmp_path / "found/replay.json").read_text())
    }
    assert 0.0 < found["rail_encoder"]["rms"] < 0.1  # it has another delay
    with Image.open(tmp_path / "found" / "replay.png") as picture:
        assert picture.width > 500
    entities = {
        str(c.entity_path) for c in RrdReader(tmp_path / "found/replay.rrd").stream().to_chunks()
    }
    assert {"/measured/rail_encoder", "/simulated/tip_gyro[1]", "/error/root_encoder"} <= {
        name.replace("\\", "") for name in entities
    }


def test_log_that_does_not_say_its_robot_needs_a_model(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    with LogWriter(path) as writer:
        writer.write("sensor", "rover1/heading", 0.0, [0.0], "rad", "")
    assert main(["replay", "--log", str(path)]) == 1
    assert "--model has to say" in capsys.readouterr().err
    assert main(["replay", "--log", str(path), "--mapping", "robot.toml"]) == 2
    assert "--mapping: used with --model only" in capsys.readouterr().err


def test_settings_that_are_none_are_refused(tmp_path):
    path = tmp_path / "run.mcap"
    logged(path, "sim", 0.1)
    content = path.read_bytes()
    path.write_bytes(content.replace(b'"seed": 7', b'"seed": x'))
    with pytest.raises(LogError, match="run.mcap: damaged"):
        read_settings(path)
