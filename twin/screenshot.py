"""A picture of the rerun viewer without a screen, for reports and the README."""

import socket
import sys
import time
from pathlib import Path

from rerun.experimental import ViewerClient

_ADVICE = (
    "the viewer needs a graphics driver; on Debian and Ubuntu install mesa-vulkan-drivers "
    "for the software one"
)
_PNG_END = b"IEND\xaeB`\x82"  # Chunk that ends every PNG file.


def screenshot(run: Path, out: Path, at: float | None = None, patience: float = 60.0) -> None:
    """Open a recording in a headless viewer and save what it shows.

    Args:
        run: Recording, ``.rrd``.
        out: Picture to write, ``.png``.
        at: Time on ``sim_time`` to show [s]; None for the end.
        patience: Wall time after which to give up [s].

    Raises:
        FileNotFoundError: If there is no such recording.
        RuntimeError: If the viewer cannot start or show it.
    """
    if not run.is_file():
        raise FileNotFoundError(f"no recording {run}")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.unlink(missing_ok=True)
    deadline = time.monotonic() + patience
    try:
        with _spawn() as viewer:
            _open(viewer, run, deadline)
            # A viewer that follows the latest data would go back there.
            shown = _end(viewer) if at is None else at
            viewer.set_time("sim_time", duration=shown, play_state="paused")
            time.sleep(2.0)  # The viewer decodes images and meshes over several frames.
            viewer.save_screenshot(str(out.resolve()))
            _wait_for(out, deadline)
    except RuntimeError:
        raise
    except Exception as error:
        raise RuntimeError(f"no screenshot of {run}: {error}; {_ADVICE}") from error


def _spawn() -> ViewerClient:
    """Start the viewer of this Python environment, which need not be on the path."""
    beside = Path(sys.executable).parent / "rerun"
    return ViewerClient.spawn(
        headless=True,
        port=_free_port(),
        executable_path=str(beside) if beside.is_file() else None,
    )


def _open(viewer: ViewerClient, run: Path, deadline: float) -> None:
    """Open the recording, once the viewer answers, and wait until it is loaded."""
    while True:
        try:
            viewer.open(run.resolve().as_uri())
            break
        except Exception as error:
            if time.monotonic() > deadline:
                raise RuntimeError(f"the viewer does not answer: {error}; {_ADVICE}") from error
            time.sleep(0.5)
    while viewer.get_state().loading:
        if time.monotonic() > deadline:
            raise RuntimeError(f"the viewer does not finish loading {run}")
        time.sleep(0.2)


def _end(viewer: ViewerClient) -> float:
    """Return the last time on ``sim_time`` [s], or zero if nothing is on it."""
    ends = [
        line.end
        for recording in viewer.get_state().recordings
        for line in recording.timelines
        if line.name == "sim_time" and line.end is not None
    ]
    return max(ends, default=0) * 1e-9


def _wait_for(out: Path, deadline: float) -> None:
    """Wait until the viewer has written the picture to its end: closing it would cut that off."""
    while not (out.is_file() and out.read_bytes().endswith(_PNG_END)):
        if time.monotonic() > deadline:
            raise RuntimeError(f"the viewer did not write {out}; {_ADVICE}")
        time.sleep(0.1)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
