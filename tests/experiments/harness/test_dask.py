"""Sweeps on a Dask cluster of this machine."""

import json

import distributed
import pytest

from experiments.__main__ import main

TIMED = "tests_per_second"


def metrics(folder):
    contents = json.loads((folder / "ch4-montecarlo" / "metrics.json").read_text())
    contents["measured"].pop(TIMED)
    contents["checks"] = [each for each in contents["checks"] if "second" not in each["name"]]
    return contents


@pytest.mark.slow
def test_a_sweep_on_two_dask_workers_gives_what_local_processes_give(tmp_path):
    words = ["ch4-montecarlo", "--quick", "--seeds", "4"]
    assert main([*words, "--jobs", "2", "--out", str(tmp_path / "local")]) == 0
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        words += ["--backend", "dask", "--scheduler", address, "--out", str(tmp_path / "dask")]
        assert main(words) == 0
        with distributed.Client(address) as client:
            shares = client.run(lambda dask_worker: dask_worker.state.executed_count)
    assert len(shares) == 2 and all(shares.values())  # noqa: PLR2004
    assert metrics(tmp_path / "dask") == metrics(tmp_path / "local")
