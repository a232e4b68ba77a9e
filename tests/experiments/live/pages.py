"""Pages of commands that run in a process of their own, as a person at a browser uses them."""

import contextlib
import re
import subprocess
import sys
import time

TIME = re.compile(r"([\d.]+) s\b")


@contextlib.contextmanager
def serving(*words):
    """Yield the process of a command and the address of its page."""
    command = [sys.executable, "-m", "experiments", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, re.search(r"http://\S+/", process.stdout.readline()).group()
        finally:
            process.kill()


def shown_time(page):
    """Return the time of the scene that the page tells [s]; None before it tells any."""
    found = TIME.search(page.evaluate("document.getElementById('state').textContent"))
    return None if found is None else float(found.group(1))


def after(page, seconds):
    """Return the time once the scene has run on for some time [s]."""
    limit, begin = time.monotonic() + 120.0, None
    while True:
        now = shown_time(page)
        begin = now if begin is None else begin
        if now is not None and now >= begin + seconds:
            return now
        assert time.monotonic() < limit
        time.sleep(0.05)


def key(page, kind, code="ArrowUp"):
    """Press (``keyDown``) or let go (``keyUp``) a key."""
    page.call("Input.dispatchKeyEvent", type=kind, code=code, key=code)


def assert_alone(page, url):
    """Check that a page has asked nobody but its server, and has complained of nothing."""
    requests = [told for name, told in page.events if name == "Network.requestWillBeSent"]
    asked = [each["request"]["url"] for each in requests]
    assert asked and all(each.startswith((url, "blob:", "data:")) for each in asked)
    wrong = ("Log.entryAdded", "Runtime.exceptionThrown")
    assert not [each for each in page.events if each[0] in wrong]
