"""Files that are whole and checked, in a folder that one run has for itself."""

import contextlib
import datetime
import errno
import fcntl
import hashlib
import os
import platform
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

from experiments.harness.contract import ExperimentError
from perception.geometry.files import replace_file

DIGEST_SIZE = hashlib.sha256().digest_size
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a disk that holds no more."""
REFUSED = (*FULL, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)
"""Errors of a disk that is full, read-only, not ours to write or broken."""


def lock(folder: Path) -> TextIO:
    """Take a folder for one run and return the open lock file; to close it releases the folder.

    The kernel also releases it when its owner dies, however that happens. The file stays: what
    it says of its owner is only for the message to others.

    Args:
        folder: An existing folder.

    Raises:
        ExperimentError: If another run has it.
        OSError: If the lock file cannot be written.
    """
    path = folder / ".lock"
    stream = path.open("a", encoding="utf-8")
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        stream.close()
        raise ExperimentError(
            f"{folder}: in use by {_owner(path)}; wait for its end or choose another --out"
        ) from None
    since = datetime.datetime.now().astimezone().isoformat(" ", "seconds")
    stream.truncate(0)
    stream.write(f"process {os.getpid()} on {platform.node()} since {since}")
    stream.flush()
    return stream


def _owner(path: Path) -> str:
    """Return what a lock file says of its owner, who may be about to write it."""
    for _ in range(100):
        if words := path.read_text(encoding="utf-8"):
            return words
        time.sleep(0.01)
    return "another run"


@contextlib.contextmanager
def disk_errors(path: Path, refused: Sequence[int] = REFUSED) -> Iterator[None]:
    """Report it in one line if the disk refuses to write.

    Args:
        path: File or folder that is named if the error names none.
        refused: Error numbers that are reported.

    Raises:
        ExperimentError: If the disk refuses for one of these reasons.
        OSError: Any other, as it came.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in refused:
            raise
        raise ExperimentError(
            f"{error.filename or path}: {error.strerror}; what was recorded before is kept, "
            "and a sweep goes on with --resume"
        ) from error


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that no reader finds half written, also after a power failure.

    Args:
        path: The file; one that exists is replaced.
        content: All of its bytes.

    Raises:
        ExperimentError: If the disk refuses; a file that existed is as it was.
    """
    with disk_errors(path):
        replace_file(path, lambda stream: stream.write(content))


def write_checked(path: Path, content: bytes) -> None:
    """Write a file as `write_whole` does, with the SHA-256 digest of its content at the end."""
    write_whole(path, content + hashlib.sha256(content).digest())


def read_checked(path: Path) -> bytes | None:
    """Return what `write_checked` was given; None if the file is missing or damaged."""
    try:
        stored = path.read_bytes()
    except OSError:
        return None
    content, digest = stored[:-DIGEST_SIZE], stored[-DIGEST_SIZE:]
    return content if hashlib.sha256(content).digest() == digest else None


def sync(path: Path) -> None:
    """Wait until the disk holds the content of a file, or the list of names of a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
