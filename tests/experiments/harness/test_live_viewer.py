"""A recording is shown while it is written: read by another viewer, and in a browser."""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request

import pytest
from rerun.chunk import RrdReader

from experiments.harness import live_viewer
from experiments.harness.live_viewer import LiveViewer
from tests.experiments import browser
from twin.recording.record import Recorder

# What is still written, or was cut off, has no footer yet.
pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")
WEBGL = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader")
PATIENCE = 60.0  # [s]


@pytest.fixture
def recording(tmp_path, monkeypatch):
    """A recording that goes on, and its viewer on a page."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    path = tmp_path / "run.rrd"
    with contextlib.closing(LiveViewer(path)) as viewer, Recorder(path) as recorder:
        yield recorder, viewer


def say(recorder, *words):
    for word in words:
        recorder.log_text("words", word)
    recorder.flush()


def words(path):
    """Return the words in a recording, in order; those that are there of one that is written."""
    found = []
    for chunk in RrdReader(path).stream().to_chunks():
        if str(chunk.entity_path) == "/words":
            found += chunk.to_record_batch().column("TextLog:text").to_pylist()
    return [word for row in found for word in row]


def ports(url):
    """Return the ports of page and data."""
    parts = urllib.parse.urlparse(url)
    (stream,) = urllib.parse.parse_qs(parts.query)["url"]
    return parts.port, urllib.parse.urlparse(stream.removeprefix("rerun+")).port


def until(condition):
    limit = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.1)


def listens(port):
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 5.0):
        return True
    return False


@contextlib.contextmanager
def client(url, path):
    """Let another viewer write to a file what it is sent."""
    until(lambda: listens(ports(url)[1]))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        own = probe.getsockname()[1]
    command = [live_viewer._viewer(), "--save", path, "--bind", "127.0.0.1", "--port", str(own)]
    stream = f"rerun+http://127.0.0.1:{ports(url)[1]}/proxy"
    quiet = os.environ | {"CI": "1", "RUST_LOG": "error"}
    with subprocess.Popen([*command, stream], env=quiet) as process:
        yield
        process.kill()


def received(url, path):
    """Return the words that a viewer gets that comes now."""
    with client(url, path):
        until(path.exists)
        time.sleep(1.0)
    return words(path)


@pytest.mark.slow
def test_what_is_recorded_so_far_is_there_for_a_viewer_that_comes(recording, tmp_path):
    recorder, viewer = recording
    say(recorder, "one", "two")
    until(lambda: received(viewer.url, tmp_path / "a.rrd") == ["one", "two"])
    say(recorder, "three")
    until(lambda: received(viewer.url, tmp_path / "b.rrd") == ["one", "two", "three"])
    recorder.close()
    viewer.finish()
    assert received(viewer.url, tmp_path / "c.rrd") == ["one", "two", "three"]


@pytest.mark.slow
def test_all_that_it_listens_at_is_on_loopback_alone(recording):
    recorder, viewer = recording
    say(recorder, "one")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        some.connect(("192.0.2.1", 9))  # Sends nothing; it tells the address of this machine.
        address = some.getsockname()[0]
    for port in (*ports(viewer.url), viewer._source):
        until(lambda port=port: listens(port))
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((address, port), timeout=20.0)


def test_a_viewer_that_is_gone_changes_nothing(recording, tmp_path):
    recorder, viewer = recording
    say(recorder, "one")
    until(lambda: viewer._begun)
    viewer._process.kill()
    viewer._process.wait()
    for word in ("two", "three"):
        say(recorder, word)
        time.sleep(0.2)
    recorder.close()
    viewer.finish()
    viewer.stay()  # There is nothing to wait for.
    assert words(tmp_path / "run.rrd") == ["one", "two", "three"]
    assert not viewer._relay.is_alive()


def test_a_window_that_cannot_open_changes_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":4095")
    path = tmp_path / "run.rrd"
    with contextlib.closing(LiveViewer(path)) as viewer, Recorder(path) as recorder:
        arguments = viewer._process.args
        assert "--serve-web" not in arguments and not viewer.url
        assert arguments[arguments.index("--bind") + 1] == "127.0.0.1"
        say(recorder, "one")
        until(lambda: viewer._process.poll() is not None)
        say(recorder, "two")
    viewer.finish()
    assert words(path) == ["one", "two"] and not viewer._relay.is_alive()


def test_a_run_that_records_nothing_leaves_no_page(tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    viewer = LiveViewer(tmp_path / "run.rrd")
    (tmp_path / "run.rrd").write_bytes(bytes(1000))  # As a recorder checks for space.
    viewer.finish()
    viewer.stay()
    viewer.close()
    assert viewer._process.poll() is not None and not listens(ports(viewer.url)[0])


@pytest.mark.slow
@pytest.mark.skipif(browser.PATH is None, reason="no Chromium; `make test` installs it by apt")
def test_the_page_shows_it_and_asks_nobody_else(recording, tmp_path):
    recorder, viewer = recording
    say(recorder, "one")
    until(lambda: listens(viewer._source))
    with browser.Browser(tmp_path / "profile", WEBGL) as page:
        page.show(viewer.url, 1280)
        events = page.events

        def told(name):
            page.evaluate("1")
            return [parameters for event, parameters in events if event == name]

        def stream():
            """Return the identifiers of requests for data that were answered."""
            answers = told("Network.responseReceived")
            good = [each for each in answers if each["response"]["status"] == 200]
            return [each["requestId"] for each in good if "ReadMessages" in each["response"]["url"]]

        def got():
            asked = stream()
            parts = told("Network.dataReceived")
            return sum(each["dataLength"] for each in parts if each["requestId"] in asked)

        until(lambda: got() > 0)
        before = got()
        say(recorder, os.urandom(10_000).hex())  # No compression makes this shorter than it is.
        until(lambda: got() > before + 10_000)
        time.sleep(2.0)
        answered = [each["response"]["url"] for each in told("Network.responseReceived")]
        assert all(each.startswith(("http://127.0.0.1:", "blob:", "data:")) for each in answered)
        elsewhere = {
            each["requestId"]
            for each in told("Network.requestWillBeSent")
            if not each["request"]["url"].startswith(("http://127.0.0.1:", "blob:", "data:"))
        }
        blocked = {
            each["requestId"]
            for each in told("Network.loadingFailed")
            if each.get("blockedReason") == "csp"
        }
        assert elsewhere <= blocked


@pytest.mark.parametrize("headers", [{"Host": "elsewhere.example"}, {"Origin": "http://x.example"}])
def test_the_page_refuses_other_sites(headers):
    page = live_viewer.ViewerPage(9, 9)
    try:
        request = urllib.request.Request(f"http://127.0.0.1:{page.port}/", headers=headers)
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request)
        own = f"http://127.0.0.1:{page.port}/"
        with pytest.raises(urllib.error.HTTPError, match="502"):  # Nobody serves at port 9.
            urllib.request.build_opener(urllib.request.ProxyHandler({})).open(own)
    finally:
        page.close()


@pytest.mark.slow
def test_an_experiment_is_shown_until_ctrl_c_and_its_results_are_there(tmp_path):
    command = [sys.executable, "-m", "tests.experiments.harness.tiny", "tiny", "--live"]
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    with subprocess.Popen(
        [*command, "--out", str(tmp_path)], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        lines = iter(process.stdout.readline, "")
        shown = next(line for line in lines if "the recording stays at" in line)
        url = re.search(r"http://\S+", shown).group()
        assert (tmp_path / "tiny" / "metrics.json").is_file()
        assert received(url, tmp_path / "a.rrd") == ["first", "last"]
        assert words(tmp_path / "tiny" / "run.rrd") == ["first", "last"]
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
        assert not any(map(listens, ports(url)))
