"""Logs whose writer was ended: completed as far as they go."""

import contextlib
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, DataEnd, Footer, Message
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from perception.geometry import files
from twin.logs.log import LogError

_MAGIC = b"\x89MCAP0\r\n"


def is_complete(path: Path) -> bool:
    """Return whether an MCAP file ends as its writer ends one.

    Raises:
        OSError: If it cannot be read.
    """
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(_MAGIC)))
        return size > len(_MAGIC) and stream.read() == _MAGIC


def mend(path: Path) -> float:
    """Complete an MCAP file whose writer was ended, in place; one that is complete stays.

    What was not written to its end is cut off, and whatever follows it.

    Args:
        path: The file.

    Returns:
        Time of the latest message that is kept [s], as the file logs it; NaN if it was complete.

    Raises:
        LogError: If it is no MCAP file.
        OSError: If it cannot be read or written.
    """
    files.check_size(path, files.LOG)
    if is_complete(path):
        return float("nan")
    with path.open("r+b") as stream:
        end, latest = 0, 0
        reader = StreamReader(stream, emit_chunks=True)
        # What readers of damaged files raise has no base in common.
        with contextlib.suppress(Exception):
            for record in reader.records:
                if isinstance(record, DataEnd | Footer):
                    break
                if isinstance(record, Chunk):
                    get_chunk_data_stream(record, validate_crc=True)
                    latest = max(latest, record.message_end_time)
                elif isinstance(record, Message):
                    latest = max(latest, record.log_time)
                end = stream.tell()
        if not end:
            raise LogError(f"{path}: no MCAP file, or nothing of it was written")
        ending = RecordBuilder()
        DataEnd(0).write(ending)
        Footer(0, 0, 0).write(ending)
        stream.seek(end)
        stream.truncate()
        stream.write(ending.end() + _MAGIC)
    return 1e-9 * latest
