"""What is kept of a twin beside a rover: its findings over time, its memory, and where runs go.

A folder holds ``found.jsonl``, a line a second and one for each change; ``memory.npz``, replaced
each second; and of a rover that `live` owns each run's log and recording, by number.
"""

import dataclasses
import json
import math
import time
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, TextIO

import numpy as np

from controllers.sensing.changes import ChangeMemory
from controllers.sensing.diagnosis import Finding
from experiments.harness.contract import ExperimentError
from experiments.harness.storage import lock
from experiments.live.twin_beside import Block, Named, TwinMemory
from perception.geometry import files
from twin.logs.log import LogError
from twin.logs.mending import mend

FOUND, MEMORY = "found.jsonl", "memory.npz"
EVERY = 4
"""Blocks of which one is kept, and after which the memory is written."""


class TwinFolder:
    """The folder of one rover's twin.

    Args:
        path: The folder; it is made.
        new: Whether to begin anew, without what is there.

    Attributes:
        path: The folder.
        blocks: What was found before.
        named: Changes that were named before.
        memory: What was known before; None for nothing.
        began: When it began [s since 1970]; times are since then.

    Raises:
        ExperimentError: If it cannot be written, or what is there cannot be read.
    """

    def __init__(self, path: Path, new: bool) -> None:
        self.path = path
        self.blocks: list[Block] = []
        self.named: list[Named] = []
        self.memory: TwinMemory | None = None
        self.began = float("nan")
        try:
            path.mkdir(parents=True, exist_ok=True)
            if new:
                (path / MEMORY).unlink(missing_ok=True)
            else:
                self._read()
            self._stream: IO[str] = (path / FOUND).open("w" if new else "a", encoding="utf-8")
            if not np.isfinite(self.began):
                self.began = time.time()
                self._write({"began": self.began})
        except OSError as error:
            raise ExperimentError(f"{error.filename}: {error.strerror}") from None
        except (ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            raise ExperimentError(f"{path}: damaged, choose another --out: {error}") from None

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def add(self, blocks: Sequence[Block], memory: TwinMemory) -> None:
        """Keep the latest of some blocks, and what is known then.

        Args:
            blocks: All of this run so far.
            memory: What is known.
        """
        if len(blocks) % EVERY == 0:
            self._write({"block": _plain(dataclasses.asdict(blocks[-1]))})
            _write_memory(self.path / MEMORY, memory)

    def add_named(self, named: Named) -> None:
        """Keep a change that was named."""
        self._write({"named": dataclasses.asdict(named)})

    def _write(self, line: Mapping[str, Any]) -> None:
        self._stream.write(json.dumps(line) + "\n")
        self._stream.flush()

    def _read(self) -> None:
        if (self.path / FOUND).exists():
            text = files.read_text(self.path / FOUND, files.LOG)
            for line in text.splitlines():
                if not line.endswith("}"):
                    continue  # Its writer was killed.
                entry = json.loads(line)
                if "block" in entry:
                    self.blocks.append(_block(entry["block"]))
                elif "began" in entry:
                    self.began = float(entry["began"])
                else:
                    told = entry["named"]
                    self.named.append(Named(told["time"], Finding(**told["finding"]), told["unit"]))
            if text and not text.endswith("\n"):
                with (self.path / FOUND).open("a", encoding="utf-8") as stream:
                    stream.write("\n")
        if (self.path / MEMORY).exists():
            self.memory = _read_memory(self.path / MEMORY)


def _plain(entry: Mapping[str, Any]) -> dict[str, list[float | None]]:
    """Return rows of numbers as JSON has them; none in place of NaN."""
    rows = {name: np.asarray(value, dtype=float).ravel() for name, value in entry.items()}
    return {
        name: [each if math.isfinite(each) else None for each in row.tolist()]
        for name, row in rows.items()
    }


def _block(entry: Mapping[str, Any]) -> Block:
    rows = {name: np.array(value, dtype=float) for name, value in entry.items()}
    time, evidence = (float(rows.pop(name)[0]) for name in ("time", "evidence"))
    return Block(time=time, evidence=evidence, **rows)


def _write_memory(path: Path, memory: TwinMemory) -> None:
    content: dict[str, Any] = {"names": np.array(memory.names), "known": memory.known}
    content |= memory.learned._asdict()
    files.replace_file(path, lambda stream: np.savez(stream, **content))


def _read_memory(path: Path) -> TwinMemory:
    files.check_size(path, files.RESULTS)
    with np.load(path, allow_pickle=False) as content:
        names, known = (content[name] for name in ("names", "known"))
        rows = {name: content[name] for name in ChangeMemory._fields}
        learned = ChangeMemory(**{**rows, "blocks": int(rows["blocks"])})
        return TwinMemory(tuple(names.tolist()), known, learned)


def take(folder: Path) -> TextIO:
    """Make a folder, take it for one run, and return what releases it when it is closed.

    Raises:
        ExperimentError: If another run has it, or it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return lock(folder)
    except OSError as error:
        raise ExperimentError(f"{error.filename}: {error.strerror}") from None


def next_run(folder: Path) -> tuple[int, float]:
    """Complete the logs of earlier runs of a rover, and begin another one.

    Args:
        folder: Where its history is kept.

    Returns:
        Number of the run, and the time up to which earlier ones are mended [s]; NaN if none had
        to be.

    Raises:
        ExperimentError: If a log cannot be mended.
    """
    number, mended = 1, float("nan")
    for log in sorted(folder.glob("run-[0-9][0-9][0-9].mcap")):
        number = int(log.stem.partition("-")[2]) + 1
        try:
            mended = mend(log)
        except LogError:
            log.unlink()  # Nothing of it was written.
        except OSError as error:
            raise ExperimentError(f"{log}: {error.strerror}") from None
    return number, mended
