"""The control line of the emulator's process, and what its host does when it falls silent."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from tests.twin.hardware.board_tables import PERIOD
from twin.hardware.emulator.__main__ import LONGEST_ORDER
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import SceneConfig
from twin.hardware.serial_link import LinkError

COMMAND = [sys.executable, "-m", "twin.hardware.emulator"]
ROBOT = "rover1"


@pytest.fixture(scope="module")
def emulator():
    process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
    with process:
        json.loads(process.stdout.readline())
        yield process


def say(process, data):
    process.stdin.write(data)
    return json.loads(process.stdout.readline())


def ticked(process):
    """The time after one more tick."""
    return say(process, b'{"do": "tick"}\n')["time"]


FAULT = b'{"do": "fault", "robot": "rover1", "time": 0, "kind": "e_stop", %s}\n'
GARBAGE = {
    b"\x00\xff\xfe garbage\n": "no JSON",
    b"\n": "no JSON",
    b'{"do": "ti\n': "no JSON",
    b"[" * 3000 + b"\n": "no JSON",
    b"17\n": "unknown order 17",
    b"[]\n": "unknown order",
    b'{"tick": 1}\n': "expected do: tick, run, fault or state",
    b'{"do": ["tick"]}\n': "unknown order",
    b'{"do": "tock"}\n': "unknown order",
    b'{"do": "tick"' + b" " * LONGEST_ORDER + b"}\n": f"more than {LONGEST_ORDER} bytes",
    b'{"do": "fault"}\n': "time is missing",
    FAULT % b'"duration": NaN': "duration is nan",
    FAULT % b'"duration": "long"': "duration is 'long', needs a number",
    FAULT % b'"duration": -1': "duration is -1.0, needs seconds, 0 or more",
    FAULT % b'"address": 128.5': "address is 128.5, needs a whole number",
    FAULT % b'"address": 3': "no motor board 0x3",
    FAULT % b'"colour": "red"': "colour is unknown",
    FAULT % b'"kind": 7': "kind is 7, needs a text",
    FAULT % b'"robot": null': "robot is None, needs a text",
}


@pytest.mark.parametrize("line", GARBAGE, ids=lambda line: line[:30].decode("latin-1"))
def test_line_that_is_no_order_is_answered_and_changes_nothing(emulator, line):
    before = ticked(emulator)
    assert GARBAGE[line] in say(emulator, line)["error"]
    state = say(emulator, b'{"do": "state"}\n')[ROBOT]
    assert ticked(emulator) == pytest.approx(before + PERIOD)
    assert not any(state["codes"])


def test_order_in_pieces_is_obeyed_once_when_it_is_whole(emulator):
    before = ticked(emulator)
    for piece in (b'{"do"', b': "ti', b'ck"}'):
        emulator.stdin.write(piece)
        time.sleep(0.02)
    assert say(emulator, b"\n")["time"] == pytest.approx(before + PERIOD)


def test_two_orders_at_once_are_answered_one_after_the_other(emulator):
    before = ticked(emulator)
    first = say(emulator, b'{"do": "tick"}\n{"do": "tick"}\n')["time"]
    second = json.loads(emulator.stdout.readline())["time"]
    assert (first, second) == pytest.approx((before + PERIOD, before + 2 * PERIOD))


def test_line_without_end_is_answered_once_and_forgotten(emulator):
    before = ticked(emulator)
    assert "more than" in say(emulator, b"x" * (LONGEST_ORDER + 1))["error"]
    for _ in range(40):
        emulator.stdin.write(b"x" * LONGEST_ORDER)
    emulator.stdin.write(b"\n")
    assert ticked(emulator) == pytest.approx(before + PERIOD)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (b"\x00\xff", "no JSON"),
        (b"", "no JSON"),
        (b"[" * 20_000, "no JSON"),
        (b" " * 2**15 + b"[]", "too large: 32,770 bytes, the limit is 32,768"),
        (b"{}", "expected a list of faults"),
        (b"[7]", "7 is no table with time and kind"),
        (b'[{"time": 1.0, "kind": "rust"}]', "kind 'rust'; expected one of bus_silent, "),
        (b'[{"time": "soon", "kind": "e_stop"}]', "time is 'soon', needs a number"),
        (b'[{"time": 1, "kind": "e_stop", "robot": "x"}]', "fault of robot 'x': there are rover1"),
    ],
)
def test_malformed_schedule_is_one_line_before_anything_starts(tmp_path, words, message):
    path = tmp_path / "faults.json"
    path.write_bytes(words)
    ended = subprocess.run(
        [*COMMAND, "--faults", path], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2 and not ended.stdout
    assert message in ended.stderr and ended.stderr.count("\n") == 1


def test_host_gives_up_on_an_emulator_that_stops_answering():
    with contextlib.closing(EmulatorProcess(SceneConfig())) as emulator:
        emulator._patience = 0.3
        os.kill(emulator._process.pid, signal.SIGSTOP)
        begin = time.monotonic()
        with pytest.raises(LinkError, match="did not answer within 0.3 s"):
            emulator.tick()
        assert time.monotonic() - begin < 5.0
        os.kill(emulator._process.pid, signal.SIGCONT)


HOST = """
import time
from models.compose import RobotPlacement
from twin.camera import StereoConfig
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import SceneConfig
scene = SceneConfig((RobotPlacement("rover1"),), stereo=StereoConfig())
EmulatorProcess(scene, realtime=True)
print(flush=True)
time.sleep(60.0)
"""


def children(pid):
    """All processes below one, however deep."""
    with open(f"/proc/{pid}/task/{pid}/children") as stream:
        own = [int(word) for word in stream.read().split()]
    return own + [below for each in own for below in children(each)]


@pytest.mark.slow
def test_emulator_and_its_drawing_process_end_with_a_host_that_is_killed():
    host = subprocess.Popen([sys.executable, "-c", HOST], stdout=subprocess.PIPE)
    with host:
        host.stdout.readline()
        below = children(host.pid)
        assert len(below) >= 2
        host.kill()
    end = time.monotonic() + 5.0
    while any(alive(pid) for pid in below) and time.monotonic() < end:
        time.sleep(0.02)
    assert not [pid for pid in below if alive(pid)]


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
