"""Threads that repeat a step beside the main one."""

import contextlib
import threading
from collections.abc import Callable, Generator


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
