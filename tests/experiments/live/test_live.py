"""``live``: the twin beside a log, from the command line."""

import json
import threading

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from experiments.__main__ import main
from experiments.live.twin_beside import changes_of, placement_of
from experiments.live.twin_folder import take
from models.compose import RobotPlacement
from tests.twin.shadow.test_shadow import ROBOT, Working, add_load
from twin.connect import connect
from twin.describe import describe_rover
from twin.logs.log import Log, Signal
from twin.logs.settings import read_settings
from twin.logs.writing import LogWriter, write_mcap
from twin.loop import run
from twin.shadow.deviations import rover_deviations, shadow_scene

ALONE = RobotPlacement(ROBOT)
CHANGED = 12.0
"""Time at which the gripper takes a load [s]."""


def write_log(path, seconds, robot=ALONE, changed=None):
    """Log a rover that works; it takes 0.1 kg at a time, if one is given."""
    with (
        connect("sim", robots=[robot], realism="ideal", seed=4) as connection,
        LogWriter(path, connection.settings) as writer,
    ):
        left = [changed] if changed is not None else []

        def until():
            if left and connection.clock.time >= left[0]:
                left.clear()
                add_load(connection.simulation.model)
            return False

        run(connection.robots, [Working()], connection.clock, [writer], seconds, until)


@pytest.mark.slow
def test_a_load_that_is_taken_is_named_with_its_size(tmp_path, capsys):
    write_log(tmp_path / "run.mcap", 18.0, changed=CHANGED)
    out = tmp_path / "found"
    words = ["--log", f"{tmp_path}/run.mcap", "--learning", "10", "--out", str(out)]
    assert main(["live", *words]) == 0
    printed = capsys.readouterr().out
    found = json.loads((out / "live.json").read_text())
    (change,) = found["changes"]
    assert change["name"] == "load gripper" and change["unit"] == "kg"
    assert CHANGED < change["time"] < CHANGED + 3.0
    assert change["size"] == pytest.approx(0.1, abs=0.03)
    # The twin has it from then on, and learns what is left.
    assert found["deviations"]["load gripper"]["value"] == pytest.approx(0.1, abs=0.03)
    assert found["slope"] == pytest.approx([0.0, 0.0], abs=0.005)
    assert "load gripper +0." in printed and "deviations.png" in printed
    # Of a rover as drawn there is little to learn.
    assert abs(found["deviations"]["supply shoulder"]["value"]) < 0.05  # noqa: PLR2004
    assert all(0.0 < each < 1.0 for each in found["innovations_over_sigma"].values())
    for name in ("deviations.png", "innovations.png"):
        with Image.open(out / name) as picture:
            assert picture.width > 600  # noqa: PLR2004
    names = {chunk.entity_path for chunk in RrdReader(out / "live.rrd").stream()}
    assert {"/innovations/gyro", "/deviations/load", "/changes"} <= names


def test_a_rover_as_drawn_shows_no_change(tmp_path, capsys):
    write_log(tmp_path / "run.mcap", 7.0)
    words = ["--log", f"{tmp_path}/run.mcap", "--learning", "3", "--out", f"{tmp_path}/found"]
    assert main(["live", *words]) == 0
    assert "no change was found" in capsys.readouterr().out


def test_on_rough_ground_a_twist_tells_nothing(tmp_path):
    write_log(tmp_path / "run.mcap", 1.0)
    words = ["live", "--log", f"{tmp_path}/run.mcap", "--learning", "0.5"]
    told = list[set[str]]()
    for more in ([], ["--rough"]):
        assert main([*words, *more, "--out", f"{tmp_path}/found"]) == 0
        found = json.loads((tmp_path / "found" / "live.json").read_text())
        there = found["innovations_over_sigma"].items()
        told.append({name for name, value in there if value is not None})
    assert told[0] - told[1] == {"centre_angle"}


class Both:
    """Two rovers that work."""

    def reset(self):
        pass

    def step(self, observations):
        (command,) = Working().step({ROBOT: observations[ROBOT]}).values()
        return dict.fromkeys(observations, command)


def test_each_rover_of_a_log_that_is_still_written_has_a_twin(tmp_path, capsys):
    path, out = tmp_path / "run.mcap", tmp_path / "found"
    placed = [ALONE, RobotPlacement("other", (1.5, 0.0))]
    with (
        connect("sim", robots=placed, realism="ideal", seed=4) as connection,
        LogWriter(path, connection.settings) as writer,
    ):
        run(connection.robots, [Both()], connection.clock, [writer], 1.0)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    words = ["live", "--log", str(path), "--out", str(out)]
    assert main(words) == 1
    assert "ends early; log --mend" in capsys.readouterr().err
    rest = threading.Timer(1.0, lambda: path.write_bytes(content))
    rest.start()
    assert main([*words, "--follow"]) == 0
    rest.join()
    for robot in (ROBOT, "other"):
        assert json.loads((out / robot / "live.json").read_text())["changes"] == []
    assert main([*words, "--name", "third"]) == 1
    assert "no rover 'third' that measures; there are other, rover1" in capsys.readouterr().err


def test_two_runs_do_not_share_a_folder(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    write_log(path, 0.1)
    with take(tmp_path):
        assert main(["live", "--log", str(path), "--out", str(tmp_path)]) == 1
        assert main(["live", "--robot", "sim", "--out", str(tmp_path)]) == 1
    told = capsys.readouterr().err
    assert told.count(f"{tmp_path}: in use by process") == 2  # noqa: PLR2004


def test_what_a_log_cannot_tell_is_said_in_one_line(tmp_path, capsys):
    path = tmp_path / "run.mcap"
    write_mcap(Log({"gyro": Signal("sensor", np.arange(2.0), np.zeros((2, 3)))}), path)
    assert main(["live", "--log", str(path), "--out", f"{tmp_path}/found"]) == 1
    assert "no rover of ours that measures; there are none" in capsys.readouterr().err
    assert main(["live", "--log", str(path), "--learning", "-1"]) == 2  # noqa: PLR2004
    assert "--learning" in capsys.readouterr().err
    assert not (tmp_path / "found").exists()


def test_the_twin_holds_what_the_log_says_that_the_rover_holds(tmp_path):
    path = tmp_path / "run.mcap"
    carrier = RobotPlacement(ROBOT, card=True, mast=0.1)
    write_log(path, 0.1, carrier)
    settings = read_settings(path)
    assert placement_of(settings, ROBOT) == carrier
    assert placement_of(settings, "other") == placement_of(None, "other") == RobotPlacement("other")


@pytest.mark.parametrize("other", [{"arm": False}, {"centre_locked": True}])
def test_other_rovers_have_no_twin(other):
    with pytest.raises(ValueError, match="rover1: the twin is of the thesis' rover"):
        shadow_scene(RobotPlacement(ROBOT, **other))


def test_springs_soften_motors_weaken_zeros_drift_both_ways_and_what_sticks_does_so_wholly():
    kinds = {}
    for each in changes_of(rover_deviations(describe_rover(ROBOT))):
        kinds.setdefault(each.name.split()[0], set()).add((each.sign, each.whole))
    assert kinds == {
        "load": {(1, False)}, "spring": {(-1, False)}, "drag": {(1, False)}, "grip": {(-1, False)},
        "supply": {(1, False)}, "battery": {(1, False)}, "zero": {(0, False)},
        "blocked": {(0, True)}, "stuck": {(0, True)},
    }  # fmt: skip
