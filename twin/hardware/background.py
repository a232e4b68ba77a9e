"""Threads and processes beside the main one."""

import contextlib
import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator

PR_SET_PDEATHSIG = 1  # prctl(2)


def end_with_parent(parent: int) -> None:
    """Have the kernel end this process when its parent dies, on Linux.

    A thread that watches the parent would not do: compiled code may keep the interpreter's lock
    from it.

    Args:
        parent: Process whose present thread started this one.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:  # It died before.
            os._exit(1)


@contextlib.contextmanager
def repeating(step: Callable[[], object], name: str, period: float = 0.0) -> Generator[None]:
    """Repeat a step in a thread of its own until the block is left.

    Args:
        step: Function to call.
        name: Name of the thread.
        period: Pause before each call [s].
    """
    over = threading.Event()

    def repeat() -> None:
        while not over.wait(period):
            step()

    thread = threading.Thread(target=repeat, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
