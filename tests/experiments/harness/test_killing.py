import signal

import numpy as np
import pytest

from tests.experiments.harness.killing import (
    draw,
    finished,
    kill_and_resume,
    living,
    run,
    started,
    wait_until,
)

WORDS = ["tests.experiments.harness.tiny", "tiny", "--sweep", "12"]
SPAN = 4.0
"""From before the first job until after the last, on most machines [s]."""


@pytest.mark.slow
def test_a_killed_run_loses_no_finished_job_and_resumes_to_the_same_metrics(tmp_path):
    rng = np.random.default_rng(8)
    assert run([*WORDS, "--jobs", "1"], tmp_path / "whole") == 0
    whole = (tmp_path / "whole" / "tiny" / "metrics.json").read_text()
    for index, workers in enumerate((1, 2)):
        out = tmp_path / str(index)
        words = [*WORDS, "--jobs", str(workers)]
        trial = kill_and_resume(words, "tiny", out, draw(rng, SPAN))
        assert trial.lost == 0
        assert (out / "tiny" / "metrics.json").read_text() == whole


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
