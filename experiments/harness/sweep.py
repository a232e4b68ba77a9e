"""One function run over many configurations, in parallel, each result kept as it arrives."""

import contextlib
import dataclasses
import enum
import hashlib
import importlib
import io
import json
import os
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import joblib
import numpy as np
import threadpoolctl
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from experiments.harness.contract import ExperimentError, SweepOptions
from experiments.harness.output import Output, plain
from experiments.harness.storage import read_checked, write_checked
from twin.hardware.background import end_with_parent

Config = TypeVar("Config")
Result = TypeVar("Result")

CONNECT_TIMEOUT = 10.0  # [s] to reach a Dask scheduler


def sweep(
    function: Callable[[Config], Result],
    configs: Sequence[Config],
    options: SweepOptions,
    output: Output,
    *,
    label: str = "jobs",
) -> list[Result]:
    """Run a function over all configurations and return the results in the same order.

    Every result is written to OUT/NAME/jobs/ when it arrives, so an interrupted sweep keeps what
    it has; with ``--resume`` the jobs whose function and configuration are found there, undamaged,
    are not run again. Workers are fresh processes (never forked), each with one BLAS thread; on
    Linux they end with the process, and the thread, that called this.

    Args:
        function: A function of a module (workers import it). Its return annotation says what a
            stored result is read back as: dataclasses, tuples, lists and mappings of numbers,
            strings, arrays and None, nested as they may be.
        configs: Mappings or dataclasses of plain values, with the job's seed among them.
        options: Number of processes, backend, and whether to resume.
        output: Output of the experiment, which stores the results.
        label: Name of what the progress bar counts.

    Returns:
        One result for each configuration.

    Raises:
        ExperimentError: If the Dask cluster cannot be used, or a result is lost on the disk.
        Exception: What a job raised, with its configuration noted.
    """
    directory = output.jobs_directory()
    kind = get_type_hints(function)["return"]
    keys = [_job_key(function, config) for config in configs]
    paths = {key: directory / f"{key}.npz" for key in keys}
    pending = {key: config for key, config in zip(keys, configs) if _read(paths[key], kind) is None}
    for damaged in (paths[key] for key in pending if paths[key].exists()):
        print(f"{damaged}: damaged, so its job runs again", file=sys.stderr)
    with _progress() as progress:
        task = progress.add_task(label, total=len(paths), completed=len(paths) - len(pending))
        for key, result in _results(function, pending, options):
            _write(paths[key], pending[key], result)
            progress.advance(task)
    finished: dict[str, Result] = {}
    for key, path in paths.items():
        stored = _read(path, kind)
        if stored is None:  # To leave it out would shift all results behind it.
            raise ExperimentError(f"{path}: lost after it was written; --resume runs it again")
        (finished[key],) = stored
    return [finished[key] for key in keys]


def seeded_chunks(count: int, size: int, seed: int | tuple[int, ...]) -> list[tuple[int, int]]:
    """Divide repetitions into jobs.

    Args:
        count: Number of repetitions.
        size: Number of repetitions in a job, at most.
        seed: Root of the jobs' seeds.

    Returns:
        Seed and number of repetitions of each job.
    """
    sizes = [min(size, count - first) for first in range(0, count, size)]
    return list(zip(np.random.SeedSequence(seed).generate_state(len(sizes)).tolist(), sizes))


def concatenated(parts: Sequence[Result]) -> Result:
    """Return dataclasses of arrays as one, each field joined along its first axis.

    Args:
        parts: Results of one type, at least one.
    """
    fields = dataclasses.fields(cast("Any", parts[0]))
    columns = (np.concatenate([getattr(part, field.name) for part in parts]) for field in fields)
    return type(parts[0])(*columns)


def _results(
    function: Callable[[Config], Result], pending: Mapping[str, Config], options: SweepOptions
) -> Iterator[tuple[str, Result]]:
    """Yield key and result of each job as it ends."""
    if not pending:
        return
    calls = (joblib.delayed(_job)(function, key, config) for key, config in pending.items())
    with _backend(options):
        local = min(options.jobs or joblib.cpu_count(), len(pending))
        count = options.jobs or -1 if options.backend == "dask" else local
        parallel: Any = joblib.Parallel(n_jobs=count, return_as="generator_unordered")
        yield from parallel(calls)


def _job(function: Callable[[Config], Result], key: str, config: Config) -> tuple[str, Result]:
    """Run one job with one BLAS thread; in the worker."""
    with threadpoolctl.threadpool_limits(1):
        try:
            return key, function(config)
        except Exception as error:
            error.add_note(f"in job {config}")
            raise


@contextlib.contextmanager
def _backend(options: SweepOptions) -> Iterator[None]:
    if options.backend == "loky":
        with joblib.parallel_config(
            backend="loky",
            inner_max_num_threads=1,
            initializer=end_with_parent,  # Else workers finish their jobs for nobody.
            initargs=(os.getpid(),),
        ):
            yield
        return
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise ExperimentError(
            "--backend dask: the package distributed is missing (pip install 'fieldtwin[dask]')"
        ) from None
    try:
        client = distributed.Client(options.scheduler, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        raise ExperimentError(f"--scheduler {options.scheduler}: {error}") from None
    with client, joblib.parallel_config(backend="dask"):
        yield


def _progress() -> Progress:
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    return Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True))


def _job_key(function: Callable[..., Any], config: Any) -> str:
    name = f"{function.__module__}.{function.__qualname__}"
    text = json.dumps([name, plain(config)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def _write(path: Path, config: Any, result: Any) -> None:
    """Write one job: its arrays as they are, all else as JSON text."""
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps({"config": plain(config), "result": _stored(result, arrays)})
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, json=np.array(text), **arrays)
    write_checked(path, stream.getvalue())


def _read(path: Path, kind: Any) -> tuple[Any] | None:
    """Read one job's result (in a tuple, as it may be None); None if missing or damaged."""
    content = read_checked(path)
    if content is None:
        return None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            result = json.loads(str(stored["json"]))["result"]
            return (_restored(result, kind, {name: stored[name] for name in stored.files}),)
    except (TypeError, ValueError, KeyError) as error:
        raise ExperimentError(
            f"{path}: of a version with other results ({error}); run again without --resume"
        ) from None


def _stored(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """Return a result as JSON can hold it, and collect its arrays, each under a name."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("a job's result holds an array of objects, which cannot be stored")
        name = f"array_{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: _stored(getattr(value, name), arrays) for name in names}
    if isinstance(value, Mapping):
        return {key: _stored(item, arrays) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_stored(item, arrays) for item in value]
    if isinstance(value, enum.Enum):
        return value.value
    return value.item() if isinstance(value, np.generic) else value


def _restored(value: Any, kind: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Return what `_stored` made JSON of, as the type that the function's annotation names."""
    if isinstance(value, dict) and set(value) == {"array"}:
        return arrays[value["array"]]
    kinds = [each for each in get_args(kind) if each is not type(None)]
    if get_origin(kind) in (types.UnionType, Union):
        return value if value is None or len(kinds) > 1 else _restored(value, kinds[0], arrays)
    if isinstance(kind, type) and (dataclasses.is_dataclass(kind) or hasattr(kind, "_fields")):
        hints = get_type_hints(kind)
        items = value if isinstance(value, dict) else dict(zip(hints, value))
        return kind(
            **{name: _restored(item, hints.get(name), arrays) for name, item in items.items()}
        )
    if isinstance(value, dict):
        return {key: _restored(item, (*kinds, Any, Any)[1], arrays) for key, item in value.items()}
    if isinstance(value, list):
        same = not kinds or len(kinds) == 1 or kinds[1] is Ellipsis
        each = [kinds[0] if kinds else Any] * len(value) if same else kinds
        items = [_restored(item, item_kind, arrays) for item, item_kind in zip(value, each)]
        return tuple(items) if get_origin(kind) is tuple else items
    return kind(value) if isinstance(kind, type) and issubclass(kind, enum.Enum) else value
