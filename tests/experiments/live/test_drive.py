"""What a drive refuses, what it shows, and how it ends on boards."""

import json
import signal

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.harness.contract import OptionError
from experiments.live.drive import drive, shown, told_to_end
from experiments.live.drive_options import Options
from twin.connect import connect
from twin.robot import MISSING, Channel, Lifecycle, Validity

AHEAD = {"drive": [1.0, 0.0], "arm": [0.0, 0.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": "simm"}, "--robot: unknown robot 'simm'; available: sim, quantised, emulated"),
        ({"robot": "serial:/dev/a,robot=a,serial:/dev/b,robot=b"}, "--robot: one rover .* got 2"),
        ({"robot": "serial:/dev/a", "seed": 1}, "--seed: real boards have none"),
        ({"robot": "serial:/dev/a", "realism": "ideal"}, "--realism: real boards have none"),
        ({"speed": 0.0}, "--speed: expected above 0 m/s"),
        ({"seed": -1}, "--seed: expected 0 or more"),
        ({"port": 70000}, "--port: expected 0 to 65535"),
    ],
)
def test_what_cannot_be_driven_is_refused(options, message):
    with pytest.raises(OptionError, match=message):
        Options(**options)


@pytest.mark.parametrize(("option", "suffix"), [("record", ".rrd"), ("log", ".mcap")])
def test_a_file_must_be_new_and_have_a_place(tmp_path, option, suffix):
    (tmp_path / f"old{suffix}").touch()
    for name, message in (
        (f"old{suffix}", "is there already"),
        ("run.mp4", f"ends with {suffix}"),
        (f"none/run{suffix}", "no folder"),
    ):
        with pytest.raises(OptionError, match=f"--{option} .*{message}"):
            Options(**{option: tmp_path / name})


def test_a_speed_beyond_the_drawing_is_refused_in_one_line(capsys):
    assert main(["drive", "--robot", "quantised", "--speed", "0.4"]) == 2
    error = capsys.readouterr().err
    assert error == "error: --speed: expected above 0 to 0.32 m/s, got 0.4\n"


def test_the_page_gets_what_is_observed_and_how_far_it_holds():
    tilt = Channel(np.array([0.12345, -0.1]), 1.0, Validity.STALE)
    told = {"name": "inclinometer", "unit": "rad", "values": [0.123, -0.1], "validity": "stale"}
    assert shown("inclinometer", tilt) == told
    assert shown("heading", MISSING)["values"] == []
    json.dumps(told, allow_nan=False)


class Person:
    """In the place of a page's server: someone who drives ahead, until something happens."""

    watched = False

    def __init__(self, ends):
        self._ends, self._asked = ends, 0

    def taken(self):
        self._asked += 1
        if self._asked > 100:
            raise self._ends
        return [AHEAD]


@pytest.mark.parametrize("ends", [KeyboardInterrupt(), RuntimeError("a bug")])
def test_motors_on_boards_are_at_rest_however_a_drive_ends(ends):
    with connect("emulated") as connection:
        (robot,) = connection.robots.values()
        begin = np.array(connection.emulator.state()[robot.name]["angles"])
        with pytest.raises(type(ends)):
            drive(connection, Person(ends), Options(robot="emulated"), bool)
        assert robot.lifecycle is Lifecycle.INACTIVE
        connection.clock.tick()
        truth = connection.emulator.state()[robot.name]
        assert np.min(truth["angles"][:4] - begin[:4]) > 1.0
        assert not np.any(truth["codes"])


def test_the_first_ctrl_c_ends_a_drive_between_ticks_and_another_at_once():
    before = signal.getsignal(signal.SIGINT)
    with told_to_end() as told:
        signal.raise_signal(signal.SIGINT)
        assert told.is_set()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
