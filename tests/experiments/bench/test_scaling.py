"""The scaling curves, inverse kinematics beside brute force, and the table of all benchmarks."""

import json

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.bench import scaling as bench_scaling
from experiments.bench.scaling import exponent
from experiments.harness.contract import OptionError, RepeatedOptions
from experiments.harness.output import Output
from experiments.report.bench_table import BEGIN, END, ROWS, write_between_marks
from tests.experiments.harness.tiny import CATALOGUE


def test_a_power_law_s_exponent_is_found():
    assert exponent({size: 3.0 * size**1.7 for size in (1, 2, 4, 8)}) == pytest.approx(1.7)
    noise = np.random.default_rng(0).normal(0.0, 0.01, 4)
    noisy = {size: float(np.exp(e) / size) for size, e in zip((1, 2, 4, 8), noise)}
    assert exponent(noisy) == pytest.approx(-1.0, abs=0.03)


def test_a_resumed_sweep_is_timed_anew_and_one_core_has_no_exponent(tmp_path, monkeypatch):
    monkeypatch.setattr(bench_scaling, "free_cores", lambda: 1)
    monkeypatch.setattr(bench_scaling, "SWEPT", 2)
    options = RepeatedOptions(quick=True, out=tmp_path, resume=True)
    kept = []
    for _ in range(2):
        output = Output("bench", options)
        curve = bench_scaling._sweeps(options, output, rounds=1)
        assert list(curve.times) == [1] and curve.exponents == []
        kept.append(len(list(output.jobs_directory().glob("*.npz"))))
        output.close()
    assert kept == [4, 8]  # two jobs in a round, and one round is not counted


def result(folder, measured, checks=()):
    """Make a result of bench."""
    assert main(["tiny", "--out", str(folder)], CATALOGUE) == 0
    (folder / "tiny").rename(folder / "bench")
    metrics = {"measured": measured, "thesis": {}, "checks": list(checks)}
    (folder / "bench" / "metrics.json").write_text(json.dumps(metrics))
    (folder / "bench" / "run.json").write_text("{}")  # no digest of other metrics


def test_the_table_has_value_interval_and_bar(tmp_path, capsys):
    overhead = {"median": 1.2345, "mean": 1.2, "low": 1.111, "high": 1.3, "p95": 1.4, "n": 9}
    result(
        tmp_path,
        {"loop_overhead": overhead, "memory_bytes/1mm": 344523316},
        [
            {"name": "loop overhead, plane", "value": 1.23, "bound": "<= 1.2", "ok": False},
            {"name": "mapping, memory at 1 mm over 1.5 m", "value": 1, "bound": "<= 1e9", "ok": 1},
        ],
    )
    capsys.readouterr()
    assert main(["bench-table", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "| 1.23 times (1.11 to 1.3) | <= 1.2: **falls short** |" in lines[2]
    memory = next(line for line in lines if "memory" in line)
    assert memory.endswith("| 345 MB | <= 1000: holds |")
    assert sum("| not run |" in line for line in lines) == len(ROWS) - 2
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1


def test_the_table_is_written_between_its_marks_and_nowhere_else(tmp_path):
    path = tmp_path / "README.md"
    path.write_text(f"# a\n{BEGIN}\nold\n{END}\nb\n")
    for table in ("new", "newer"):
        write_between_marks(path, table)
        assert path.read_text() == f"# a\n{BEGIN}\n\n{table}\n\n{END}\nb\n"
    for text in ("# a\n", f"{END}{BEGIN}", f"{BEGIN}{BEGIN}{END}"):
        path.write_text(text)
        with pytest.raises(OptionError, match="expected one"):
            write_between_marks(path, "new")
        assert path.read_text() == text


def test_a_table_of_nothing_is_refused(tmp_path, capsys):
    assert main(["bench-table", "--out", str(tmp_path)]) == 1
    assert "run python -m experiments bench first" in capsys.readouterr().err


@pytest.mark.slow
def test_brute_force_finds_no_better_word_and_curves_are_drawn(tmp_path):
    names = ["braid", "scaling"]
    words = ["bench", "--quick", "--only", *names, "--out", str(tmp_path)]
    assert main(words) == 0
    measured = json.loads((tmp_path / "bench" / "metrics.json").read_text())["measured"]
    assert measured["braid_same_cost"] == 1.0
    # Times and their growth are figures of the report.
    assert measured["braid_speedup/5"] > 0.0
    for what in ("robots", "stages", "voxels"):
        assert np.isfinite(measured[f"scaling_exponent/{what}"]["median"])
        times = [measured[key] for key in measured if key.startswith(f"scaling_s/{what}/")]
        assert len(times) > 1 and all(time["median"] > 0.0 for time in times)
    ours = {row.key for row in ROWS if row.key.startswith(("braid", "scaling_"))}
    assert len(ours) == 5 and ours <= set(measured)  # noqa: PLR2004
    assert (tmp_path / "bench" / "figures" / "scaling.png").exists()
