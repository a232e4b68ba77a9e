"""``drive`` as a command, and its page in a browser without a network.

Where the rover truly was comes from the recording: the page shows what it observes.
"""

import dataclasses
import signal
import socket

import numpy as np
import pytest
from rerun.chunk import RrdReader

from tests.experiments import browser
from tests.experiments.live import pages
from twin.logs.mapping import read_log

pytestmark = [
    pytest.mark.skipif(browser.PATH is None, reason="no Chromium; `make test` installs it by apt"),
    pytest.mark.slow,
    pytest.mark.real_time,
]
HELD, RESTS = 1.0, 0.8  # Robot time for which something is held, and for which it is let go [s].
STOP = 0.3  # Robot time within which the rover stops [s].
NOW = "parseFloat(document.getElementById('state').textContent)"
EYES = """(() => {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [102, 49];
  const small = canvas.getContext("2d");
  small.drawImage(document.getElementById("eyes"), 0, 0, 102, 49);
  return [...small.getImageData(0, 0, 102, 49).data].filter((_, index) => index % 4 === 0);
})()"""
PAD = """navigator.getGamepads = () => [{ mapping: "standard", axes: [0, -1, 0, 0],
  buttons: Array.from({ length: 17 }, (_, button) => ({ pressed: %s && button === 4 })) }]; """


@dataclasses.dataclass
class Driven:
    """What a person did, and what became of it.

    Attributes:
        held: Robot times at which each way of driving began and ended, by its name [s].
        eyes: Images (49, 102) of both eyes before and after the first drive.
        joint: Angle of the arm's first joint before and after its key was held [rad].
        times: (n,) robot times of `places` [s].
        places: (n, 2) true places [m].
        ticks: (m,) robot times of `speeds` [s].
        speeds: (m, 4) measured wheel speeds [rad/s].
        logged: The same from the log.
        status: Exit status of the command after Ctrl+C.
    """

    held: dict
    eyes: list
    joint: list
    times: np.ndarray
    places: np.ndarray
    ticks: np.ndarray
    speeds: np.ndarray
    logged: np.ndarray
    status: int


def eyes(page):
    return np.array(page.evaluate(EYES), dtype=float).reshape(49, 102)


def first_joint(page):
    rows = "[...document.getElementById('sensors').rows]"
    row = f"{rows}.find(row => row.cells[0].textContent === 'arm angles')"
    return float(page.evaluate(f"{row}.cells[1].textContent").split()[0])


def note(page, event):
    """Let the page keep the robot time that it shows at each such event [s]."""
    page.evaluate(f"addEventListener({event!r}, () => {{ window.ended = {NOW}; }}, true)")


def held(page, begin, end):
    """Hold something for a while; return from when to when [s]."""
    begun = pages.shown_time(page)
    begin()
    pages.after(page, HELD)
    ended = end()
    pages.after(page, RESTS)
    return begun, page.evaluate("window.ended") if ended is None else ended


def held_key(page, code):
    return held(
        page, lambda: pages.key(page, "keyDown", code), lambda: pages.key(page, "keyUp", code)
    )


def columns(path, entity, component):
    """Return times and values of a component in a recording."""
    times, values = [], []
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == entity and component in batch.schema.names:
            times += [each.total_seconds() for each in batch.column("sim_time").to_pylist()]
            values += batch.column(component).to_pylist()
    return np.array(times), np.array(values)


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A drive that ends with a killed browser, and then with Ctrl+C."""
    folder = tmp_path_factory.mktemp("drive")
    path = folder / "run.rrd"
    spans = {}
    log = folder / "run.mcap"
    told = pages.serving("drive", "--speed", 0.2, "--record", path, "--log", log)
    with told as (process, url):
        with browser.Browser(folder / "one") as page:
            page.show(url, 390)
            pages.after(page, 0.5)
            for event in ("keyup", "pointerup", "blur", "visibilitychange"):
                note(page, event)
            seen = [eyes(page)]
            spans["key"] = held_key(page, "ArrowUp")
            seen.append(eyes(page))
            where = page.evaluate(
                "(r => ({ x: r.x + 9, y: r.y + 9 }))(document.querySelector("
                "'[data-hold=ArrowUp]').getBoundingClientRect())"
            )

            def mouse(kind):
                page.call(
                    "Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **where
                )

            spans["button"] = held(
                page, lambda: mouse("mousePressed"), lambda: mouse("mouseReleased")
            )
            spans["gamepad"] = held(
                page,
                lambda: page.evaluate(PAD % "true"),
                lambda: page.evaluate(PAD % "false" + NOW),
            )
            for name, lost in (
                ("focus", "window.dispatchEvent(new Event('blur'))"),
                ("hidden", "document.dispatchEvent(new Event('visibilitychange'))"),
            ):
                spans[name] = held(
                    page,
                    lambda: pages.key(page, "keyDown"),
                    lambda lost=lost: page.evaluate(f"{lost}; window.ended"),
                )
                pages.key(page, "keyUp")
            joint = [first_joint(page)]
            held_key(page, "KeyR")
            joint.append(first_joint(page))
            begun = pages.shown_time(page)
            pages.key(page, "keyDown")
            pages.after(page, HELD)
            pages.assert_alone(page, url)
            spans["killed"] = begun, page.evaluate(NOW)
        # The browser is dead by now; another one shows that the robot goes on.
        with browser.Browser(folder / "two") as page:
            page.show(url, 1280)
            pages.after(page, RESTS)
        process.send_signal(signal.SIGINT)
        status = process.wait(30.0)
    times, places = columns(path, "/world/rover1/chassis", "Transform3D:translation")
    ticks, speeds = columns(path, "/rover1/sensors/wheel_speeds", "Scalars:scalars")
    logged = read_log(log).signals["rover1/wheel_speeds"].values
    places = places.reshape(-1, 3)[:, :2]
    return Driven(spans, seen, joint, times, places, ticks, speeds, logged, status)


@pytest.mark.parametrize("way", ["key", "button", "gamepad", "focus", "hidden", "killed"])
def test_it_drives_while_held_and_stops_when_it_is_let_go(driven, way):
    begin, end = driven.held[way]
    place = {
        name: driven.places[np.searchsorted(driven.times, time)]
        for name, time in {
            "begin": begin,
            "end": end,
            "stop": end + STOP,
            "rest": end + 0.6,
        }.items()
    }
    assert np.linalg.norm(place["end"] - place["begin"]) > 0.1
    assert np.linalg.norm(place["rest"] - place["stop"]) < 0.003
    rests = (driven.ticks > end + STOP) & (driven.ticks < end + 0.6)
    assert rests.any() and np.abs(driven.speeds[rests]).max() < 0.3


def test_both_eyes_see_it_drive(driven):
    before, later = driven.eyes
    for eye in np.hsplit(np.abs(later - before), 2):
        assert eye.mean() > 5.0


def test_a_key_moves_the_arm(driven):
    begin, end = driven.joint
    assert end - begin == pytest.approx(0.4 * HELD, abs=0.15)


def test_ctrl_c_ends_it_well(driven):
    assert driven.status == 0


def test_log_and_recording_hold_the_same(driven):
    np.testing.assert_array_equal(driven.logged, driven.speeds.reshape(-1, 4))


def test_the_page_is_on_loopback_alone_and_refuses_another_origin():
    with pages.serving("drive") as (_, url):
        port = int(url.rstrip("/").rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), 20.0) as line:
            host, origin = f"Host: 127.0.0.1:{port}", "Origin: http://elsewhere.example"
            line.sendall(f"GET / HTTP/1.1\r\n{host}\r\n{origin}\r\n\r\n".encode())
            assert b" 403 " in line.recv(100)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
            some.connect(("192.0.2.1", 9))  # Sends nothing; it tells the address of this machine.
            address = some.getsockname()[0]
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((address, port), timeout=20.0)
