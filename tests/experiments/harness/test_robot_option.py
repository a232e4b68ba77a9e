"""What ``--robot`` may name, and what every command says of a calibration that is none."""

import dataclasses
import datetime

import pytest

from experiments.__main__ import main
from experiments.doctor.doctor_options import Options as DoctorOptions
from experiments.doctor.robot import examine_robot
from experiments.harness import catalogue
from experiments.harness.contract import OptionError
from twin.hardware.calibration.calibration import (
    Calibration,
    calibration_path,
    calibration_text,
    read_calibration,
)
from twin.hardware.wiring import TARGETS

WITH_ROBOT = [
    name
    for name, experiment in catalogue.EXPERIMENTS.items()
    if "robot" in {field.name for field in dataclasses.fields(experiment.options_type())}
]
PORTS = "serial:/dev/no-port,analogue=/dev/no-port,wrench=127.0.0.1"


def one_line(capsys) -> str:
    """Return what was written to the terminal's error stream, which is one line."""
    text = capsys.readouterr().err
    assert text.startswith("error: ") and text.count("\n") == 1 and "Traceback" not in text
    return text


@pytest.mark.parametrize("name", [*WITH_ROBOT, "calibrate", "doctor"])
@pytest.mark.parametrize("target", ["garbage", ""])
def test_unknown_robot_is_one_line_with_what_there_is(name, target, tmp_path, capsys):
    assert {"ch2-rover", "ch3-stereo", "mission"} <= set(WITH_ROBOT)
    out = [] if name in ("calibrate", "doctor") else ["--out", str(tmp_path)]
    assert main([name, f"--robot={target}", *out]) == 2
    text = one_line(capsys)
    assert "--robot" in text and "emulated" in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["ch2-rover", "mission", "doctor"])
def test_commands_on_any_robot_list_every_target(name, capsys):
    assert main([name, "--robot", "garbage"]) == 2
    # A target's long form is broken into lines at its commas.
    listed = one_line(capsys).replace(", ", ",")
    assert all(target in listed for target in TARGETS)


def test_doctor_says_which_robots_it_can_examine():
    with pytest.raises(OptionError) as caught:
        DoctorOptions(robot="sim")
    assert "available: emulated, serial:PORT" in str(caught.value)
    assert str(caught.value).endswith("not available here: sim, quantised")


def test_port_that_cannot_be_opened_is_one_line(tmp_path, capsys):
    robot = f"{PORTS},home=0:0:0:0,most_days=99999"
    words = ["ch2-rover", "--quick", "--seeds", "2", "--jobs", "2", "--out", str(tmp_path)]
    assert main([*words, "--robot", robot]) == 1
    _progress, *lines = capsys.readouterr().err.splitlines()
    (line,) = lines
    assert line.startswith("error: /dev/no-port: cannot be opened")


def replaced(old: str, new: str) -> bytes:
    text = calibration_text(nominal())
    assert old in text
    return text.replace(old, new, 1).encode()


def nominal() -> Calibration:
    return read_calibration(calibration_path("rover1"))


TOMORROW = (datetime.date.today() + datetime.timedelta(days=2)).isoformat()
DAMAGED = {
    "not TOML": (b"schema = 1\n[drive\n", "is not TOML"),
    "another type": (replaced("counts_per_turn = 16384.0", "counts_per_turn = []"), "a number"),
    "missing key": (replaced("bits = 10\n", ""), "bits is missing"),
    "NaN": (replaced("reference = 5.0", "reference = nan"), "reference is nan"),
    "too large a number": (replaced("reference = 5.0", f"reference = 1{'0' * 400}"), "a number"),
    "too many digits": (replaced("bits = 10", f"bits = 0x{'f' * 9000}"), "digits"),
    "rotation of huge numbers": (replaced("[[1.0,", "[[1e300,"), "rotation matrix"),
    "long list": (replaced("bits = 10", f"bits = [{'1,' * 9000}]"), "[1, 1, 1, 1, 1, 1, ...]"),
    "noise": (bytes(range(256)) * 4, "is not TOML"),
    "not UTF-8": (calibration_text(nominal()).encode("utf-16"), "is not TOML"),
    "nested": (b"a = " + b"[" * 20_000, "nested too deeply"),
    "huge": (b"#" * 10**6, "too large: 1,000,000 bytes, the limit is 32,768"),
    "future": (replaced("2002-01-01", TOMORROW), "after today"),
    "another robot": (replaced('"rover1"', '"rover2"'), "wanted 'rover1'"),
}


@pytest.fixture(params=[*DAMAGED, "folder", "device"])
def damaged(request, tmp_path):
    """Return the path of a damaged calibration, and what an error says of it."""
    if request.param == "device":
        return "/dev/zero", "too large"
    path = tmp_path / "rover1.toml"
    if request.param == "folder":
        path.mkdir()
        return path, "Is a directory"
    content, reason = DAMAGED[request.param]
    path.write_bytes(content)
    return path, reason


@pytest.mark.parametrize(
    "words", [["calibrate"], ["ch2-rover", "--quick", "--out"], ["mission", "--quick", "--out"]]
)
def test_damaged_calibration_is_one_line_in_every_command(words, damaged, tmp_path, capsys):
    path, reason = damaged
    out = [str(tmp_path / "results")] if words[-1] == "--out" else []
    assert main([*words, *out, "--robot", f"{PORTS},most_days=99999,calibration={path}"]) == 2
    text = one_line(capsys)
    assert str(path) in text and reason in text and len(text) < 600


def test_damaged_calibration_is_the_doctors_first_finding(damaged):
    path, reason = damaged
    target = f"{PORTS},most_days=99999,calibration={path}"
    finding = next(examine_robot(target, 1.0))
    assert finding.fatal and "\n" not in finding.line
    assert str(path) in finding.value and reason in finding.value
