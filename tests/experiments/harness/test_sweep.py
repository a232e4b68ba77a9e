import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest

from experiments.harness import sweep as sweep_module
from experiments.harness.contract import ExperimentError, Options
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from tests.experiments.harness.tiny import Part, draw


def configs(folder, count, fatal=-1):
    return [
        {"folder": str(folder), "index": i, "fatal": fatal, "seed": 10 + i} for i in range(count)
    ]


def go(folder, jobs_list, **options):
    run = Options(out=folder, **options)
    return sweep(draw, jobs_list, run, Output("tiny", run))


def calls(folder):
    return len((folder / "calls").read_text())


@pytest.mark.chosen_seed  # No option reaches the other processes.
def test_results_come_in_order_and_alike_from_one_process_and_two(tmp_path):
    one = go(tmp_path, configs(tmp_path, 5), jobs=1)
    two = go(tmp_path, configs(tmp_path, 5), jobs=2)
    for index, (a, b) in enumerate(zip(one, two)):
        expected = np.random.default_rng(10 + index).normal(size=(2, 3))
        assert np.array_equal(a.numbers, expected) and np.array_equal(b.numbers, expected)
        assert a.sum == b.sum == expected.sum() and a.pair == (1, 2) and a.never == float("inf")
        assert a.nothing is None and [part.label for part in a.parts] == ["row 0", "row 1"]
        assert np.array_equal([part.rows["row"] for part in a.parts], expected)


def test_interrupted_sweep_keeps_what_it_has_and_resumes(tmp_path):
    (tmp_path / "fatal").touch()
    with pytest.raises(ValueError, match="the job is broken") as caught:
        go(tmp_path, configs(tmp_path, 6, fatal=4), jobs=1)
    assert any("'index': 4" in note for note in caught.value.__notes__)
    assert len(list((tmp_path / "tiny" / "jobs").glob("*.npz"))) == 4
    (tmp_path / "fatal").unlink()
    before = calls(tmp_path)
    results = go(tmp_path, configs(tmp_path, 6, fatal=4), jobs=1, resume=True)
    assert len(results) == 6 and calls(tmp_path) - before == 2


def test_resume_ignores_other_configurations_and_damaged_files(tmp_path):
    go(tmp_path, configs(tmp_path, 3), jobs=1)
    changed = [{**config, "seed": 99} for config in configs(tmp_path, 1)]
    before = calls(tmp_path)
    results = go(tmp_path, [*changed, *configs(tmp_path, 3)], jobs=1, resume=True)
    assert calls(tmp_path) - before == 1
    assert not np.array_equal(results[0].numbers, results[1].numbers)
    for path in (tmp_path / "tiny" / "jobs").iterdir():
        path.write_bytes(path.read_bytes()[:50])
    before = calls(tmp_path)
    go(tmp_path, configs(tmp_path, 3), jobs=1, resume=True)
    assert calls(tmp_path) - before == 3


def test_resuming_results_of_another_shape_is_reported_in_one_line(tmp_path, monkeypatch):
    go(tmp_path, configs(tmp_path, 1), jobs=1)
    for other in (Renamed, Part):
        monkeypatch.setitem(draw.__annotations__, "return", other)
        with pytest.raises(ExperimentError, match=r"\.npz: .*run again without --resume"):
            go(tmp_path, configs(tmp_path, 1), jobs=1, resume=True)


@dataclasses.dataclass(frozen=True)
class Renamed:
    """A result of another version: no field is missing or the same."""

    total: float = 0.0


def test_a_lost_result_is_named_and_not_left_out(tmp_path, monkeypatch):
    read = sweep_module._read
    lost = iter([False, False, False, False, True, False])  # three looked for, three read
    monkeypatch.setattr(sweep_module, "_read", lambda *words: None if next(lost) else read(*words))
    with pytest.raises(ExperimentError, match=r"[0-9a-f]{20}\.npz: lost after it was written"):
        go(tmp_path, configs(tmp_path, 3), jobs=1)


def test_without_resume_every_job_runs_again(tmp_path):
    go(tmp_path, configs(tmp_path, 2), jobs=1)
    go(tmp_path, configs(tmp_path, 2), jobs=1)
    assert calls(tmp_path) == 4


def test_missing_dask_is_reported_in_one_error(tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ExperimentError, match="pip install distributed"):
        go(tmp_path, configs(tmp_path, 1), backend="dask", scheduler="tcp://127.0.0.1:1")


def test_results_are_never_pickled(tmp_path):
    with pytest.raises(TypeError, match="objects"):
        run = Options(out=tmp_path, jobs=1)
        sweep(objects, [{"a": 1}], run, Output("tiny", run))
    assert not list(Path(tmp_path / "tiny" / "jobs").glob("*.npz"))


def objects(config) -> np.ndarray:
    return np.array([object()])
