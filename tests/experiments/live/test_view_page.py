"""``view`` as a command, and its page in a browser without a network."""

import re
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.experiments import browser

pytestmark = pytest.mark.skipif(
    browser.PATH is None, reason="no Chromium; `make test` installs it by apt"
)
PLACE = re.compile(r"(-?[\d.]+), (-?[\d.]+) m, ([\d.]+) s")


@pytest.fixture
def url():
    """Address of a view of the rover that runs as a process of its own."""
    command = [sys.executable, "-m", "experiments", "view", "rover", "--browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield re.search(r"http://\S+/", process.stdout.readline()).group()
        process.kill()


def state(page):
    """Return place (2,) [m] and time [s] that the page tells."""
    found = PLACE.match(page.evaluate("document.getElementById('state').textContent"))
    return None if found is None else np.array(found.groups(), dtype=float)


def after(page, seconds):
    """Return the state once the scene has run on for some time."""
    limit, begin = time.monotonic() + 60.0, None
    while True:
        now = state(page)
        begin = now if begin is None else begin
        if now is not None and now[2] >= begin[2] + seconds:
            return now
        assert time.monotonic() < limit
        time.sleep(0.05)


def key(page, kind):
    page.call("Input.dispatchKeyEvent", type=kind, code="ArrowUp", key="ArrowUp")


@pytest.mark.slow
def test_the_rover_moves_while_a_key_is_held(url, tmp_path):
    with browser.Browser(tmp_path) as page:
        page.show(url, 800)
        begin = after(page, 0.2)
        key(page, "keyDown")
        gone = after(page, 2.0)
        assert np.linalg.norm((gone - begin)[:2]) > 0.1
        key(page, "keyUp")
        stopped = after(page, 0.4)
        assert np.linalg.norm((after(page, 0.5) - stopped)[:2]) < 0.01
        page.evaluate("document.querySelector('[data-press=pause]').click()")
        paused = state(page)
        time.sleep(1.0)
        assert state(page)[2] - paused[2] < 0.3
        requests = [told for name, told in page.events if name == "Network.requestWillBeSent"]
        asked = [each["request"]["url"] for each in requests]
        assert all(each.startswith((url, "blob:", "data:")) for each in asked)
        wrong = ("Log.entryAdded", "Runtime.exceptionThrown")
        assert not [each for each in page.events if each[0] in wrong]


@pytest.mark.slow
def test_it_stops_when_the_browser_is_killed_or_loses_the_focus(url, tmp_path):
    with browser.Browser(tmp_path / "one") as page:
        page.show(url, 800)
        after(page, 0.1)
        key(page, "keyDown")
        moving = after(page, 1.0)
    with browser.Browser(tmp_path / "two") as page:
        page.show(url, 800)
        stopped = after(page, 0.3)
        assert np.linalg.norm((after(page, 0.5) - stopped)[:2]) < 0.01
        assert stopped[2] < moving[2] + 1.5  # The same scene, which rested meanwhile.
        key(page, "keyDown")
        after(page, 0.5)
        page.evaluate("window.dispatchEvent(new Event('blur'))")
        stopped = after(page, 0.4)
        assert np.linalg.norm((after(page, 0.5) - stopped)[:2]) < 0.01
