"""How the robots of a log of ours were connected, so that a simulated run can be replayed."""

import json
from pathlib import Path

from cattrs.preconf.json import make_converter
from mcap.reader import make_reader
from mcap.records import Metadata

from perception.geometry import files
from twin.connect import ConnectionSettings
from twin.logs.log import LogError

SETTINGS = "fieldtwin.connection"
"""Name of the record in an MCAP file."""
_CONVERTER = make_converter(forbid_extra_keys=True)


def settings_text(settings: ConnectionSettings) -> str:
    """Return settings as JSON."""
    return json.dumps(_CONVERTER.unstructure(settings))


def settings_of(record: Metadata) -> ConnectionSettings | None:
    """Return the settings in a record of an MCAP file; None if it holds others."""
    if record.name != SETTINGS:
        return None
    return _CONVERTER.structure(json.loads(record.metadata["json"]), ConnectionSettings)


def read_settings(path: Path) -> ConnectionSettings:
    """Read how the robots of a log were connected.

    Raises:
        LogError: If the log does not say, or cannot be read.
    """
    try:
        files.check_size(path, files.LOG)
        with path.open("rb") as stream:
            for record in make_reader(stream).iter_metadata():
                if (settings := settings_of(record)) is not None:
                    return settings
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from None
    except Exception as error:  # What readers of damaged files raise has no base in common.
        raise LogError(f"{path}: damaged: {type(error).__name__} {error}"[:200]) from None
    raise LogError(f"{path}: no log of a run of ours, so --model has to say what its robot is")
