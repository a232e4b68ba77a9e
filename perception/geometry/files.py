"""Files that a user names: none is read beyond its limit, none is left half written.

The limits are far above what the project writes, and far below the memory of a small computer.
A file beyond its limit raises `OSError` (EFBIG), whose text gives its size and the limit.
"""

import contextlib
import errno
import json
import os
import secrets
import tomllib
from collections.abc import Callable, Generator
from pathlib import Path
from typing import IO, Any

from PIL import Image, UnidentifiedImageError

try:
    import resource
except ImportError:  # Windows
    resource = None

SETTINGS = 2**15
"""Settings that a person writes, as calibrations and parameters [byte]; TOML takes a time that
grows with the square of its longest key, 5 s for one of this size."""
RESULTS = 2**24
"""Metrics, tables and pages of results [byte]."""
MODEL = 2**26
"""An MJCF file, and each mesh or height field that it names [byte]."""
PICTURE = 2**26
"""An encoded picture [byte]."""
PIXELS = 2**25
"""A decoded picture, or an image of a video [px]; one of 8K has 33.2 million."""
MAP = 2**31
"""A voxel map [byte]."""
RECORDING = 2**32
"""A recording for the viewer [byte]."""
LOG = 2**32
"""A log of a robot, file or folder [byte]."""
LOG_MEMORY = 2**32
"""Memory that reading a log may take beside what is taken already [byte]."""
_FORMATS = ("PNG", "JPEG", "BMP", "PPM", "TIFF", "WEBP", "GIF")


def check_size(path: Path | str, most: int) -> None:
    """Refuse a file that is larger than a limit.

    Args:
        path: File.
        most: Limit [byte].

    Raises:
        OSError: If it is larger, or is not there.
    """
    _require(os.stat(path).st_size, most, "bytes", path)


@contextlib.contextmanager
def limited_memory(most: int) -> Generator[None, None, None]:
    """Let this process take so many more bytes of memory within, and no more.

    What wants more gets a `MemoryError`, as where there is none left. Processes that are started
    within may take as much each. Linux alone has such a limit; elsewhere there is none.

    Args:
        most: Limit [byte].
    """
    taken = Path("/proc/self/statm")
    if resource is None or not taken.exists():
        yield
        return
    pages = int(taken.read_text().split()[5])  # of data and stacks
    limit, before = pages * resource.getpagesize() + most, resource.getrlimit(resource.RLIMIT_DATA)
    limits = [each for each in (limit, *before) if each != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min(limits), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def check_pixels(path: Path | str, width: int, height: int) -> None:
    """Refuse a picture of more than `PIXELS`.

    Args:
        path: File of the picture.
        width: Columns [px].
        height: Rows [px].

    Raises:
        OSError: If it has more.
    """
    _require(width * height, PIXELS, f"pixels ({width} x {height})", path)


def check_picture(path: Path | str) -> None:
    """Refuse a picture of more than `PICTURE` bytes or `PIXELS`, by its header.

    Raises:
        OSError: If it is larger, or cannot be read.
        PIL.UnidentifiedImageError: If it is no picture of a known format; an `OSError` too.
    """
    check_size(path, PICTURE)
    most, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # Its own error lacks the file.
    try:
        with Image.open(path, formats=_FORMATS) as picture:  # Decodes nothing yet.
            width, height = picture.size
    except (ValueError, OSError) as error:
        if getattr(error, "errno", None):
            raise
        text = f"not a picture that can be read; known are {', '.join(_FORMATS)}"
        raise UnidentifiedImageError(errno.EINVAL, text, str(path)) from None
    finally:
        Image.MAX_IMAGE_PIXELS = most
    check_pixels(path, width, height)


def read_bytes(path: Path | str, most: int) -> bytes:
    """Return the content of a file, pipe or device.

    Args:
        path: File.
        most: Limit [byte].

    Raises:
        OSError: If it cannot be read, or is larger.
    """
    with open(path, "rb") as stream:
        # What has no end, as a device, is not read further.
        size = os.fstat(stream.fileno()).st_size
        content = b"" if size > most else stream.read(most + 1)
    _require(max(size, len(content)), most, "bytes", path)
    return content


def read_text(path: Path | str, most: int) -> str:
    """Return the content of a UTF-8 file of at most so many bytes.

    Raises:
        OSError: As `read_bytes`.
        ValueError: If it is not UTF-8.
    """
    return read_bytes(path, most).decode()


def read_json(path: Path | str, most: int) -> Any:
    """Return the value in a JSON file of at most so many bytes.

    Raises:
        OSError: As `read_bytes`.
        ValueError: If it is not JSON, or is nested too deeply.
    """
    return _parsed(json.loads, read_text(path, most))


def read_toml(path: Path | str, most: int) -> dict[str, Any]:
    """Return the table in a TOML file of at most so many bytes.

    Raises:
        OSError: As `read_bytes`.
        ValueError: If it is not TOML, or is nested too deeply.
    """
    return _parsed(tomllib.loads, read_text(path, most))


def replace_file(path: Path | str, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file that is either complete or not there: an older one stays until then.

    Args:
        path: Path of the file.
        write: Writes the content to the open file that it is given.

    Raises:
        OSError: If it cannot be written; it names the file.
    """
    target = Path(path)
    # Not a temporary file of the library's: nobody else could read those.
    partial = target.with_name(f".{target.name}.{secrets.token_hex(8)}")
    try:
        descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        with os.fdopen(descriptor, "wb") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(partial)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror or str(error), str(target)) from None
        raise
    folder = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # so that the new name survives a power cut too
    finally:
        os.close(folder)


def _parsed(parse: Callable[[str], Any], text: str) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _require(size: int, most: int, unit: str, path: Path | str) -> None:
    if size > most:
        text = f"too large: {size:,} {unit}, the limit is {most:,}"
        raise OSError(errno.EFBIG, text, str(path))
