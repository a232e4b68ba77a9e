import signal

import numpy as np
import pytest

from experiments.__main__ import main
from tests.experiments.harness.killing import (
    PATIENCE,
    SPAN,
    WORDS,
    damage_and_resume,
    draw,
    finished,
    kill_and_resume,
    living,
    published,
    started,
    undisturbed,
    wait_until,
)
from tests.experiments.harness.tiny import CATALOGUE


@pytest.mark.slow
def test_a_killed_run_loses_no_finished_job_and_resumes_to_the_same_metrics(tmp_path):
    rng = np.random.default_rng(8)
    for workers in (1, 2):
        words = [*WORDS, "--jobs", str(workers)]
        trial = kill_and_resume(words, "tiny", tmp_path / str(workers), draw(rng, SPAN))
        assert trial.lost == 0
        assert trial.published == undisturbed(tmp_path / "whole")


@pytest.mark.slow
def test_an_interrupted_run_ends_with_status_130_and_keeps_what_it_has(tmp_path):
    words = [*WORDS[:-1], "30", "--jobs", "1"]
    some = lambda _: finished(tmp_path / "tiny") >= 3  # noqa: E731, PLR2004
    trial = kill_and_resume(words, "tiny", tmp_path, (signal.SIGINT, True, some))
    assert trial.status == 130  # noqa: PLR2004
    assert 3 <= trial.finished < 30 and trial.lost == 0  # noqa: PLR2004


@pytest.mark.slow
def test_the_workers_of_a_killed_sweep_end_with_it(tmp_path):
    words = [*WORDS[:-1], "90", "--jobs", "2"]
    with started(words, tmp_path) as process:
        wait_until(lambda: finished(tmp_path / "tiny") >= 1)
        assert len(living(process.pid)) > 2  # noqa: PLR2004
        process.kill()
        process.wait()
        assert wait_until(lambda: not living(process.pid)) < 5  # noqa: PLR2004


@pytest.mark.slow
def test_a_second_run_into_a_folder_is_refused_and_the_first_goes_on(tmp_path, capsys):
    words = [*WORDS, "--jobs", "1"]
    folder = tmp_path / "tiny"
    with started([*words, "--seed", "1"], tmp_path) as first:
        wait_until(lambda: finished(folder) >= 1)
        assert main([*words[1:], "--seed", "2", "--out", str(tmp_path)], CATALOGUE) == 1
        assert first.wait(PATIENCE) == 0
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"error: {folder}: in use by process {first.pid} on ")
    assert "only_of_seed_1.txt" in published(folder)
    assert "only_of_seed_2.txt" not in published(folder)


@pytest.mark.chosen_seed  # One draw of a bit for each damaged file.
def test_a_flipped_bit_of_a_job_file_is_noticed_and_its_job_runs_again(tmp_path):
    """`check_killing.py` flips more of them."""
    assert damage_and_resume(tmp_path, 50, np.random.default_rng(0)) == (50, 50, 50)
