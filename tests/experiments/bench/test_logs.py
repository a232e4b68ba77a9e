"""Reading of logs, timed: whole logs are read in each format, and one that is not is no result."""

import json

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.bench import logs


def test_all_formats_are_read_and_timed(tmp_path, monkeypatch):
    # A process of its own for each takes longer than the rest.
    monkeypatch.setattr(logs, "_in_own_process", logs._timed)
    assert main(["bench", "--only", "logs", "--quick", "--out", str(tmp_path)]) == 0
    measured = json.loads((tmp_path / "bench" / "metrics.json").read_text())["measured"]
    for name in logs.FORMATS:
        assert measured[f"log_read_s/{name}"] > 0.0
        assert measured[f"log_read_ratio/{name}"] > 0.0
        assert measured[f"log_memory_mb/{name}"] > 1.0


def test_a_log_that_is_cut_short_is_no_result(tmp_path):
    path = tmp_path / "run.csv"
    logs.FORMATS["csv"].write(logs._log(1.0, np.random.default_rng(0)), path)
    logs._read(1.0, path)
    with pytest.raises(AssertionError, match="20 fields"):
        logs._read(2.0, path)


def test_a_process_of_its_own_tells_its_own_memory_alone(tmp_path):
    held = np.ones(150_000_000)
    path = tmp_path / "run.csv"
    logs.FORMATS["csv"].write(logs._log(1.0, np.random.default_rng(0)), path)
    seconds, memory = logs._in_own_process(logs.FORMATS["csv"].read_alone, path)
    assert seconds > 0.0 and 2e7 < memory < held.nbytes
