"""What the envelope runs, which cells it confirms, and what it counts."""

import csv
import dataclasses
import json

import pytest

from experiments.ch5.insertion_setting import OMITTABLE, Hardship
from experiments.envelope import envelope
from experiments.envelope.cells import AXES, LEAST_CELLS, MEDIUM, Cell, cells_of, chosen
from experiments.envelope.figures import COLOURS
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from models.card_and_slot.guides import width_of


def test_the_first_level_of_each_axis_is_the_default():
    for name, axis in AXES.items():
        trial = Cell(name, axis.levels[0]).trial(3)
        assert trial.hardship == Hardship() and trial.width == width_of(MEDIUM)
        others = [Cell(name, level).trial(3) for level in axis.levels[1:]]
        assert len({(trial.hardship, trial.width) for trial in others}) == len(others)
        assert all((other.hardship, other.width) != (Hardship(), trial.width) for other in others)
        assert set(axis.knowledge) <= set(OMITTABLE)


def test_an_ablation_takes_away_one_thing():
    for cell in cells_of(tuple(AXES)):
        assert cell.trial(5) == dataclasses.replace(cell.whole.trial(5), without=cell.without)


def shares_of(losses):
    """Return shares of cells of which each has lost as much; the whole ones succeed."""
    cells = [cell for cell in cells_of(tuple(AXES)) if cell.without]
    shares = {cell.whole: 1.0 for cell in cells}
    return cells, shares | {cell: 1.0 - loss for cell, loss in zip(cells, losses)}


def test_cells_that_lost_three_of_ten_are_confirmed_and_ten_at_least():
    count = len(shares_of([])[0])
    cells, shares = shares_of([0.3 if index % 2 else 0.2 for index in range(count)])
    lost = [cell for index, cell in enumerate(cells) if index % 2]
    assert chosen(shares) == lost and len(lost) > LEAST_CELLS
    cells, shares = shares_of([0.003 * index for index in range(count)])
    assert chosen(shares) == cells[-LEAST_CELLS:]


@dataclasses.dataclass
class Outcome:
    """A result as far as it is counted."""

    success: bool
    reason: str = ""


def test_confirmed_cells_are_counted_in_pairs_of_other_seeds(monkeypatch, tmp_path):
    """Without force guidance the card jams at the narrow clearance, in nine pairs of ten."""
    seen = {"screened": set(), "confirmed": set()}

    def sweep(_, jobs, options, output, label):
        seen[label] |= {job.seed for job in jobs}
        narrow = width_of(4e-4)
        return [
            Outcome(not (job.without == "force" and job.width == narrow and job.seed % 10), "jam")
            for job in jobs
        ]

    monkeypatch.setattr(envelope, "sweep", sweep)
    options = envelope.Options(out=tmp_path, axes=("clearance",), seeds=30)
    output = Output("mission-envelope", options)
    envelope.run(options, output)
    assert len(seen["screened"]) == 10 and len(seen["confirmed"]) == 30
    assert not seen["screened"] & seen["confirmed"]
    lost = sum(seed % 10 > 0 for seed in seen["confirmed"])
    output.finish()
    metrics = json.loads((tmp_path / "mission-envelope/metrics.json").read_text())["measured"]
    assert metrics["success/clearance/0.4/without_force"]["mean"] == pytest.approx(1 - lost / 30)
    # All differ to one side: twice the chance of as many heads.
    assert metrics["mcnemar_p/clearance/0.4/force"] == pytest.approx(2.0 * 0.5**lost)
    with open(tmp_path / "mission-envelope/tables/envelope.csv") as table:
        (row,) = [
            row
            for row in csv.DictReader(table)
            if (row["level"], row["cell"]) == ("0.4", "without_force")
        ]
    assert row["seeds"] == "30" and row["reasons"] == "jam"


def test_unknown_axes_are_refused(tmp_path):
    with pytest.raises(OptionError, match="--axes wind: expected some of springs"):
        envelope.Options(out=tmp_path, axes=("wind",))


def test_each_kind_of_knowledge_has_a_colour_of_its_own():
    assert set(COLOURS) == {"whole", *(f"without_{what}" for what in OMITTABLE)}
    assert len(set(COLOURS.values())) == len(COLOURS)
