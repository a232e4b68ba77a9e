"""The rerun viewer beside a run, which shows a recording while it is written."""

import contextlib
import importlib.util
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.parse
from collections.abc import Generator
from pathlib import Path
from typing import IO, cast

from rich.console import Console

from experiments.harness.viewer_page import HOST, ViewerPage

_BEGINNING = b"RRF2"  # Of every recording; what stands there before is not one.
_LOOK = 0.05  # Wall time between two looks at the file [s].
_PATIENCE = 20.0  # Longest wait for a page that is to be served, or a viewer that is to read [s].
_PART = 1 << 16  # Largest part of the file that is handed on at once [byte].
# The viewer would send usage statistics; it sends none where tests run.
_QUIET = {"CI": "1", "RUST_LOG": "error"}
_ENDING = """
import os, sys
from twin.hardware.background import end_with_parent
end_with_parent(int(sys.argv[1]))
os.execv(sys.argv[2], sys.argv[2:])
"""


def has_display() -> bool:
    """Return whether windows can be shown."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class LiveViewer:
    """Shows a recording as its file grows: in a window, or on a page where there is no display.

    The viewer gets what is in the file, whoever writes it. One that is slow, closed or gone changes
    nothing about the run. It listens on loopback alone: the SDK's own servers (`rerun.serve_grpc`,
    `rerun.serve_web_viewer`, `rerun.spawn`) listen on all interfaces.

    Args:
        path: File of the recording, ``.rrd``, which need not be there yet.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._over = path, threading.Event()
        self._begun = False
        ports = _free_ports()
        command = [str(_viewer()), "--bind", HOST, "--port", str(ports[0]), "-"]
        self.url, self._source = "", ports[1]
        self._page = None if has_display() else ViewerPage(source=ports[1], stream=ports[0])
        if self._page is not None:
            command += ["--serve-web", "--web-viewer-port", str(ports[1])]
            command = [sys.executable, "-c", _ENDING, str(os.getpid()), *command]
            stream = urllib.parse.quote(f"rerun+http://{HOST}:{ports[0]}/proxy", safe="")
            self.url = f"http://{HOST}:{self._page.port}/?url={stream}"
        # In a session of its own: Ctrl+C ends the run, and the run the page.
        self._process = subprocess.Popen(  # noqa: S603
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env=os.environ | _QUIET,
            start_new_session=True,
        )
        self._relay = threading.Thread(target=self._hand_on, name="live viewer", daemon=True)
        self._relay.start()

    def finish(self) -> None:
        """Hand on the rest of the file; nothing is written to it any more."""
        self._over.set()
        self._relay.join(_PATIENCE)

    def stay(self) -> None:
        """Wait for Ctrl+C, if the recording is shown on a page; a window stays by itself."""
        if not (self.url and self._begun and self._process.poll() is None):
            return
        with contextlib.suppress(KeyboardInterrupt):
            Console().print(f"the recording stays at {self.url} until Ctrl+C", soft_wrap=True)
            self._process.wait()

    def close(self) -> None:
        """End the page; a window stays as long as its user likes."""
        self._over.set()
        if self._page is not None:
            self._page.close()
            self._process.kill()
            self._process.wait()

    def _hand_on(self) -> None:
        """Copy the file to the viewer as it grows, in a thread of its own."""
        viewer = cast("IO[bytes]", self._process.stdin)
        with contextlib.suppress(BrokenPipeError), viewer:
            for part in self._parts():
                viewer.write(part)
                viewer.flush()
                if not self._begun:
                    self._begun = True
                    self._announce()

    def _parts(self) -> Generator[bytes]:
        """Yield the file as it grows, until it does no more."""
        while not _is_begun(self._path):
            if self._over.wait(_LOOK) and not _is_begun(self._path):
                return
        with self._path.open("rb") as file:
            while True:
                over = self._over.is_set()  # Asked before the end of the file is found.
                if part := file.read(_PART):
                    yield part
                elif over:
                    return
                else:
                    self._over.wait(_LOOK)

    def _announce(self) -> None:
        """Say where the page is, once it is there: it is served from the first data on."""
        if not self.url:
            return
        end = time.monotonic() + _PATIENCE
        while time.monotonic() < end and self._process.poll() is None:
            with contextlib.suppress(OSError), socket.create_connection((HOST, self._source), 1.0):
                Console().print(f"recording: open {self.url} in a browser", soft_wrap=True)
                return
            time.sleep(_LOOK)


def _viewer() -> Path:
    """Return the viewer of the installed SDK; its command is a script, which would outlive it."""
    spec = importlib.util.find_spec("rerun_cli")
    assert spec is not None and spec.origin is not None
    return Path(spec.origin).with_name("rerun")


def _is_begun(path: Path) -> bool:
    with contextlib.suppress(OSError), path.open("rb") as file:
        return file.read(len(_BEGINNING)) == _BEGINNING
    return False


def _free_ports() -> tuple[int, int]:
    with socket.socket() as one, socket.socket() as other:
        for probe in (one, other):
            probe.bind((HOST, 0))
        return one.getsockname()[1], other.getsockname()[1]
