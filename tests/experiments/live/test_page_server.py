"""The page's server, asked by the client of another library and by a client of plain sockets."""

import http.client
import json
import socket
import time
from typing import TypedDict

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from experiments.harness.contract import OptionError
from experiments.live.page_server import PageServer


class Told(TypedDict, total=False):
    drive: tuple[float, float]


@pytest.fixture
def server(tmp_path):
    page = tmp_path / "page.html"
    page.write_text("<p>here</p>")
    server = PageServer(page, Told)
    yield server
    server.close()


def streamed(server, **options):
    own = f"http://127.0.0.1:{server.port}"
    return connect(
        f"ws://127.0.0.1:{server.port}/stream", **{"origin": own, "proxy": None} | options
    )


def until(condition):
    """Wait until something holds."""
    limit = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.01)


def status(server, **headers):
    """Return the status of a request for the page, and its body."""
    client = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20.0)
    client.request("GET", headers.pop("path", "/"), headers=headers)
    answer = client.getresponse()
    return answer.status, answer.read()


def test_the_page_is_for_its_own_host_and_origin_alone(server):
    assert status(server) == (200, b"<p>here</p>")
    assert status(server, Host=f"localhost:{server.port}")[0] == 200
    assert status(server, Host="elsewhere.example")[0] == 403
    assert status(server, Origin="http://elsewhere.example")[0] == 403
    assert status(server, path="/else")[0] == 404
    shared = status(server, path="/page.js")
    assert shared[0] == 200 and b"tellWhileHeld" in shared[1]
    assert status(server, path="/page.js", Origin="http://elsewhere.example")[0] == 403
    for origin in ("http://elsewhere.example", None):
        with pytest.raises(InvalidStatus):
            streamed(server, origin=origin)


def test_it_listens_on_loopback_alone(server):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        some.connect(("192.0.2.1", 9))  # Sends nothing; it tells the address of this machine.
        address = some.getsockname()[0]
    assert not address.startswith("127.")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((address, server.port), timeout=20.0)


def test_the_newest_image_comes_and_what_a_person_does_goes(server):
    server.show(b"old", {"time": 1.0})
    server.show(b"new", {"time": 2.0})
    with streamed(server) as page:
        assert json.loads(page.recv(20.0)) == {"time": 2.0} and page.recv(20.0) == b"new"
        assert server.watched
        page.send('{"drive": [1, 0]}')
        told = []
        until(lambda: told.extend(server.taken()) or told)
        assert told == [{"drive": (1.0, 0.0)}]
    until(lambda: not server.watched)
    assert server.taken() == [{"closed": True}]


def test_a_page_that_is_opened_later_takes_over(server):
    with streamed(server) as first:
        until(lambda: server.watched)
        with streamed(server) as second:
            with pytest.raises(ConnectionClosed) as closed:
                first.recv(20.0)
            assert closed.value.rcvd.code == 4000
            server.show(b"image", {})
            second.recv(20.0)
            assert second.recv(20.0) == b"image"
            assert server.taken() == []  # The first one's end stops nothing.


@pytest.mark.parametrize(
    "told",
    [
        "no JSON",
        pytest.param("[" * 100_000, id="deep"),
        "[]",
        "null",
        '{"fly": 1}',
        '{"drive": 1}',
        '{"drive": [1]}',
        '{"drive": [NaN, 0]}',
        '{"drive": [1e999, 0]}',
        '{"drive": "ahead"}',
        '{"drive": [null, 0]}',
    ],
)
def test_a_page_that_tells_what_it_may_not_is_closed_and_heard_no_more(server, told):
    with streamed(server) as page:
        page.send(told)
        with pytest.raises(ConnectionClosed) as closed:
            page.recv(20.0)
        assert closed.value.rcvd.code == 4001
    until(lambda: not server.watched)
    assert server.taken() == [{"closed": True}]


def test_a_port_that_is_taken_is_told_in_one_line(server, tmp_path):
    with pytest.raises(OptionError, match=f"--port {server.port}: .*in use"):
        PageServer(tmp_path / "page.html", Told, server.port)


def test_what_is_no_json_ends_the_page(server):
    with streamed(server) as page:
        page.send("{")
        with pytest.raises(ConnectionClosed):
            page.recv(20.0)
    until(lambda: not server.watched)
