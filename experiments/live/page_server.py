"""A page in the browser that shows images and tells what a person does; on loopback alone."""

import json
import math
import threading
from collections.abc import Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Any

import cattrs
import cv2
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from experiments.harness.contract import OptionError
from perception.geometry.arrays import ImageArray

HOST = "127.0.0.1"
_POLICY = "default-src 'self' 'unsafe-inline' blob: data:; frame-ancestors 'none'"
_REPLACED = 4000  # Code that closes a page for a newer one.
_UNKNOWN = 4001  # Code that closes a page that tells what it may not.
_QUALITY = 80  # Of JPEGs.
_Shown = tuple[str, bytes]
_SHARED = {"page.css": "text/css", "page.js": "text/javascript"}  # What all pages use.


def _finite(value: Any, _: type) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError("not finite")
    return number


_CONVERTER = cattrs.Converter(forbid_extra_keys=True)
_CONVERTER.register_structure_hook(float, _finite)


class PageServer:
    """One page at a time: images go to it, newest first, and what a person does comes from it.

    A page that is opened later takes over. Pages of other sites are refused, as are requests that
    name another host, so that no site can reach this one under a name of its own.

    Args:
        page: File of the page, which may use ``page.css`` and ``page.js`` of this folder.
        told: `TypedDict` of what the page may tell; a page that tells anything else is closed.
        port: Port on loopback; 0 for a free one.

    Attributes:
        port: Port that it listens on.
        watched: Whether a page is open.

    Raises:
        OptionError: If the port is taken.
    """

    def __init__(self, page: Path, told: type, port: int = 0) -> None:
        self._kind = told
        self._files = {"/": (page.read_bytes(), "text/html")}
        for name, kind in _SHARED.items():
            self._files[f"/{name}"] = Path(__file__).with_name(name).read_bytes(), kind
        self._changed = threading.Condition()
        self._shown: _Shown | None = None
        self._connection: ServerConnection | None = None
        self._taken: list[Mapping[str, Any]] = []
        # The free port has to be known before what it serves can be told from other sites'.
        self._hosts: set[str] = set()
        try:
            self._server = serve(
                self._attend, HOST, port, process_request=self._answer, compression=None
            )
        except OSError as error:
            raise OptionError(f"--port {port}: {error.strerror}") from error
        self.port: int = self._server.socket.getsockname()[1]
        self._hosts = {f"{name}:{self.port}" for name in (HOST, "localhost")}
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.port}/"

    @property
    def watched(self) -> bool:
        """Whether a page is open."""
        return self._connection is not None

    def show(self, image: bytes, about: Mapping[str, Any]) -> None:
        """Show an image in place of the one before.

        Args:
            image: JPEG.
            about: What the page tells beside it; JSON.
        """
        with self._changed:
            self._shown = json.dumps(about), image
            self._changed.notify_all()

    def taken(self) -> list[Mapping[str, Any]]:
        """Return what the page told since the last call, in order; ``closed`` when it is gone."""
        with self._changed:
            taken, self._taken = self._taken, []
        return taken

    def close(self) -> None:
        """Close page and port."""
        self._server.shutdown()
        with self._changed:
            connection, self._connection = self._connection, None
            self._changed.notify_all()
        if connection is not None:
            connection.close()
        self._thread.join()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request; None lets one for the stream go on."""
        host, origin = request.headers.get("Host"), request.headers.get("Origin")
        asking = host if origin is None else origin.removeprefix("http://")
        if not {host, asking} <= self._hosts:
            return connection.respond(HTTPStatus.FORBIDDEN, "This page is for its host alone.\n")
        if request.path == "/stream" and origin:
            return None
        if request.path not in self._files:
            return connection.respond(HTTPStatus.NOT_FOUND, f"There is no {request.path} here.\n")
        content, kind = self._files[request.path]
        headers = Headers(
            {
                "Content-Type": f"{kind}; charset=utf-8",
                "Content-Length": str(len(content)),
                "Content-Security-Policy": f"{_POLICY}; connect-src ws://{host}",
                "Cache-Control": "no-store",
                "Connection": "close",
            }
        )
        return Response(HTTPStatus.OK, "OK", headers, content)

    def _attend(self, connection: ServerConnection) -> None:
        """Serve the stream of one page."""
        with self._changed:
            before, self._connection = self._connection, connection
            self._changed.notify_all()
        if before is not None:
            before.close(_REPLACED, "shown on another page")
        sender = threading.Thread(target=self._send, args=(connection,), daemon=True)
        sender.start()
        try:
            for message in connection:
                self._take(connection, _CONVERTER.structure(json.loads(message), self._kind))
        except (ValueError, RecursionError, cattrs.BaseValidationError):
            connection.close(_UNKNOWN, "the page told what it may not")
        except ConnectionClosed:
            connection.close()
        self._take(connection, {"closed": True})
        with self._changed:
            if self._connection is connection:
                self._connection = None
            self._changed.notify_all()
        sender.join()

    def _take(self, connection: ServerConnection, told: Mapping[str, Any]) -> None:
        """Keep what a page told, if none has taken over."""
        with self._changed:
            if self._connection is connection:
                self._taken.append(told)

    def _send(self, connection: ServerConnection) -> None:
        """Send what is shown as long as the page is open; what it has no time for is left out."""
        shown = self._next(connection, None)
        while shown is not None:
            about, image = shown
            try:
                connection.send(about)
                connection.send(image)
            except ConnectionClosed:
                return
            shown = self._next(connection, shown)

    def _next(self, connection: ServerConnection, sent: _Shown | None) -> _Shown | None:
        """Wait for what a page has not been sent yet; return None once it is closed."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._connection is not connection or self._shown is not sent
            )
            return self._shown if self._connection is connection else None


def jpeg(image: ImageArray) -> bytes:
    """Return a JPEG of grey levels (height, width), or (height, width, 3) red, green and blue."""
    ordered = image if image.ndim == 2 else image[..., ::-1]  # noqa: PLR2004
    _, coded = cv2.imencode(".jpg", ordered, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return coded.tobytes()
