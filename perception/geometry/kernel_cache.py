"""Where numba keeps compiled kernels when neither our folder nor the user's can be written.

numba writes beside the source, else below the user's cache folder; without either, as for a service
or a container without a home, its decorators fail at import. Then kernels go to a temporary folder.
"""

import atexit
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

SETTING = "NUMBA_CACHE_DIR"
"""Variable of the environment that names numba's cache; processes that are spawned inherit it."""
_LOG = logging.getLogger(__name__)


def ensure_kernel_cache(source: Path = Path(__file__).parent) -> None:
    """Let numba keep its kernels in a temporary folder if it can write no other one.

    Args:
        source: Folder of a module with kernels.
    """
    if _can_be_written(_places(source)):
        return
    folder = tempfile.mkdtemp(prefix="fieldtwin-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[SETTING] = folder
    if "numba" in sys.modules:  # It reads its environment once.
        sys.modules["numba"].config.CACHE_DIR = folder
    _LOG.warning(
        "kernels are compiled anew in each run, as neither %s nor a cache folder below HOME can be "
        "written; set %s to a folder that can",
        source,
        SETTING,
    )


def _places(source: Path) -> Sequence[Path]:
    """Return the folders in which numba would keep kernels, as it tries them."""
    named = os.environ.get(SETTING)
    user = os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    places = [Path(named)] if named else []
    return [*places, source / "__pycache__", *([Path(user)] if Path(user).is_absolute() else [])]


def _can_be_written(places: Sequence[Path]) -> bool:
    """Return whether one of the folders is there, or can be made, and can be written."""
    there = (next(each for each in (place, *place.parents) if each.exists()) for place in places)
    return any(os.access(folder, os.W_OK | os.X_OK) for folder in there)
