"""Many runs that are killed, damaged, or two in one folder; a quarter of an hour in all.

``python -m pytest -s tests/experiments/harness/check_killing.py`` runs this file; the tests do the
same with smaller numbers.
"""

import collections
import signal
import time

import numpy as np

from tests.experiments.harness.killing import (
    SPAN,
    WORDS,
    damage_and_resume,
    kill_and_resume,
    published,
    run_two,
    undisturbed,
)

KILLS = 50
FLIPS = 3000
PAIRS = 20


def test_killed_runs_resume_to_what_an_undisturbed_run_publishes(tmp_path):
    rng = np.random.default_rng(0)
    whole = undisturbed(tmp_path / "whole")
    kept, killed = [], 0
    for index in range(KILLS):
        delay, workers, everyone = (
            rng.uniform(0.0, SPAN),
            int(rng.integers(1, 3)),
            rng.random() < 0.5,
        )
        after = (signal.SIGKILL, everyone, lambda seconds, delay=delay: seconds >= delay)
        words = [*WORDS, "--jobs", str(workers)]
        trial = kill_and_resume(words, "tiny", tmp_path / str(index), after)
        assert trial.lost == 0 and trial.published == whole
        killed += trial.status == -signal.SIGKILL
        kept.append(trial.finished)
    print(f"{killed} of {KILLS} runs killed before their end, with {min(kept)} to {max(kept)} jobs")
    assert killed > KILLS / 2 and any(0 < count < int(WORDS[-1]) for count in kept)


def test_of_two_runs_in_one_folder_one_at_a_time_publishes(tmp_path):
    rng = np.random.default_rng(0)
    whole = [undisturbed(tmp_path / f"whole_{seed}", seed) for seed in (1, 2)]
    ends = collections.Counter()
    for _ in range(PAIRS):
        delay = rng.uniform(0.0, SPAN) * rng.integers(2)  # half of them start together
        out = tmp_path / "both"  # with what the pair before has left
        words = [*WORDS, "--jobs", "2"]
        statuses, errors, _ = run_two(words, (1, 2), out, lambda delay=delay: time.sleep(delay))
        ends[statuses] += 1
        assert statuses in ((0, 0), (0, 1), (1, 0))
        for status, error in zip(statuses, errors):
            refused = "in use by process" in error and error.count("\n") == 1
            assert status == 0 or refused, error
        assert published(out / "tiny") == whole[statuses[1] == 0]
    print(f"statuses of {PAIRS} pairs: {dict(ends)}")
    assert ends[0, 1] + ends[1, 0] > 0


def test_every_flipped_bit_is_noticed_and_no_result_is_wrong(tmp_path):
    counts = damage_and_resume(tmp_path, FLIPS, np.random.default_rng(0))
    print(f"of {FLIPS} flipped bits: noticed {counts[0]}, results right {counts[1]}")
    assert counts == (FLIPS, FLIPS, FLIPS)
