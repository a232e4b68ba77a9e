"""``view`` as a command, and its page in a browser without a network."""

import re
import time

import numpy as np
import pytest

from tests.experiments import browser
from tests.experiments.live import pages

pytestmark = [
    pytest.mark.skipif(browser.PATH is None, reason="no Chromium; `make test` installs it by apt"),
    pytest.mark.slow,
]
PLACE = re.compile(r"(-?[\d.]+), (-?[\d.]+) m")


@pytest.fixture
def url():
    """Address of a view of the rover that runs as a process of its own."""
    with pages.serving("view", "rover", "--browser") as (_, url):
        yield url


def after(page, seconds):
    """Return the place (2,) [m] once the scene has run on for some time."""
    pages.after(page, seconds)
    text = page.evaluate("document.getElementById('state').textContent")
    return np.array(PLACE.match(text).groups(), dtype=float)


def test_the_rover_moves_while_a_key_is_held(url, tmp_path):
    with browser.Browser(tmp_path) as page:
        page.show(url, 800)
        begin = after(page, 0.2)
        pages.key(page, "keyDown")
        gone = after(page, 2.0)
        assert np.linalg.norm(gone - begin) > 0.1
        pages.key(page, "keyUp")
        stopped = after(page, 0.4)
        assert np.linalg.norm(after(page, 0.5) - stopped) < 0.01
        page.evaluate("document.querySelector('[data-press=pause]').click()")
        paused = pages.shown_time(page)
        time.sleep(1.0)
        assert pages.shown_time(page) - paused < 0.3
        pages.assert_alone(page, url)


def test_it_stops_when_the_browser_is_killed_or_loses_the_focus(url, tmp_path):
    with browser.Browser(tmp_path / "one") as page:
        page.show(url, 800)
        after(page, 0.1)
        pages.key(page, "keyDown")
        moving = pages.after(page, 1.0)
    with browser.Browser(tmp_path / "two") as page:
        page.show(url, 800)
        stopped = after(page, 0.3)
        assert np.linalg.norm(after(page, 0.5) - stopped) < 0.01
        assert pages.shown_time(page) < moving + 2.5  # The same scene, which rested meanwhile.
        pages.key(page, "keyDown")
        after(page, 0.5)
        page.evaluate("window.dispatchEvent(new Event('blur'))")
        stopped = after(page, 0.4)
        assert np.linalg.norm(after(page, 0.5) - stopped) < 0.01


def test_fingers_do_on_a_narrow_page_what_keys_and_mouse_do(url, tmp_path):
    def touch(page, kind, *points):
        named = [{"x": x, "y": y, "id": index} for index, (x, y) in enumerate(points)]
        page.call("Input.dispatchTouchEvent", type=kind, touchPoints=named)

    with browser.Browser(tmp_path) as page:
        page.show(url, 390)
        begin = after(page, 0.2)
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        corner = "document.querySelector('[data-hold=ArrowUp]').getBoundingClientRect()"
        up = page.evaluate(f"[{corner}.x + 9, {corner}.y + 9]")
        touch(page, "touchStart", up)
        gone = after(page, 2.0)
        touch(page, "touchEnd")
        assert np.linalg.norm(gone - begin) > 0.1
        stopped = after(page, 0.4)
        assert np.linalg.norm(after(page, 0.5) - stopped) < 0.01
        page.evaluate("window.told = []; stream.send = each => told.push(JSON.parse(each))")
        touch(page, "touchStart", (150, 100))
        touch(page, "touchMove", (170, 100))
        touch(page, "touchStart", (170, 100), (220, 100))
        touch(page, "touchMove", (120, 100), (220, 100))
        touch(page, "touchEnd")
        told = page.evaluate("told")
        turned, zoomed = (
            [each[name] for each in told if name in each] for name in ("orbit", "zoom")
        )
        assert turned and turned[0][0] > 0.0 and abs(turned[0][1]) < 1e-9
        # From 50 to 100 pixels apart: half as far away.
        assert sum(zoomed) == pytest.approx(-np.log(2.0), abs=0.05)
        assert not any("grab" in each for each in told)
