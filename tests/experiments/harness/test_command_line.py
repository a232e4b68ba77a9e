import dataclasses
import errno
import json
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.__main__ import main
from experiments.harness.catalogue import COMMANDS, EXPERIMENTS
from experiments.harness.command_line import parse
from tests.experiments.harness.tiny import CATALOGUE


def call(*words):
    return main([str(word) for word in words], CATALOGUE)


def read(path):
    return json.loads(path.read_text())


def test_process_leaves_all_files_and_status_0(tmp_path):
    words = ["tiny", "--out", str(tmp_path), "--seeds", "40", "--seed", "3", "--record"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.experiments.harness.tiny", *words],
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "tiny"
    metrics = read(folder / "metrics.json")
    assert set(metrics) == {"measured", "thesis", "checks"}
    assert metrics["thesis"] == {"error_percent": 18.9}
    assert set(metrics["measured"]["error_percent"]) == {
        "median", "mean", "low", "high", "p95", "n"
    }  # fmt: skip
    assert [check["ok"] for check in metrics["checks"]] == [False, True]
    config = read(folder / "config.json")
    assert config["seed"] == 3 and config["mass"] == 1.0 and config["quick"] is False
    run = read(folder / "run.json")
    assert run["wall_time_s"] > 0 and run["cpu"] and run["versions"]["mujoco"]
    assert (folder / "figures" / "figure_2-4.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "tables" / "table_2-1.csv").read_text().startswith("mass [kg],error [%]\n")
    assert (folder / "run.rrd").read_bytes().startswith(b"RRF2")
    assert not list(folder.glob(".partial*"))
    assert "error is small" in done.stdout and "figure_2-4.png" in done.stdout
    assert "/." not in done.stdout  # no hidden file


def test_same_seed_gives_same_metrics(tmp_path):
    texts = []
    for _ in range(2):
        assert call("tiny", "--out", tmp_path) == 0
        texts.append((tmp_path / "tiny" / "metrics.json").read_text())
    assert texts[0] == texts[1]


def test_without_name_experiments_are_listed_without_importing_them(capsys):
    lazy = [sys.executable, "-m", "experiments"]
    done = subprocess.run(lazy, check=True, capture_output=True, text=True)
    for name in ("bench", "doctor", "report"):
        assert name in done.stdout
    assert call() == 0
    assert "a tiny experiment [Table 0]" in capsys.readouterr().out
    code = "import experiments.__main__, sys; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["tiny", "--mass", "-1"], "--mass: -1.0 kg is not positive"),
        (["tiny", "--mass", "heavy"], "--mass"),
        (["tiny", "--seeds", "0"], "--seeds: expected at least 1"),
        (["tiny", "--jobs", "-2"], "--jobs: expected at least 1"),
        (["tiny", "--seed", "-2"], "--seed: expected 0 or more"),
        (["tiny", "--sedes", "3"], "--sedes"),
        (["tiny", "--backend", "slurm"], "slurm"),
        (["tiny", "--backend", "dask"], "--scheduler"),
        (["tiny", "--scheduler", "tcp://x:1"], "--backend dask"),
        (["tiny", "--fault", "file"], "no such file"),
        (["tinny"], "did you mean tiny?"),
        (["silent", "--record"], "--record"),
        (["silent", "--live"], "--live"),
        (["silent", "--jobs", "2"], "--jobs"),
        (["silent", "--seeds", "2"], "--seeds"),
        (["tiny", "--format", "gif"], "Expected one of ('png', 'svg', 'pdf')"),
        (
            ["nothing-like-it"],
            "there are tiny, silent, view, drive, live, doctor, calibrate, truth-",
        ),
        (["doctor", "--deep"], "--deep"),
    ],
)
def test_bad_options_give_one_line_and_status_2(words, message, tmp_path, capsys):
    extra = ["--out", tmp_path] if words[0] == "tiny" else []
    assert call(*words, *extra) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and error.startswith("error: ") and message in error


def test_failure_gives_status_1_and_keeps_the_results_before_it(tmp_path, capsys):
    assert call("tiny", "--out", tmp_path) == 0
    before = (tmp_path / "tiny" / "metrics.json").read_text()
    capsys.readouterr()
    assert call("tiny", "--out", tmp_path, "--fault", "error") == 1
    assert capsys.readouterr().err == "error: the wheel fell off\n"
    assert call("tiny", "--out", tmp_path, "--fault", "bug") == 1
    error = capsys.readouterr().err
    assert "Traceback" in error and error.splitlines()[-1].startswith("error: tiny failed: KeyErr")
    assert call("tiny", "--out", tmp_path, "--fault", "interrupt") == 130
    assert (tmp_path / "tiny" / "metrics.json").read_text() == before


@pytest.mark.parametrize("inside", ["", "folder"])
def test_a_file_as_folder_of_results_gives_one_line_and_status_2(tmp_path, capsys, inside):
    (tmp_path / "file").write_text("mine")
    assert call("tiny", "--out", tmp_path / "file" / inside) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"{tmp_path / 'file'}" in error and "choose a folder" in error
    assert (tmp_path / "file").read_text() == "mine"


def test_a_folder_without_write_permission_gives_one_line_and_status_2(tmp_path, capsys):
    (tmp_path / "theirs").mkdir(0o555)
    user = os.geteuid()
    if user == 0:  # Permissions do not bind root.
        os.seteuid(65534)
    try:
        assert call("tiny", "--out", tmp_path / "theirs") == 2
    finally:
        os.seteuid(user)
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"{tmp_path / 'theirs'}" in error
    assert "Permission denied" in error


@pytest.mark.parametrize(
    ("refusal", "status"), [(errno.EROFS, 2), (errno.EDQUOT, 1), (errno.ENOSPC, 1)]
)
def test_a_disk_that_refuses_at_the_start_gives_one_line(
    tmp_path, capsys, monkeypatch, refusal, status
):
    def refuse(path, *_, **__):
        raise OSError(refusal, os.strerror(refusal), str(path))

    monkeypatch.setattr(Path, "mkdir", refuse)
    assert call("tiny", "--out", tmp_path) == status
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"{tmp_path / 'tiny'}: {os.strerror(refusal)}; " in error


def test_a_disk_that_fills_gives_one_line_and_leaves_the_results_before(tmp_path):
    assert call("tiny", "--out", tmp_path, "--seed", "1") == 0
    folder = tmp_path / "tiny"
    before = {path: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()}
    words = ["tiny", "--out", str(tmp_path), "--seed", "2"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.experiments.harness.tiny", *words],
        check=False,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000)),  # noqa: PLW1509
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and f"{folder}" in done.stderr
    assert "File too large; what was recorded before is kept" in done.stderr
    del before[folder / ".lock"]
    assert {path: path.read_bytes() for path in before} == before
    assert not list(folder.glob(".partial*"))


def test_help_lists_units_an_example_and_the_time_and_ends_with_status_0(capsys):
    with pytest.raises(SystemExit) as stop:
        call("tiny", "--help")
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert "[kg]" in text and "tiny --mass 2 --seeds 5\n" in text
    assert "less than a minute on two cores, a full one about ten minutes" in text


@pytest.mark.parametrize("command", [*EXPERIMENTS.values(), *COMMANDS.values()])
def test_example_of_each_help_is_accepted(command):
    words = command.example.split()
    parse(command, words[: words.index(">")] if ">" in words else words)


def test_figures_are_written_for_papers_as_well(tmp_path):
    assert call("tiny", "--out", tmp_path, "--format", "svg") == 0
    figures = tmp_path / "tiny" / "figures"
    assert {path.name for path in figures.iterdir()} == {"figure_2-4.png", "figure_2-4.svg"}
    assert "<svg" in (figures / "figure_2-4.svg").read_text()
    assert call("tiny", "--out", tmp_path) == 0
    assert {path.name for path in figures.iterdir()} == {"figure_2-4.png"}


def test_a_run_ends_with_what_to_look_at_next(tmp_path, capsys):
    assert call("tiny", "--out", tmp_path, "--record") == 0
    *_, recording, rest = capsys.readouterr().out.splitlines()
    assert recording == f"next: rerun {tmp_path}/tiny/run.rrd shows the recording"
    assert rest.startswith(f"next: look at {tmp_path}/tiny/figures/figure_2-4.png, or ")
    assert f"report --out {tmp_path} " in rest


def test_help_and_list_import_no_simulator():
    """In a process of its own; help ends it, as it does a command."""
    program = """
import contextlib, sys
from experiments.__main__ import main
from experiments.harness.catalogue import EXPERIMENTS
from experiments.harness.catalogue import COMMANDS, EXPERIMENTS
main(["list"])
for name in (*COMMANDS, *EXPERIMENTS):
    with contextlib.suppress(SystemExit):
        main([name, "--help"])
print(sorted({"mujoco", "numba", "rerun", "cv2", "matplotlib"} & set(sys.modules)), file=sys.stderr)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.count("--help") > len(EXPERIMENTS) and done.stderr == "[]\n"


ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("experiment", EXPERIMENTS.values(), ids=EXPERIMENTS.keys())
@pytest.mark.parametrize(
    ("option", "use"),
    [
        ("record", r"options\.record|RunFiles\.of\("),
        ("log", r"RunFiles\.of\("),
        ("jobs", r"sweep\("),
        ("seeds", "_seeds"),
    ],
)
def test_an_option_is_offered_where_it_does_something_and_only_there(experiment, option, use):
    module = (ROOT / experiment.module.replace(".", "/")).with_suffix(".py")
    parts = module.parent.glob("*.py") if experiment.name == "bench" else [module]
    used = any(re.search(use, part.read_text()) for part in parts)
    offered = {field.name for field in dataclasses.fields(experiment.options_type())}
    assert (option in offered) == used
