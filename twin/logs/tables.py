"""Fields of tables: CSV files, LeRobot datasets (parquet) and our own recordings for rerun."""

# pyarrow has no types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false
# pyright: reportAttributeAccessIssue=false, reportMissingTypeStubs=false

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.csv
import pyarrow.parquet
from rerun.chunk import RrdReader

from perception.geometry import files
from perception.geometry.arrays import FloatArray
from twin.logs.log import Field, LogError

BLOCK = 2**22
"""Part of a CSV file that is read at once [B]."""
TIMES = ("time", "t", "stamp", "timestamp")
"""Columns of a CSV file that are taken for the stamps."""


def read_csv(path: Path, time: str, time_unit: float) -> dict[str, Field]:
    """Read a CSV file with a line of names; columns of text and empty cells are left out.

    Args:
        path: The file.
        time: Column of the stamps; empty for the first of `TIMES`.
        time_unit: Unit of that column [s].

    Raises:
        LogError: If there is no such column, or it holds no numbers.
    """
    table = _csv_table(path)
    found = time or next((name for name in TIMES if name in table.column_names), "")
    if found not in table.column_names:
        raise LogError(
            f"{path}: no column {found or ' or '.join(TIMES)} for the stamps; there are "
            f"{', '.join(table.column_names)}"
        )
    numbers = {name: _numbers(table.column(name)) for name in dict.fromkeys(table.column_names)}
    stamps = numbers.pop(found)
    if stamps is None:
        raise LogError(f"{path}: column {found} holds no numbers")
    fields: dict[str, Field] = {}
    times = 1e-9 * np.round(1e9 * time_unit * stamps)  # as all other formats have them
    for name, values in numbers.items():
        if values is not None:
            column = table.column(name)
            if not column.null_count:
                fields[name] = Field(times, values)
                continue
            # An empty cell is no sample: tables join what was sampled at other times.
            there = column.is_valid().to_numpy()
            fields[name] = Field(times[there], values[there])
    return fields


def _csv_table(path: Path) -> pa.Table:
    block = pyarrow.csv.ReadOptions(block_size=BLOCK)
    try:
        with pyarrow.csv.open_csv(path, read_options=block) as reader:
            return reader.read_all()
    except pa.ArrowInvalid:
        # Types are those of the first block; to find others takes four times the memory.
        return pyarrow.csv.read_csv(path)


def read_lerobot(path: Path, episode: int) -> dict[str, Field]:
    """Read one episode of a LeRobot dataset, version 3.

    A vector's entries are named as the dataset names them: ``action[elbow]``.

    Args:
        path: Folder of the dataset.
        episode: Number of the episode.

    Raises:
        LogError: If it is of another version, or has no such episode.
    """
    info = files.read_json(path / "meta" / "info.json", files.RESULTS)
    version, features = info["codebase_version"], info["features"]
    if not version.startswith("v3."):
        raise LogError(f"{path}: a dataset of version {version}; expected v3.0")
    chosen = pyarrow.compute.field("episode_index") == episode
    parts = sorted(path.glob("data/chunk-*/file-*.parquet"))
    table = pa.concat_tables(pyarrow.parquet.read_table(part, filters=chosen) for part in parts)
    if not table.num_rows:
        raise LogError(f"{path}: no episode {episode}; there are {info['total_episodes']}")
    stamps = _column(table, "timestamp")[:, 0]
    fields: dict[str, Field] = {}
    for name in table.column_names:
        if name not in _INDICES and features[name]["dtype"].startswith(("float", "int")):
            rows = _column(table, name)
            for label, values in zip(_labels(features[name], rows.shape[1]), rows.T):
                fields[name + label] = Field(stamps, values)
    return fields


def read_recording(path: Path) -> dict[str, Field]:
    """Read the numbers of a recording for rerun: those of our own runs.

    A field is named by its entity: ``/rover/sensors/arm_angles[2]``. Its stamps are those of the
    timeline of durations, ``sim_time`` in our own recordings. It is read in a process of its own:
    rerun ends a process that reads a damaged one.

    Raises:
        LogError: If it did.
    """
    try:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as apart:
            return apart.submit(_recorded, path).result()
    except BrokenProcessPool:
        raise LogError(f"{path}: damaged: rerun's reader gave up") from None


def _recorded(path: Path) -> dict[str, Field]:
    parts: dict[str, list[tuple[FloatArray, FloatArray]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        stamps = _times(batch)
        for name, kind in zip(batch.schema.names, batch.schema.types):
            if stamps is not None and name.endswith(":scalars") and pa.types.is_list(kind):
                rows = _rows(batch.column(name))
                parts.setdefault(str(chunk.entity_path), []).append((stamps, rows))
    fields: dict[str, Field] = {}
    for entity, pieces in parts.items():
        stamps = np.concatenate([times for times, _ in pieces])
        order = np.argsort(stamps, kind="stable")
        columns = np.concatenate([rows for _, rows in pieces])[order].T
        for index, values in enumerate(columns):
            fields[f"{entity}[{index}]"] = Field(stamps[order], values)
    return fields


_INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def _numbers(column: pa.ChunkedArray) -> FloatArray | None:
    """Return a column as (n,) floats, NaN where there is none; None if it holds no numbers."""
    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
        return None
    return column.cast(pa.float64()).to_numpy()


def _column(table: pa.Table, name: str) -> FloatArray:
    """Return a column of numbers or of lists of them as (n, k) floats."""
    column = table.column(name).combine_chunks()
    lists = pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type)
    values = pa.compute.list_flatten(column) if lists else column
    numbers = np.asarray(values.cast(pa.float64()).to_numpy(zero_copy_only=False))
    return numbers.reshape(table.num_rows, -1)


def _labels(feature: dict[str, Any], count: int) -> list[str]:
    """Return what is added to a vector's name for each of its entries; nothing for a scalar."""
    names = feature.get("names")
    if isinstance(names, dict):
        names = next(iter(names.values()))
    if not isinstance(names, list) or len(names) != count:
        names = list(range(count))
    return [""] if count == 1 else [f"[{name}]" for name in names]


def _times(batch: pa.RecordBatch) -> FloatArray | None:
    """Return the stamps of a chunk [s], by its timeline of durations; None if it has none."""
    for name, kind in zip(batch.schema.names, batch.schema.types):
        if pa.types.is_duration(kind):
            return 1e-9 * batch.column(name).cast(pa.int64()).to_numpy(zero_copy_only=False)
    return None


def _rows(column: pa.Array) -> FloatArray:
    """Return lists of equally many scalars as (n, k) floats."""
    values = pa.compute.list_flatten(column).cast(pa.float64()).to_numpy(zero_copy_only=False)
    return np.asarray(values).reshape(len(column), -1)
