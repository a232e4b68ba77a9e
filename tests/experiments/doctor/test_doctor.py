import tomllib

import pytest
from packaging.requirements import Requirement

from experiments.doctor import doctor
from experiments.doctor import robot as doctor_robot
from experiments.doctor.doctor import examine_packages, requirements, run
from experiments.doctor.doctor_options import Options
from experiments.doctor.robot import examine_robot
from experiments.harness.contract import OptionError
from twin.hardware.roboclaw.codec import Status
from twin.hardware.serial_link import LinkError

pytestmark = pytest.mark.real_time


def test_doctor_is_content_here_and_names_renderer_and_checksum(capsys):
    assert run(Options()) == 0
    text = capsys.readouterr().out
    for part in ("mujoco", "GL renderer", "sha256", "cores free"):
        assert part in text


def test_missing_and_wrong_packages_are_named_with_a_remedy():
    found = examine_packages([Requirement("no-such-package>=1"), Requirement("numpy<0.2")])
    assert [finding.fatal for finding in found] == [True, True]
    assert "pip install 'no-such-package>=1'" in found[0].remedy and "numpy<0.2" in found[1].remedy


def test_packages_are_those_that_the_project_says_it_needs():
    with open("pyproject.toml", "rb") as stream:
        project = tomllib.load(stream)["project"]
    assert set(requirements()) == set(map(Requirement, project["dependencies"]))


def test_missing_library_names_its_apt_package(monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(doctor, "can_load", lambda library: library != "libEGL.so.1")
    broken = [doctor.Finding("test frame", "none", "apt install it")]
    monkeypatch.setattr(doctor, "examine_frame", lambda: broken)
    assert run(Options()) == 1
    text = capsys.readouterr().out
    assert "libEGL.so.1" in text and "apt install libegl1" in text
    assert "1 required" not in text and "2 required things are missing" in text


def test_probe_that_hangs_is_reported(monkeypatch):
    monkeypatch.setattr(doctor, "PROBE_TIMEOUT", 0.001)
    assert doctor.examine_frame()[0].fatal


@pytest.fixture(autouse=True)
def _software_rendering(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")


def test_emulated_robot_is_well(capsys):
    findings = list(examine_robot("emulated", patience=10.0))
    assert [finding.what for finding in findings if finding.fatal] == []
    lines = {finding.what: finding.value for finding in findings}
    assert len([what for what in lines if what.startswith("motor board")]) == 4
    assert "2x15a" in lines["motor board 0x82"]
    assert "serial timeout 0.2 s" in lines["limits"]
    assert lines["e-stop"] == "seen and released on every board"
    assert "pitch" in lines["inclinometer"] and "N, fresh" in lines["arm base wrench"]


class Boards:
    """Boards of which one is deaf to the e-stop, and one silent."""

    addresses = (0x80, 0x81, 0x82)

    def status(self, address):
        if address == 0x82:
            raise LinkError("silent")
        return Status.E_STOP if address == 0x80 else Status.NORMAL


def test_board_that_does_not_notice_the_e_stop_is_named():
    finding = doctor_robot._stop_finding(Boards(), lambda: None, 0.1)
    assert finding.fatal and "0x81, 0x82" in finding.value and "0x80" not in finding.value


def test_port_that_is_not_there_is_a_finding_not_an_end():
    findings = list(examine_robot("serial:/dev/no-port,most_days=99999", 1.0))
    assert [finding.what for finding in findings] == ["calibration", "ports"]
    assert findings[1].fatal and "/dev/no-port" in findings[1].value


def test_stale_calibration_is_reported_before_the_boards():
    finding = next(examine_robot("serial:/dev/no-port", 1.0))
    assert finding.fatal and "2002-01-01" in finding.value


@pytest.mark.parametrize("target", ["sim", "serial", "serial:", "serial:x,baud=9"])
def test_robot_without_boards_is_refused(target, capsys):
    with pytest.raises(OptionError, match="--robot"):
        Options(robot=target)
