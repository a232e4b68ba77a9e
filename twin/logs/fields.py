"""What a log file holds: columns of numbers with stamps, by the names that the file gives them.

A field of a message is named by its topic and its path in the message, with the joint's name in
place of a number where the message names its joints: ``/joint_states.position[elbow]``. A column
of a table has the table's own name.
"""

from pathlib import Path

from perception.geometry import files
from twin.logs import messages, tables
from twin.logs.log import Field, LogError
from twin.logs.mending import is_complete


def read_fields(
    path: Path, time: str = "", time_unit: float = 1.0, episode: int = 0
) -> dict[str, Field]:
    """Read all numbers of a log.

    Args:
        path: A CSV, MCAP or rerun file (``.csv``, ``.mcap``, ``.rrd``), or the folder of a rosbag2
            or of a LeRobot dataset.
        time: Column of the stamps in a CSV file; empty for the first of "time", "t", "stamp" and
            "timestamp" that it has.
        time_unit: Unit of that column [s].
        episode: Episode of a LeRobot dataset.

    Returns:
        Fields by name.

    Raises:
        LogError: If it is none of these, damaged, or larger than a log may be; in one line that
            names it.
    """
    try:
        _check(path)
        with files.limited_memory(files.LOG_MEMORY):
            return _read(path, time, time_unit, episode)
    except LogError:
        raise
    except MemoryError:
        most = f"{files.LOG_MEMORY:,}"
        raise LogError(f"{path}: takes more memory than there is, or than {most} bytes") from None
    except Exception as error:  # What readers of damaged files raise has no base in common.
        if isinstance(error, OSError) and error.filename is not None:
            raise LogError(f"{path}: {error.strerror}") from None
        if path.suffix.lower() == ".mcap" and not is_complete(path):
            raise LogError(
                f"{path}: damaged: it ends early; log --mend keeps what was written before"
            ) from None
        reason = f"{type(error).__name__} {error}"[:200]
        raise LogError(f"{path}: damaged, or not what its name says: {reason}") from None


def _read(path: Path, time: str, time_unit: float, episode: int) -> dict[str, Field]:
    if (path / "meta" / "info.json").exists():
        return tables.read_lerobot(path, episode)
    if (path / "metadata.yaml").exists():
        return messages.read_bag(path)
    match path.suffix.lower():
        case ".csv":
            return tables.read_csv(path, time, time_unit)
        case ".mcap":
            return messages.read_mcap(path)
        case ".rrd":
            return tables.read_recording(path)
        case _:
            raise LogError(
                f"{path}: not a log; expected .csv, .mcap or .rrd, or the folder of a rosbag2 "
                "(metadata.yaml) or of a LeRobot dataset (meta/info.json)"
            )


def _check(path: Path) -> None:
    """Refuse more bytes than a log may have."""
    if not path.is_dir():
        files.check_size(path, files.LOG)
        return
    size = sum(each.stat().st_size for each in path.rglob("*"))
    if size > files.LOG:
        raise LogError(f"{path}: too large: {size:,} bytes, the limit is {files.LOG:,}")
