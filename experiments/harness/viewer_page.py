"""The page of the rerun viewer, kept from asking anybody else than this machine."""

import http.client
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

HOST = "127.0.0.1"
_PATIENCE = 60.0  # Longest wait for the viewer's own server [s].
_POLICY = (
    "default-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; frame-ancestors 'none'"
)


class ViewerPage:
    """Serves what the viewer's own server does, on loopback alone and to its own page alone.

    The viewer's page would load a font and send usage statistics; a content security policy keeps
    it from both.

    Args:
        source: Port of the viewer's own server on loopback.
        stream: Port of its data on loopback.

    Attributes:
        port: Port of the page.
    """

    def __init__(self, source: int, stream: int) -> None:
        self._source = source
        self._policy = f"{_POLICY}; connect-src 'self' http://{HOST}:{stream}"
        answer = self._answer

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:  # noqa: N802
                answer(self)

            def log_message(self, format: str, *args: object) -> None:  # noqa: A002
                """Say nothing."""

        self._server = ThreadingHTTPServer((HOST, 0), Handler)
        self.port = int(self._server.server_port)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the page's port."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _answer(self, asked: BaseHTTPRequestHandler) -> None:
        """Hand on one file of the viewer's."""
        host = f"{HOST}:{self.port}"
        own = f"http://{host}"
        if asked.headers.get("Host") != host or asked.headers.get("Origin", own) != own:
            asked.send_error(HTTPStatus.FORBIDDEN, "This page is for its host alone")
            return
        line = http.client.HTTPConnection(HOST, self._source, timeout=_PATIENCE)
        try:
            line.request("GET", asked.path)
            answer = line.getresponse()
            content = answer.read()
        except OSError:
            asked.send_error(HTTPStatus.BAD_GATEWAY, "The viewer is gone")
            return
        finally:
            line.close()
        asked.send_response(answer.status)
        asked.send_header("Content-Type", answer.getheader("Content-Type", "text/plain"))
        asked.send_header("Content-Length", str(len(content)))
        asked.send_header("Content-Security-Policy", self._policy)
        asked.end_headers()
        asked.wfile.write(content)
