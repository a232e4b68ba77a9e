import contextlib
import dataclasses
import errno
import importlib
import os
from pathlib import Path

import numpy as np
import pytest

from experiments.harness import sweep as sweep_module
from experiments.harness.contract import ExperimentError, RepeatedOptions
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from tests.experiments.harness.tiny import Part, draw


def configs(folder, count, fatal=-1):
    return [
        {"folder": str(folder), "index": i, "fatal": fatal, "seed": 10 + i} for i in range(count)
    ]


def go(folder, jobs_list, **options):
    run = RepeatedOptions(out=folder, **options)
    with contextlib.closing(Output("tiny", run)) as output:
        return sweep(draw, jobs_list, run, output)


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


def test_resume_ignores_other_configurations(tmp_path):
    go(tmp_path, configs(tmp_path, 3), jobs=1)
    changed = [{**config, "seed": 99} for config in configs(tmp_path, 1)]
    before = calls(tmp_path)
    results = go(tmp_path, [*changed, *configs(tmp_path, 3)], jobs=1, resume=True)
    assert calls(tmp_path) - before == 1
    assert not np.array_equal(results[0].numbers, results[1].numbers)


@pytest.mark.parametrize("damage", ["empty", "short", "long", "flipped"])
def test_resume_runs_damaged_jobs_anew_and_names_their_files(tmp_path, capsys, damage):
    first = go(tmp_path, configs(tmp_path, 3), jobs=1)
    paths = sorted((tmp_path / "tiny" / "jobs").iterdir())
    for path in paths[:2]:
        whole = path.read_bytes()
        middle = len(whole) // 2
        flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
        path.write_bytes(
            {"empty": b"", "short": whole[:-1], "long": whole + b"x", "flipped": flipped}[damage]
        )
    before = calls(tmp_path)
    capsys.readouterr()
    again = go(tmp_path, configs(tmp_path, 3), jobs=1, resume=True)
    assert calls(tmp_path) - before == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "damaged" in line]
    assert sorted(lines) == [f"{path}: damaged, so its job runs again" for path in paths[:2]]
    for a, b in zip(first, again):
        assert np.array_equal(a.numbers, b.numbers) and a.sum == b.sum


def test_a_full_disk_keeps_the_jobs_before_and_names_the_file(tmp_path, monkeypatch):
    expected = go(tmp_path / "other", configs(tmp_path, 4), jobs=1)
    fsync, left = os.fsync, iter(range(4))  # Two of each job: its file and its folder.

    def full(descriptor):
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ExperimentError, match=r"[0-9a-f]{20}\.npz: No space left on device; "):
        go(tmp_path, configs(tmp_path, 4), jobs=1)
    monkeypatch.undo()
    assert len(list((tmp_path / "tiny" / "jobs").iterdir())) == 2
    before = calls(tmp_path)
    results = go(tmp_path, configs(tmp_path, 4), jobs=1, resume=True)
    assert calls(tmp_path) - before == 2
    assert [each.sum for each in results] == [each.sum for each in expected]


def test_what_a_killed_run_was_writing_is_taken_away(tmp_path):
    go(tmp_path, configs(tmp_path, 1), jobs=1)
    jobs = tmp_path / "tiny" / "jobs"
    (jobs / ".1234.npz.77.partial").write_bytes(b"half")
    go(tmp_path, configs(tmp_path, 1), jobs=1, resume=True)
    assert [path.suffix for path in jobs.iterdir()] == [".npz"]


def test_a_job_that_wrote_a_file_for_its_run_runs_again_for_the_next(tmp_path):
    for _ in range(2):
        run = RepeatedOptions(out=tmp_path, jobs=1, resume=True)
        output = Output("tiny", run)
        sweep(write_file, [str(output.file("run.rrd"))], run, output)
        output.finish()
        assert (tmp_path / "tiny" / "run.rrd").read_text() == "film"


def write_file(path) -> int:
    return Path(path).write_text("film")


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
    with pytest.raises(ExperimentError, match=r"pip install .fieldtwin\[dask\]"):
        go(tmp_path, configs(tmp_path, 1), backend="dask", scheduler="tcp://127.0.0.1:1")


def test_results_are_never_pickled(tmp_path):
    with pytest.raises(TypeError, match="objects"):
        run = RepeatedOptions(out=tmp_path, jobs=1)
        sweep(objects, [{"a": 1}], run, Output("tiny", run))
    assert not list(Path(tmp_path / "tiny" / "jobs").glob("*.npz"))


def objects(config) -> np.ndarray:
    return np.array([object()])
