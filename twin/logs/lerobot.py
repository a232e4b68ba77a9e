"""Logs as LeRobot datasets, version 3: one episode, single precision, all signals at one rate."""

# pyarrow has no types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false
# pyright: reportMissingTypeStubs=false

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from perception.geometry.arrays import FloatArray
from twin.logs.log import Log, LogError, Role, Signal

_FEATURES: Mapping[Role, str] = {"actuator": "action", "sensor": "observation.state"}
_INDICES = ("frame_index", "episode_index", "index", "task_index")
_TASK = "run"


def at_one_rate(log: Log, rate: int) -> Log:
    """Return a log of frames at one rate, which last for as long as all signals do.

    A command is the last one before a frame, a sensor's sample lies on the line between its
    neighbours.

    Args:
        log: The log.
        rate: Frames a second.

    Raises:
        LogError: If no time has all signals.
    """
    first = max(float(each.stamps[0]) for each in log.signals.values())
    last = min(float(each.stamps[-1]) for each in log.signals.values())
    count = int(np.floor((last - first) * rate + 1e-9)) + 1
    if count < 2:  # noqa: PLR2004
        raise LogError(f"signals overlap for {last - first:.3g} s only, too little for {rate} Hz")
    times = first + np.arange(count) / rate
    return Log(
        {
            name: dataclasses.replace(each, stamps=times, values=_sampled(each, times))
            for name, each in log.signals.items()
        }
    )


def write_lerobot(log: Log, folder: Path, rate: int) -> None:
    """Write a log as a dataset: ``action`` of all actuators, ``observation.state`` of all sensors.

    Args:
        log: The log, of which `at_one_rate` makes frames.
        folder: Folder to write; it must be new.
        rate: Frames a second.

    Raises:
        LogError: If no time has all signals, or they lack actuators or sensors.
        OSError: If it cannot be written.
    """
    frames = at_one_rate(log, rate).signals
    count = len(next(iter(frames.values())).stamps)
    columns: dict[str, FloatArray] = {}
    names: dict[str, list[str]] = {}
    for role, feature in _FEATURES.items():
        chosen = {name: each for name, each in frames.items() if each.role == role}
        if not chosen:
            raise LogError(f"no {role}, of which {feature} is made")
        columns[feature] = np.hstack([each.values for each in chosen.values()])
        names[feature] = [label for name, each in chosen.items() for label in labels(name, each)]
    folder.mkdir()
    _write_table(folder, _frames(columns, rate), "data")
    _write_table(folder, _episodes(count), "meta/episodes")
    task = pa.table({"task_index": [0], "__index_level_0__": [_TASK]})
    index = {"index_columns": ["__index_level_0__"], "column_indexes": [], "columns": []}
    task = task.replace_schema_metadata({"pandas": json.dumps(index)})
    pyarrow.parquet.write_table(task, folder / "meta" / "tasks.parquet")
    _write_json(folder, "info", _info(count, rate, names))
    _write_json(folder, "stats", {name: _statistics(each) for name, each in columns.items()})


def _sampled(signal: Signal, times: FloatArray) -> FloatArray:
    good = np.isfinite(signal.values).all(axis=1)
    stamps, values = signal.stamps[good], signal.values[good]
    if signal.role == "actuator":
        # A stamp that differs by rounding alone is that of the frame.
        places = np.searchsorted(stamps, times + 1e-9, side="right") - 1
        return values[np.maximum(places, 0)]
    return np.column_stack([np.interp(times, stamps, column) for column in values.T])


def labels(name: str, signal: Signal) -> list[str]:
    """Return the names of a signal's numbers in a dataset."""
    count = signal.values.shape[1]
    return [name] if count == 1 else [f"{name}.{number}" for number in range(count)]


def _frames(columns: Mapping[str, FloatArray], rate: int) -> pa.Table:
    count = len(next(iter(columns.values())))
    found: dict[str, Any] = {}
    for name, values in columns.items():
        flat = pa.array(values.astype(np.float32).ravel())
        found[name] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
    frames = np.arange(count)
    found["timestamp"] = (frames / rate).astype(np.float32)
    found |= {"frame_index": frames, "episode_index": 0 * frames, "index": frames}
    return pa.table(found | {"task_index": 0 * frames})


def _episodes(count: int) -> pa.Table:
    numbers = {
        "episode_index": 0,
        "length": count,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": 0,
        "dataset_to_index": count,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }
    columns = {name: [value] for name, value in numbers.items()}
    return pa.table({**columns, "tasks": [[_TASK]]})


def _info(count: int, rate: int, names: Mapping[str, list[str]]) -> dict[str, Any]:
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(labels)], "names": labels}
        for name, labels in names.items()
    }
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in _INDICES}
    return {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": 1,
        "total_frames": count,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": "0:1"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }


def _statistics(values: FloatArray) -> dict[str, list[float]]:
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
    }


def _write_table(folder: Path, table: pa.Table, kind: str) -> None:
    path = folder / kind / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    pyarrow.parquet.write_table(table, path)


def _write_json(folder: Path, name: str, content: Any) -> None:
    (folder / "meta" / f"{name}.json").write_text(json.dumps(content, indent=4) + "\n")
