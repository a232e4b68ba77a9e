"""A rover that `live` owns: active on a person's word alone, and its history outlives a kill."""

import contextlib
import json
import signal

import numpy as np
import pytest

from controllers.motion.teleoperation import Teleoperation
from controllers.sensing.changes import ChangeMemory
from controllers.sensing.diagnosis import UNKNOWN, Finding
from experiments.harness.contract import ExperimentError, OptionError
from experiments.live.live import SLOWER, OwnPage
from experiments.live.live_options import Options
from experiments.live.twin_beside import Block, Named, TwinMemory
from experiments.live.twin_folder import EVERY, FOUND, TwinFolder, next_run
from experiments.live.twin_watch import TwinState
from experiments.living.kills import Person
from tests.experiments.live import pages
from twin.connect import connect as connect_robot
from twin.logs.mapping import read_log
from twin.loop import Tick

LEARNING = 6.0
"""Time for which the rover is only learned [s]."""


def wheel_speeds(about):
    (row,) = (each for each in about["sensors"] if each["name"] == "wheel_speeds")
    return np.array(row["values"])


@pytest.mark.slow
@pytest.mark.real_time
def test_a_killed_run_leaves_its_history_and_the_next_one_goes_on_inactive(tmp_path):
    out = tmp_path / "live"
    words = ("live", "--robot", "sim", "--out", out, "--learning", LEARNING, "--seed", 3)
    with pages.serving(*words) as (process, url), Person(url) as person:
        about = person.until(lambda about: about["time"] > 0.2)  # noqa: PLR2004
        assert (about["active"], about["lifecycle"]) == (False, "inactive")
        assert np.abs(wheel_speeds(about)).max() < 0.1  # noqa: PLR2004
        # What is not active does not move.
        assert np.abs(wheel_speeds(person.drive(0.3))).max() < 0.1  # noqa: PLR2004
        person.ask(activate=True)
        person.until(lambda about: about["lifecycle"] == "active")
        about = person.drive(LEARNING - 0.5)
        assert wheel_speeds(about).min() > 0.5  # noqa: PLR2004
        process.kill()
        process.wait()
    killed = about["time"]
    with pages.serving(*words) as (process, url), Person(url) as person:
        about = person.drive(0.3)
        assert (about["active"], about["lifecycle"]) == (False, "inactive")
        person.ask(activate=True)
        person.until(lambda about: about["lifecycle"] == "active")
        person.until(lambda about: "learns" in about["twin"][0])
        person.until(lambda about: "looks for changes" in about["twin"][0])
        person.drive(1.5)
        person.ask(activate=False)
        person.until(lambda about: about["lifecycle"] == "inactive")
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=120.0)
        assert process.returncode == 0
    assert "the run before was killed; its log was completed" in printed
    first, second = (read_log(out / f"run-00{number}.mcap") for number in (1, 2))
    assert killed - 1.0 < first.signals["rover1/wheels"].stamps[-1]
    assert np.abs(first.signals["rover1/wheels"].values).max() > 0.1  # noqa: PLR2004
    assert len(second.signals["rover1/gyro"].stamps) > 100  # noqa: PLR2004
    found = json.loads((out / "live.json").read_text())
    assert found["ticks"] > 100 and 0.0 <= found["deadline_miss_fraction"] <= 1.0  # noqa: PLR2004
    lines = [json.loads(line) for line in (out / FOUND).read_text().splitlines()]
    blocks = [line["block"] for line in lines if "block" in line]
    times = [each["time"][0] for each in blocks]
    assert times == sorted(times) and times[-1] > killed
    # The second run knows the rover: it looks as soon as its motion is settled.
    again = int(np.argmax(np.diff(times))) + 1
    assert blocks[again + 2]["evidence"] != [None] == blocks[2]["evidence"]
    assert (out / "deviations.png").exists() and (out / "run-002.rrd").exists()


class Beside:
    """In the place of the twin's process: what it has named so far."""

    alive, state = True, None

    def name(self, *findings):
        named = tuple(Named(1.0, each, "1") for each in findings)
        self.state = TwinState(1.0, 0.5, learning=False, named=named)


class NoPage:
    """In the place of a page's server that nobody watches."""

    watched = False

    def taken(self):
        return []


@contextlib.contextmanager
def paged():
    """A simulated rover, the hand that it is lent to, its page, and its twin."""
    twin = Beside()
    with connect_robot("sim") as connection:
        (robot,) = connection.robots.values()
        hand = Teleoperation(robot.description, 0.15)
        yield robot, hand, OwnPage(NoPage(), robot, hand, 0.15, twin), twin


def test_a_change_slows_the_rover_or_stops_it_until_a_person_activates_it_anew():
    with paged() as (robot, hand, page, twin):
        tick = Tick(0, 0.0, {robot.name: robot.observe()}, {})
        page.record(tick)
        assert hand.pace == 1.0
        battery, unknown = Finding("battery", 0.2, 0.01, 9.0), Finding(UNKNOWN, 0.0, 0.0, 0.0)
        twin.name(battery)
        page.record(tick)
        assert hand.pace == SLOWER
        assert page.more()["why"] == "slower, as all motors have lost torque"
        twin.name(battery, unknown, battery)
        page.record(tick)
        assert hand.pace == 0.0
        assert page.more()["why"].startswith("holds still, as what changed is not known")
        hand.ask(1.0, 0.0, [1.0] * 4)
        command = hand.step({robot.name: robot.observe()})[robot.name]
        assert np.all(command.wheels == 0.0)
        page.take({"activate": True})
        page.record(tick)  # What was named before is heeded once.
        assert hand.pace == 1.0 and page.wanted
        hand.ask(1.0, 0.0, [0.0] * 4)
        command = hand.step({robot.name: robot.observe()})[robot.name]
        assert np.all(command.wheels > 0.0)


def test_a_person_who_holds_on_lets_the_rover_tell_more_of_a_change():
    with paged() as (robot, hand, page, twin):
        held = {"identify": True, "drive": [0.0, 0.0], "arm": [0.0] * 4}

        def rates(time, told):
            seen = robot.observe()._replace(time=time)
            page.record(Tick(0, time, {robot.name: seen}, {}))
            page.take(told)
            return hand.step({robot.name: seen})[robot.name].arm_rates

        assert page.more()["identify"] == "" and np.all(rates(0.0, held) == 0.0)
        twin.name(Finding("drag elbow", 0.1, 0.01, 9.0))
        assert page.more()["identify"] == "drag elbow"
        rates(1.0, held)
        moved = rates(1.05, held)
        assert moved[2] > 0.0 and np.all(moved[[0, 1, 3]] == 0.0)
        assert np.all(rates(1.1, {**held, "identify": False}) == 0.0)
        # Held again later, it begins anew.
        assert np.all(rates(3.0, held) == 0.0)
        assert rates(3.05, held) == pytest.approx(moved)
        twin.name(Finding(UNKNOWN, 0.0, 0.0, 0.0))
        assert page.more()["identify"] == ""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "--log, --robot: expected one of them"),
        ({"robot": "sim", "log": "run.mcap"}, "--log, --robot: expected one of them"),
        ({"robot": "simm"}, "--robot: unknown robot 'simm'"),
        ({"robot": "sim", "follow": True}, "--follow: goes with --log only"),
        ({"robot": "sim", "name": "rover1"}, "--name: goes with --log only"),
        ({"robot": "serial:/dev/a", "seed": 1}, "--seed: real boards have none"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, message):
    with pytest.raises(OptionError, match=message):
        Options(**words)


def memory(count=3):
    learned = ChangeMemory(np.arange(float(count)), np.eye(count), np.ones(5), np.ones(2), 90)
    return TwinMemory(tuple("abc"[:count]), np.full(count, 0.5), learned)


def block(time):
    nothing = float("nan")
    return Block(time, np.array([1.0, nothing]), np.arange(3.0), np.ones(3), nothing)


def assert_same(one, other):
    for name in ("time", "surprise", "deviations", "sigma", "evidence"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_folder_gives_back_what_was_kept(tmp_path):
    folder = TwinFolder(tmp_path / "twin", new=False)
    assert folder.memory is None and folder.blocks == []
    blocks = [block(float(time)) for time in range(EVERY)]
    named = Named(2.5, Finding("load gripper", 0.1, 0.01, 10.0), "kg")
    folder.add(blocks, memory())
    folder.add_named(named)
    folder.close()
    again = TwinFolder(tmp_path / "twin", new=False)
    (kept,) = again.blocks
    assert_same(kept, blocks[-1])
    assert again.named == [named] and again.began == folder.began
    assert again.memory.names == ("a", "b", "c")
    np.testing.assert_array_equal(again.memory.known, memory().known)
    for one, other in zip(again.memory.learned, memory().learned, strict=True):
        np.testing.assert_array_equal(one, other)
    again.close()
    assert TwinFolder(tmp_path / "twin", new=True).memory is None


def test_a_line_that_was_not_written_to_its_end_is_left_out(tmp_path):
    folder = TwinFolder(tmp_path, new=False)
    folder.add([block(1.0)] * EVERY, memory())
    folder.close()
    path = tmp_path / FOUND
    whole = path.read_text()
    path.write_text(whole + whole.splitlines()[-1][:-40])
    again = TwinFolder(tmp_path, new=False)
    assert len(again.blocks) == 1
    again.add([block(2.0)] * EVERY, memory())
    again.close()
    assert [each.time for each in TwinFolder(tmp_path, new=False).blocks] == [1.0, 2.0]


def test_what_cannot_be_read_is_named(tmp_path):
    (tmp_path / "memory.npz").write_bytes(b"PK\x03\x04 notes")
    with pytest.raises(ExperimentError, match=r"damaged, choose another --out"):
        TwinFolder(tmp_path, new=False)
    (tmp_path / "file").touch()
    with pytest.raises(ExperimentError, match="file"):
        TwinFolder(tmp_path / "file", new=False)


def test_runs_are_counted_on(tmp_path):
    assert next_run(tmp_path) == (1, pytest.approx(float("nan"), nan_ok=True))
    (tmp_path / "run-007.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert next_run(tmp_path)[0] == 8  # noqa: PLR2004
    assert not (tmp_path / "run-007.mcap").exists()
