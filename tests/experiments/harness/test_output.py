import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from experiments.harness.catalogue import EXPERIMENTS
from experiments.harness.contract import Options
from experiments.harness.output import Output, plain
from experiments.harness.summary import print_summary


@pytest.fixture
def output(tmp_path):
    return Output("tiny", Options(out=tmp_path))


def test_every_experiment_of_the_catalogue_keeps_the_contract():
    for experiment in EXPERIMENTS.values():
        options_type, _ = experiment.load()
        options_type()
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
    few, many = Options(seeds=3).job_seeds(50, 5), Options().job_seeds(50, 5)
    assert many[:3] == few and len(set(many)) == 50
    assert len(Options(quick=True).job_seeds(50, 5)) == 5
    assert Options(seed=1).job_seeds(50, 5) != many


def test_terminal_shows_units_in_brackets(output, capsys):
    output.check("worst error [mm]", 0.25, "<= 1", ok=True)
    print_summary(next(iter(EXPERIMENTS.values())), output)
    assert "worst error [mm]: 0.25 (bound <= 1)" in capsys.readouterr().out
