"""One function run over many configurations, in parallel, each result kept as it arrives."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import joblib
import numpy as np
import threadpoolctl
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from experiments.harness.contract import ExperimentError, Options
from experiments.harness.output import Output, plain

Config = TypeVar("Config")
Result = dict[str, Any]

CONNECT_TIMEOUT = 10.0  # [s] to reach a Dask scheduler


def sweep(
    function: Callable[[Config], Mapping[str, Any]],
    configs: Sequence[Config],
    options: Options,
    output: Output,
    *,
    label: str = "jobs",
) -> list[Result]:
    """Run a function over all configurations and return the results in the same order.

    Every result is written to OUT/NAME/jobs/ when it arrives, so an interrupted sweep keeps what
    it has; with ``--resume`` the jobs whose function and configuration are found there are not
    run again. Workers are fresh processes (never forked), each with one BLAS thread.

    Args:
        function: A function of a module (workers import it). It returns numbers, strings, lists
            or arrays by name; tuples come back as lists.
        configs: Mappings or dataclasses of plain values, with the job's seed among them.
        options: Number of processes, backend, and whether to resume.
        output: Where the results are kept.
        label: What the progress bar counts.

    Returns:
        One mapping for each configuration.

    Raises:
        ExperimentError: If the Dask cluster cannot be used, or a result is lost on the disk.
        Exception: What a job raised, with its configuration noted.
    """
    directory = output.jobs_directory()
    keys = [_job_key(function, config) for config in configs]
    paths = {key: directory / f"{key}.npz" for key in keys}
    pending = {key: config for key, config in zip(keys, configs) if _read(paths[key]) is None}
    with _progress() as progress:
        task = progress.add_task(label, total=len(paths), completed=len(paths) - len(pending))
        for key, result in _results(function, pending, options):
            _write(paths[key], pending[key], result)
            progress.advance(task)
    finished: dict[str, Result] = {}
    for key, path in paths.items():
        result = _read(path)
        if result is None:  # To leave it out would shift all results behind it.
            raise ExperimentError(f"{path}: lost after it was written; --resume runs it again")
        finished[key] = result
    return [finished[key] for key in keys]


def _results(
    function: Callable[[Config], Mapping[str, Any]], pending: Mapping[str, Config], options: Options
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield key and result of each job as it ends."""
    if not pending:
        return
    calls = (joblib.delayed(_job)(function, key, config) for key, config in pending.items())
    with _backend(options):
        count = min(options.jobs or joblib.cpu_count(), len(pending))
        if options.backend == "dask":
            count = options.jobs or -1
        parallel: Any = joblib.Parallel(n_jobs=count, return_as="generator_unordered")
        yield from parallel(calls)


def _job(
    function: Callable[[Config], Mapping[str, Any]], key: str, config: Config
) -> tuple[str, Mapping[str, Any]]:
    """Run one job with one BLAS thread; in the worker."""
    with threadpoolctl.threadpool_limits(1):
        try:
            return key, function(config)
        except Exception as error:
            error.add_note(f"in job {config}")
            raise


@contextlib.contextmanager
def _backend(options: Options) -> Iterator[None]:
    if options.backend == "loky":
        with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
            yield
        return
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise ExperimentError(
            "--backend dask: the package distributed is missing (pip install distributed)"
        ) from None
    try:
        client = distributed.Client(options.scheduler, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        raise ExperimentError(f"--scheduler {options.scheduler}: {error}") from None
    with client, joblib.parallel_config(backend="dask"):
        yield


def _progress() -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=Console(stderr=True))


def _job_key(function: Callable[..., Any], config: Any) -> str:
    name = f"{function.__module__}.{function.__qualname__}"
    text = json.dumps([name, plain(config)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def _write(path: Path, config: Any, result: Mapping[str, Any]) -> None:
    """Write one job: its arrays as they are, all else as JSON text; never half written."""
    arrays = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    for name, value in arrays.items():
        if value.dtype.hasobject:
            raise TypeError(f"job result {name}: an array of objects cannot be kept")
    rest = {name: value for name, value in result.items() if name not in arrays}
    text = json.dumps({"config": plain(config), "result": rest}, default=plain)
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("wb") as stream:
        np.savez(stream, allow_pickle=False, json=np.array(text), **_prefixed(arrays))
    os.replace(partial, path)


def _read(path: Path) -> Result | None:
    """Read one job; None if it is not there or was damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            result = json.loads(str(stored["json"]))["result"]
            names = [name for name in stored.files if name.startswith("array/")]
            return {**result, **{name.removeprefix("array/"): stored[name] for name in names}}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None


def _prefixed(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    return {f"array/{name}": value for name, value in arrays.items()}
