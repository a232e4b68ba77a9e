import json
import os
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments.harness import output as output_module
from experiments.harness import provenance
from experiments.harness.catalogue import EXPERIMENTS
from experiments.harness.contract import ExperimentError, Options, RepeatedOptions
from experiments.harness.output import Output, plain
from experiments.harness.summary import print_summary


@pytest.fixture
def output(tmp_path):
    return Output("tiny", Options(out=tmp_path))


def test_every_experiment_of_the_catalogue_keeps_the_contract():
    for experiment in EXPERIMENTS.values():
        assert issubclass(experiment.options_type(), Options)
        experiment.options_type()()
        assert callable(experiment.load())
        assert experiment.summary and experiment.thesis


def test_outputs_appear_only_at_the_end_and_replace_old_figures(output, tmp_path):
    output.figure("figure_1", Figure())
    assert not (output.directory / "figures").exists()
    output.finish()
    again = Output("tiny", Options(out=tmp_path))
    again.figure("figure_2", Figure())
    assert [path.name for path in (output.directory / "figures").iterdir()] == ["figure_1.png"]
    again.finish()
    assert [path.name for path in (output.directory / "figures").iterdir()] == ["figure_2.png"]


def test_a_film_of_the_previous_run_is_deleted_and_other_files_stay(output, tmp_path):
    output.file("film.gif").write_bytes(b"film")
    output.finish()
    (output.directory / "notes.txt").write_text("mine")
    run = json.loads((output.directory / "run.json").read_text())
    assert run["files"] == ["config.json", "film.gif", "metrics.json", "run.json"]
    Output("tiny", Options(out=tmp_path)).finish()
    assert not (output.directory / "film.gif").exists()
    assert (output.directory / "notes.txt").read_text() == "mine"
    (output.directory / "run.json").write_text('{"files": 3}')
    Output("tiny", Options(out=tmp_path)).finish()


class Killed(BaseException):
    """Stands for the end of the process."""


def count_down(function, steps):
    """Return a function that works until the steps are used up; then the process is dead."""

    def step(*words):
        if next(steps, None) is None:
            raise Killed
        return function(*words)

    return step


def write_run(out, seed):
    """Publish a run with a file that only this seed has."""
    output = Output("tiny", Options(out=out, seed=seed))
    output.measure("seed", seed)
    output.table(f"table_{seed}", ["a"], [[seed]])
    output.file(f"film_{seed}.gif").write_bytes(b"film")
    try:
        output.finish()
    except Killed:
        output._lock.close()  # as the kernel does
        raise


def test_a_run_that_is_killed_while_it_publishes_leaves_nothing_in_the_next(tmp_path, monkeypatch):
    remove, replace = output_module._remove, os.replace
    monkeypatch.setattr(provenance, "describe_run", lambda _: {})  # asks git
    write_run(tmp_path, 0)
    for moment in range(1000):
        steps = iter(range(moment))
        with monkeypatch.context() as dying:
            dying.setattr(output_module, "_remove", count_down(remove, steps))
            dying.setattr(os, "replace", count_down(replace, steps))
            try:
                write_run(tmp_path, 1)
                whole = True
            except Killed:
                whole = False
        folder = tmp_path / "tiny"
        if (folder / "metrics.json").exists():
            seed = json.loads((folder / "metrics.json").read_text())["measured"]["seed"]
            assert names(folder) == expected_names(seed)
        write_run(tmp_path, 2)
        assert names(folder) == expected_names(2) and not list(folder.glob(".partial-*"))
        if whole:
            break
    assert moment > 10


def names(folder):
    """Return the files of a folder that are not hidden, or hidden in a hidden folder."""
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
    return {str(path.relative_to(folder)) for path in paths if ".partial" not in str(path)}


def expected_names(seed):
    own = {f"film_{seed}.gif", f"tables/table_{seed}.csv"}
    return {"metrics.json", "config.json", "run.json", *own}


def test_a_folder_is_one_run_s_until_it_ends(output, tmp_path):
    with pytest.raises(ExperimentError, match="tiny: in use by process"):
        Output("tiny", Options(out=tmp_path))
    output.file("film.gif").write_bytes(b"film")
    output.close()
    assert names(output.directory) == set()
    again = Output("tiny", Options(out=tmp_path))
    again.finish()
    assert [path.name for path in output.directory.glob(".*")] == [".lock"]


def test_two_runs_never_write_to_the_same_temporary_file(output, tmp_path):
    first = output.file("run.rrd")
    output.close()
    assert Output("tiny", Options(out=tmp_path)).file("run.rrd") != first


def test_all_is_on_the_disk_before_the_old_results_go(output, monkeypatch):
    output.figure("figure_1", Figure())
    synced, remove, fsync = set(), output_module._remove, os.fsync

    def note(descriptor):
        synced.add(Path(os.readlink(f"/proc/self/fd/{descriptor}")).name)
        fsync(descriptor)

    def check(path):
        assert {"figure_1.png", "figures", "config.json", "run.json", "metrics.json"} <= synced
        remove(path)

    monkeypatch.setattr(os, "fsync", note)
    monkeypatch.setattr(output_module, "_remove", check)
    output.finish()
    assert "tiny" in synced  # the folder itself: its new names


def test_what_is_not_a_number_becomes_null(output):
    output.measure("never", np.array([np.inf, 1.0, np.nan]))
    output.finish()
    metrics = json.loads((output.directory / "metrics.json").read_text())
    assert metrics["measured"]["never"] == [None, 1.0, None]


def test_misuse_is_refused(output):
    output.measure("a", 1)
    with pytest.raises(ValueError, match="measured twice"):
        output.measure("a", 2)
    with pytest.raises(ValueError, match="file name"):
        output.file("../escape")
    with pytest.raises(ValueError, match="columns"):
        output.table("t", ["a", "b"], [[1]])
    with pytest.raises(TypeError, match="no form in JSON"):
        output.measure("b", object())


def test_plain_takes_paths_and_dataclasses():
    assert plain(Options(out=Path("x")))["out"] == "x"


def test_more_repetitions_extend_the_seeds_and_leave_the_first():
    few, many = RepeatedOptions(seeds=3).job_seeds(50, 5), RepeatedOptions().job_seeds(50, 5)
    assert many[:3] == few and len(set(many)) == 50
    assert len(RepeatedOptions(quick=True).job_seeds(50, 5)) == 5
    assert RepeatedOptions(seed=1).job_seeds(50, 5) != many


def test_terminal_shows_units_in_brackets(output, capsys):
    output.check("worst error [mm]", 0.25, "<= 1", ok=True)
    print_summary(next(iter(EXPERIMENTS.values())), output)
    assert "worst error [mm]: 0.25 (bound <= 1)" in capsys.readouterr().out
