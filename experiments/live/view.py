"""``fieldtwin view``: a scene in MuJoCo's viewer, or on a page in the browser.

MuJoCo's own web viewer listens on all interfaces and cannot be told otherwise, so the page is ours.
"""

import importlib
import time
from pathlib import Path

import mujoco
from rich.console import Console

from experiments.harness.live_viewer import has_display
from experiments.live.page_server import PageServer
from experiments.live.subjects import model_of
from experiments.live.touched_scene import SceneTold, TouchedScene
from experiments.live.view_options import Options

PAGE = Path(__file__).with_name("view.html")
_SIZE = (800, 500)  # Of the images [px].
_PERIOD = 1.0 / 25.0  # Between images [s].
_IDLE = 0.1  # Between looks whether a page was opened [s].
_MOST = 0.1  # Time of the scene between images [s]: what takes longer slows the scene down.


def run(options: Options) -> int:
    """Show the scene until the window is closed or Ctrl+C is pressed; return the exit status."""
    model = model_of(options.subject, options.seed)
    if has_display() and not options.browser:
        # Imported here because it loads what windows need.
        importlib.import_module("mujoco.viewer").launch(model, _at_home(model))
        return 0
    server = PageServer(PAGE, SceneTold, options.port)
    where = f"{options.subject}: open {server.url} in a browser; Ctrl+C ends it"
    Console().print(where, soft_wrap=True)
    try:
        serve(TouchedScene(model, _SIZE), server)
    except KeyboardInterrupt:
        pass
    finally:
        server.close()
    return 0


def serve(scene: TouchedScene, server: PageServer) -> None:
    """Let a scene run at the pace of the wall clock, or slower, while a page shows it."""
    last = time.monotonic()
    try:
        while True:
            begin = time.monotonic()
            for told in server.taken():
                scene.take(told, begin)
            if server.watched:
                scene.advance(min(begin - last, _MOST), begin)
                server.show(scene.image(), scene.about)
            last, period = begin, _PERIOD if server.watched else _IDLE
            time.sleep(max(begin + period - time.monotonic(), 0.0))
    finally:
        scene.close()


def _at_home(model: mujoco.MjModel) -> mujoco.MjData:
    """Return data at the first key frame, if there is one."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    return data
