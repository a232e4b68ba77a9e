"""One run, continued in several ways from where it is."""

import multiprocessing
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import TypeVar

Result = TypeVar("Result")


def branches(ways: Sequence[Callable[[], Result]]) -> list[Result]:
    """Continue a run in each of several ways, one after the other.

    Each is called in a fork of this process, so that all begin with exactly what there is now,
    random generators and physics included, and none changes it. Only this thread goes on in a
    fork: what is called must need no other, and must not render.

    Args:
        ways: What to call; what it returns is pickled.

    Returns:
        What each returned.

    Raises:
        RuntimeError: If one ends without a result; its traceback is on the standard error stream.
    """
    context = multiprocessing.get_context("fork")
    found: list[Result] = []
    for number, way in enumerate(ways):
        receiving, sending = context.Pipe(duplex=False)
        process = context.Process(target=_call, args=(way, sending))
        process.start()
        sending.close()
        try:
            found.append(receiving.recv())
        except EOFError:
            raise RuntimeError(f"way {number} of {len(ways)} ended without a result") from None
        finally:
            receiving.close()
            process.join()
    return found


def _call(way: Callable[[], object], sending: Connection) -> None:
    sending.send(way())
