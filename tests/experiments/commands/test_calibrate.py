"""A person who calibrates, played by a table that tilts; the robot counts as its boards do."""

import contextlib
import dataclasses
import datetime
import time
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.appd.calibration.tilt_table import FIELD, TiltTable
from experiments.commands import calibrate
from models.compose import RobotPlacement
from models.datasheets import ARM, DEGREE
from twin.describe import describe_rover
from twin.hardware.board_robot import BoardRobot
from twin.hardware.calibration.calibration import (
    calibration_path,
    calibration_text,
    read_calibration,
)
from twin.hardware.calibration.procedure import ProcedureConfig, run_procedure, tilt_procedure
from twin.hardware.emulator.direct import DirectBoards
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig
from twin.robot import ArmMode, Command, RobotError

pytestmark = pytest.mark.real_time

CONFIG = ProcedureConfig()


class Ground:
    """The scene as `TiltTable` wants it: a step is a tick of boards that hold the arm."""

    def __init__(self, scene, robot):
        self._scene, self._robot = scene, robot
        self._hold = Command(arm=np.array(ARM.home), arm_mode=ArmMode.POSITION)

    def __getattr__(self, name):
        return getattr(self._scene.simulation, name)

    def step(self):
        self._robot.observe()
        self._robot.command(self._hold)
        self._scene.tick()

    tick = step


class Person:
    """Does what the procedure says."""

    def __init__(self, table):
        self.table = table
        self.shown = []

    def show(self, text):
        self.shown.append(text)
        if "take the weight off" in text:
            number = int(text.split()[1]) - 1
            self.table.hang(0.0)
            self.table.turn(np.array(CONFIG.tilts[number]), 1.0)
            self.table.wait(1.5)
        if text.startswith("Hang"):
            self.table.hang(CONFIG.weight)
            self.table.wait(1.5)

    def ask(self, question):
        return ""


def _wrong(calibration):
    """Return a calibration with constants that are far off."""
    tilt = calibration.inclinometer
    pitch = dataclasses.replace(tilt.pitch, zero_volts=2.6, volts_per_radian=1.6)
    roll = dataclasses.replace(tilt.roll, zero_volts=2.3, volts_per_radian=2.2)
    section = dataclasses.replace(tilt, pitch=pitch, roll=roll)
    return dataclasses.replace(calibration, inclinometer=section)


@pytest.mark.slow
def test_person_finds_the_constants_of_the_boards_behind_wrong_ones():
    scene = EmulatedScene(SceneConfig((RobotPlacement("rover1", stereo=False),), FIELD))
    rover = scene.rovers["rover1"]
    truth, wrong = rover.calibration, _wrong(rover.calibration)
    robot = BoardRobot(describe_rover("rover1"), DirectBoards(rover), wrong, lambda: scene.time)
    robot.configure()
    robot.home(rover.angles()[4:])
    robot.activate()
    ground = Ground(scene, robot)
    person = Person(TiltTable(ground, "rover1"))
    steps = tilt_procedure(wrong, CONFIG, datetime.date(2026, 12, 1))
    clock = ground
    try:
        result = run_procedure(
            steps, lambda: calibrate.measure(robot, clock, 2.0), person.ask, person.show
        )
    finally:
        scene.close()
    assert not [text for text in person.shown if text.startswith("Not taken")]
    found = result.calibration.inclinometer
    for axis in ("pitch", "roll"):
        ours, real = getattr(found, axis), getattr(truth.inclinometer, axis)
        # One count of the converter is 0.145 degrees.
        assert ours.volts_per_radian == pytest.approx(real.volts_per_radian, rel=0.02)
        assert abs(ours.zero_volts - real.zero_volts) < 0.15 * DEGREE * real.volts_per_radian
    assert found.calibrated_on == datetime.date(2026, 12, 1)


def test_silent_sensor_is_reported_by_name():
    scene = EmulatedScene(SceneConfig((RobotPlacement("rover1", stereo=False),), FIELD))
    rover = scene.rovers["rover1"]
    boards = DirectBoards(rover)
    boards.has_wrench = False
    robot = BoardRobot(describe_rover("rover1"), boards, rover.calibration, lambda: scene.time)
    robot.configure()
    try:
        with pytest.raises(RobotError, match="rover1.*arm base wrench gave 0 readings"):
            calibrate.measure(robot, scene, 0.2)
    finally:
        scene.close()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--robot", "sim"], "no real boards"),
        (["--robot", "serial:/dev/null"], "needs analogue=PORT and wrench=HOST"),
        (["--robot", "serial:a,analogue=b,wrench=c", "--weight", "0"], "0.05 to 5 kg"),
        (["--robot", "serial:a,analogue=b,wrench=c", "--output", "no/x.toml"], "no folder no"),
    ],
)
def test_bad_options_are_reported_in_one_line(words, message, capsys):
    assert main(["calibrate", *words]) == 2
    assert message in capsys.readouterr().err


def test_missing_port_is_reported_and_nothing_is_written(tmp_path, capsys):
    words = ["--robot", "serial:/dev/no-port,analogue=b,wrench=127.0.0.1"]
    target = tmp_path / "new.toml"
    assert main(["calibrate", *words, "--output", str(target)]) == 1
    assert "/dev/no-port" in capsys.readouterr().err
    assert not target.exists()


def test_arm_is_held_while_the_person_works_and_falls_otherwise():
    """Motors at rest only brake: after a second the arm has sunk."""
    sunk = []
    for hold in (True, False):
        scene = EmulatedScene(SceneConfig((RobotPlacement("rover1", stereo=False),), FIELD))
        rover = scene.rovers["rover1"]
        start = rover.angles()[4:]
        boards = DirectBoards(rover)
        robot = BoardRobot(
            describe_rover("rover1"), boards, rover.calibration, lambda scene=scene: scene.time
        )
        robot.configure()
        with calibrate.held(robot, start.tolist() if hold else [], scene):
            while hold and scene.time < 1.0:
                time.sleep(0.01)
        while scene.time < 1.0:
            scene.tick()
        sunk.append(np.abs(rover.angles()[4:] - start).max())
        scene.close()
    assert sunk[0] < 0.02 < 0.1 < sunk[1]


def test_person_who_stops_changes_nothing(tmp_path, capsys, monkeypatch):
    scene = SceneConfig((RobotPlacement("rover1", stereo=False),), FIELD)
    target = tmp_path / "new.toml"
    monkeypatch.setattr("builtins.input", lambda question: "q")
    with contextlib.closing(EmulatorProcess(scene, realtime=True)) as emulator:
        ports = emulator.ports["rover1"]
        robot = f"serial:{ports['bus']},analogue={ports['analogue']}"
        robot += f",wrench=127.0.0.1:{ports['wrench']}"
        assert main(["calibrate", "--robot", robot, "--output", str(target)]) == 1
    message = capsys.readouterr()
    assert "take the weight off" in message.out and "stopped" in message.err
    assert not target.exists()


def test_constants_that_cannot_be_written_are_printed(tmp_path, capsys, monkeypatch):
    found = read_calibration(calibration_path("rover1"))
    monkeypatch.setattr(calibrate, "open_boards", lambda *_: SimpleNamespace(close=lambda: None))
    robot = SimpleNamespace(configure=lambda: None)
    monkeypatch.setattr(calibrate, "BoardRobot", lambda *_: robot)
    result = SimpleNamespace(calibration=found)
    monkeypatch.setattr(calibrate, "run_procedure", lambda *_: result)
    words = ["--robot", "serial:a,analogue=b,wrench=c", "--output", str(tmp_path)]
    assert main(["calibrate", *words]) == 1
    message = capsys.readouterr()
    assert calibration_text(found) in message.out and "printed above" in message.err
