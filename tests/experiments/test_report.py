import pytest

from experiments.__main__ import main
from experiments.contract import ExperimentError
from experiments.report import write_report
from tests.experiments.tiny import CATALOGUE


def test_report_holds_everything_and_what_falls_short_first(tmp_path):
    assert main(["tiny", "--out", str(tmp_path), "--quick"], CATALOGUE) == 0
    assert main(["report", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text()
    assert text.index("What falls short: 1 of 2 checks") < text.index('<section id="tiny">')
    for part in ("18.9", "error is small", "table 2-1", "mass [kg]", "quick run", "mujoco version"):
        assert part in text
    assert text.count("data:image/png;base64,") == 1
    assert "ours &amp; &lt;theirs&gt;" in text
    for outside in ("<script", "http://", "https://", "<link"):
        assert outside not in text


def test_report_of_nothing_is_refused(tmp_path, capsys):
    assert main(["report", "--out", str(tmp_path)]) == 1
    assert "run an experiment first" in capsys.readouterr().err


def test_damaged_result_is_named(tmp_path):
    assert main(["tiny", "--out", str(tmp_path)], CATALOGUE) == 0
    (tmp_path / "tiny" / "metrics.json").write_text("{")
    with pytest.raises(ExperimentError, match=r"metrics\.json: cannot be read"):
        write_report(tmp_path)
