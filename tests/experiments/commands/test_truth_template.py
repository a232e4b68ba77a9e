import tomllib

from controllers.identification.parameters import NAMES, UNITS
from experiments.__main__ import main
from experiments.ch2.simulation.truths import load_truth
from models.datasheets import TABLE_2_1_TRUTH


def test_template_is_a_truth_with_every_unit_and_the_table_s_values(tmp_path, capsys):
    assert main(["truth-template"]) == 0
    text = capsys.readouterr().out
    assert tomllib.loads(text) == TABLE_2_1_TRUTH
    for name, unit in zip(NAMES, UNITS):
        (line,) = (each for each in text.splitlines() if each.startswith(f"{name} ="))
        assert line.endswith(f"# [{unit}]")
    (tmp_path / "truth.toml").write_text(text)
    assert load_truth(tmp_path / "truth.toml") == tuple(TABLE_2_1_TRUTH[name] for name in NAMES)
