"""What an experiment leaves behind: metrics, checks, figures, tables and how it was run."""

import csv
import dataclasses
import enum
import hashlib
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.harness import provenance, storage
from experiments.harness.contract import OptionError, Options, SweepOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
REPLACED = ("metrics.json", "config.json", "run.json", "run.rrd", "figures", "tables")


class Output:
    """The result folder OUT/NAME/, which one run has for itself until `finish` or `close`.

    All is written to a hidden folder of this run first and moved into place by `finish`,
    metrics.json last: a folder with a metrics.json is complete and from one run, and a run that
    fails leaves the results of the run before it.

    Attributes:
        directory: OUT/NAME.
        failure: Why the run is no success although it came to its end; empty if it is one.
    """

    def __init__(self, name: str, options: Options, arguments: Sequence[str] = ()) -> None:
        """Prepare the folder.

        Args:
            name: Name of the experiment.
            options: Options of the run.
            arguments: Words of the command line that gave these options.

        Raises:
            OptionError: If OUT/NAME is no folder to write to.
            ExperimentError: If another run has it, or the disk is full.
        """
        self.directory = Path(options.out) / name
        self.failure = ""
        self._name = name
        self._options = options
        self._command = [name, *arguments]
        self._measured: dict[str, Any] = {}
        self._thesis: dict[str, Any] = {}
        self._checks: list[dict[str, Any]] = []
        self._jobs_ready = False
        self._start = time.monotonic()
        try:
            with storage.disk_errors(self.directory, storage.FULL):
                self.directory.mkdir(parents=True, exist_ok=True)
                self._lock = storage.lock(self.directory)
                for left in self.directory.glob(".partial-*"):  # by runs that were killed
                    shutil.rmtree(left, ignore_errors=True)
                self._staging = Path(tempfile.mkdtemp(prefix=".partial-", dir=self.directory))
        except OSError as error:
            raise OptionError(
                f"--out: {error.filename or self.directory}: {error.strerror}; "
                "choose a folder that can be written to"
            ) from None

    def measure(self, key: str, value: Any, thesis: Any = None) -> None:
        """Store a result, and beside it what the thesis reports.

        Args:
            key: Name of the metric, for instance "avg_error_percent/constant/ours".
            value: Number, string, list, or what `intervals.distribution` returns.
            thesis: The thesis' figure for the same quantity, if it has one.

        Raises:
            ValueError: If the key was stored before.
        """
        if key in self._measured:
            raise ValueError(f"metric {key}: measured twice")
        self._measured[key] = plain(value)
        if thesis is not None:
            self._thesis[key] = plain(thesis)

    def check(self, name: str, value: float, bound: str | float, ok: bool) -> None:
        """Store whether a result is as good as it must be; a failed check is reported, not raised.

        Args:
            name: Description of the check for the reader.
            value: The measured value.
            bound: Bound of the value, for instance "<= 0.8".
            ok: Whether the check holds.
        """
        self._checks.append(
            {"name": name, "value": plain(value), "bound": plain(bound), "ok": bool(ok)}
        )

    def check_within(self, name: str, value: float, bounds: tuple[float, float]) -> None:
        """Store whether a result lies between a lower and an upper bound; otherwise as `check`."""
        low, high = bounds
        self.check(name, float(value), f"{low:g} to {high:g}", bool(low <= value <= high))

    def figure(self, name: str, figure: "Figure") -> Path:
        """Write a figure to figures/NAME.png, clear it, and return where that will be.

        With ``--format`` svg or pdf it is written so, too.

        Args:
            name: File name without ending, after the thesis' figure, for instance "figure_2-4".
            figure: A matplotlib figure.
        """
        for ending in dict.fromkeys(("png", self._options.format)):
            path = self.file(f"figures/{name}.{ending}")
            figure.savefig(path, dpi=150, bbox_inches="tight")
        figure.clear()
        return self.directory / "figures" / f"{name}.png"

    def table(self, name: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
        """Write a table to tables/NAME.csv and return where it will be.

        Args:
            name: File name without ending, after the thesis' table, for instance "table_2-1".
            columns: Headings, with units.
            rows: One sequence as long as ``columns`` for each row.

        Raises:
            ValueError: If a row has another length.
        """
        path = self.file(f"tables/{name}.csv")
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(columns)
            for row in rows:
                if len(row) != len(columns):
                    raise ValueError(f"table {name}: row {row} has not {len(columns)} columns")
                writer.writerow(row)
        return self.directory / "tables" / path.name

    def file(self, name: str) -> Path:
        """Return a path to write any other file to, for instance "run.rrd".

        `finish` moves the file to OUT/NAME/name.

        Raises:
            ValueError: If a part of the name holds other than letters, digits, ".", "_" and "-".
        """
        for part in name.split("/"):
            if not FILE_NAME.fullmatch(part):
                raise ValueError(f"file name {name}: only letters, digits, '.', '_' and '-'")
        path = self._staging / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def jobs_directory(self) -> Path:
        """Return OUT/NAME/jobs, emptied on first use unless the run resumes another."""
        directory = self.directory / "jobs"
        resumed = isinstance(self._options, SweepOptions) and self._options.resume
        if not self._jobs_ready and not resumed:
            _remove(directory)
        directory.mkdir(parents=True, exist_ok=True)
        if not self._jobs_ready:
            for left in directory.glob(".*"):  # by runs that were killed
                left.unlink()
        self._jobs_ready = True
        return directory

    def metrics(self) -> dict[str, Any]:
        """Return what metrics.json will hold."""
        return {"measured": self._measured, "thesis": self._thesis, "checks": self._checks}

    def finish(self) -> None:
        """Write metrics.json, config.json and run.json, move all into place, and close."""
        names = {entry.name for entry in self._staging.iterdir()}
        run = provenance.describe_run(time.monotonic() - self._start)
        metrics = _json(self.metrics())
        run["files"] = sorted(names | {"config.json", "metrics.json", "run.json"})
        run["metrics_sha256"] = hashlib.sha256(metrics).hexdigest()
        self.file("config.json").write_bytes(
            _json({"experiment": self._name, **plain(self._options)})
        )
        self.file("run.json").write_bytes(_json({"command": self._command, **run}))
        self.file("metrics.json").write_bytes(metrics)
        for path in self._staging.rglob("*"):
            storage.sync(path)
        self._publish()
        self.close()

    def close(self) -> None:
        """Release the folder; what `finish` has not moved into place is deleted."""
        shutil.rmtree(self._staging, ignore_errors=True)
        self._lock.close()

    def _publish(self) -> None:
        """Replace the files of the run before.

        A run may be killed at any moment of this. As long as there are files of a run, there is
        also a run.json that names them, so the next run can take them away.
        """
        known = _files_of(self.directory / "run.json")
        new = [entry.name for entry in self._staging.iterdir()]
        for name in sorted({*REPLACED, *known, *new}, key=_deletion_order):
            _remove(self.directory / name)
        for name in sorted(new, key=_deletion_order, reverse=True):
            os.replace(self._staging / name, self.directory / name)
            storage.sync(self.directory)


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it: arrays as lists, paths as text, NaN and inf as null.

    Raises:
        TypeError: If there is no such form.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {field.name: plain(getattr(value, field.name)) for field in fields}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, enum.Enum):
        return plain(value.value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{type(value).__name__} has no form in JSON: {value!r}")


def _json(value: Any) -> bytes:
    return (json.dumps(value, indent=2, allow_nan=False) + "\n").encode()


def _deletion_order(name: str) -> int:
    """Return when a file goes: metrics.json, which says that all is there, first; run.json last."""
    return {"metrics.json": 0, "run.json": 2}.get(name, 1)


def _files_of(run: Path) -> list[str]:
    """Return the names of what the run before has left, by its run.json."""
    try:
        names = [str(name) for name in json.loads(run.read_text(encoding="utf-8"))["files"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [name for name in names if FILE_NAME.fullmatch(name) and name != "jobs"]


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
