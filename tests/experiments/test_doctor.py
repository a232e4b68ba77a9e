import pytest

from experiments import doctor
from experiments.doctor import CHECKOUT, examine_packages, main, pins


def test_doctor_is_content_here_and_names_renderer_and_checksum(capsys):
    assert main([]) == 0
    text = capsys.readouterr().out
    for part in ("mujoco", "GL renderer", "sha256", "cores free"):
        assert part in text


def test_missing_and_wrong_packages_are_named_with_a_remedy():
    found = examine_packages({"no-such-package": "1.0", "numpy": "0.1"})
    assert [finding.fatal for finding in found] == [True, True]
    assert "make setup" in found[0].remedy and "0.1" in found[1].remedy


def test_pins_are_those_of_the_project():
    assert pins(CHECKOUT)["mujoco"] == "3.17.0"


def test_missing_library_names_its_apt_package(monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(doctor, "can_load", lambda library: library != "libEGL.so.1")
    broken = [doctor.Finding("test frame", "none", "apt install it")]
    monkeypatch.setattr(doctor, "examine_frame", lambda: broken)
    assert main([]) == 1
    text = capsys.readouterr().out
    assert "libEGL.so.1" in text and "apt install libegl1" in text
    assert "1 required" not in text and "2 required things are missing" in text


def test_probe_that_hangs_is_told(monkeypatch):
    monkeypatch.setattr(doctor, "PROBE_TIMEOUT", 0.001)
    assert doctor.examine_frame()[0].fatal


@pytest.fixture(autouse=True)
def _software_rendering(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
