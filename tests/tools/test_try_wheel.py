"""Which versions and which commands the wheel is tried with, and that a difference is seen."""

import tomllib
import zipfile

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

from experiments.harness.catalogue import EXPERIMENTS
from tools import try_wheel

PROJECT = tomllib.loads((try_wheel.ROOT / "pyproject.toml").read_text())["project"]
ROOMS = {name: each.module.split(".")[1] for name, each in EXPERIMENTS.items()}


def ranges():
    extras = PROJECT["optional-dependencies"].values()
    every = [Requirement(line) for lines in (PROJECT["dependencies"], *extras) for line in lines]
    return [each for each in every if each.name != "fieldtwin"]


def test_the_lock_has_a_version_within_each_range():
    locked = {}
    for line in try_wheel.pins("locked"):
        pin = Requirement(line)
        (version,) = pin.specifier
        assert version.operator == "=="
        locked.setdefault(pin.name.lower().replace("_", "-"), set()).add(version.version)
    for each in ranges():
        versions = locked[each.name.lower().replace("_", "-")]
        assert all(each.specifier.contains(version) for version in versions), each


def test_the_lowest_versions_are_the_bounds_of_the_ranges():
    lowest = dict(line.split("==") for line in try_wheel.pins("lowest"))
    assert lowest.keys() == {Requirement(line).name for line in PROJECT["dependencies"]}
    for line in PROJECT["dependencies"]:
        each = Requirement(line)
        assert each.specifier.contains(lowest[each.name])
        below = Version(lowest[each.name])
        assert not each.specifier.contains(f"{max(below.major - 1, 0)}.0.0.dev0")


def test_pip_chooses_the_newest_by_itself():
    assert try_wheel.pins("newest") == []


def test_one_experiment_of_each_room_is_run_or_all():
    lightest = list(try_wheel.commands(ROOMS, "lightest"))
    assert sorted(ROOMS[words[0]] for words in lightest if "--quick" in words) == sorted(
        set(ROOMS.values())
    )
    everything = list(try_wheel.commands(ROOMS, "all"))
    assert [words[0] for words in everything if "--quick" in words] == list(EXPERIMENTS)
    for words in (lightest, everything):
        assert [["--version"], ["list"], ["doctor"]] == words[:3] and words[-1] == ["report"]


def test_a_room_without_a_lightest_experiment_is_named():
    with pytest.raises(SystemExit, match="ch9"):
        list(try_wheel.commands({**ROOMS, "ch9-moon": "ch9"}, "lightest"))


def test_wheels_that_differ_in_a_file_are_told_apart(tmp_path):
    for name, content in (("one", "1"), ("same", "1"), ("other", "2")):
        with zipfile.ZipFile(tmp_path / name, "w") as wheel:
            wheel.writestr("models/a.xml", content)
    with zipfile.ZipFile(tmp_path / "more", "w") as wheel:
        wheel.writestr("models/a.xml", "1")
        wheel.writestr("models/b.xml", "1")
    one = tmp_path / "one"
    assert try_wheel.differing(one, tmp_path / "same") == []
    assert try_wheel.differing(one, tmp_path / "other") == ["models/a.xml"]
    assert try_wheel.differing(one, tmp_path / "more") == ["models/b.xml"]


def test_a_command_that_fails_is_counted_and_its_words_are_printed(tmp_path, capsys):
    script = tmp_path / "fieldtwin"
    script.write_text(
        '#!/bin/sh\necho "said $1 in $PWD, home $HOME, $PYTHONPATH"\n[ "$1" = good ]\n'
    )
    script.chmod(0o755)
    assert try_wheel.failures(tmp_path, tmp_path, [["good"], ["bad"]]) == 1
    good, bad, said, *_ = capsys.readouterr().out.splitlines()
    assert good.endswith("ok") and "FAILED, status 1" in bad
    assert said == f"said bad in {tmp_path}, home {tmp_path}, "
