"""What the envelope runs, which cells it confirms, and what it counts."""

import csv
import dataclasses
import json
import math

import pytest

from controllers.mission.config import OMITTABLE as MISSION_OMITTABLE
from experiments.ch5.insertion_setting import OMITTABLE, Hardship
from experiments.envelope import envelope
from experiments.envelope.axes import AXES
from experiments.envelope.cells import LEAST_CELLS, MEDIUM, Cell, cells_of, chosen
from experiments.envelope.figures import COLOURS
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from experiments.mission.scene import Field, draw_scene
from experiments.mission.trial import MissionTrial, generators
from models.card_and_slot.guides import width_of

INSERTIONS = {name: axis for name, axis in AXES.items() if not axis.whole}
MISSIONS = {name: axis for name, axis in AXES.items() if axis.whole}


def test_the_first_level_of_each_axis_is_the_default():
    for name, axis in INSERTIONS.items():
        trial = Cell(name, axis.levels[0]).trial(3)
        assert trial.hardship == Hardship() and trial.width == width_of(MEDIUM)
        others = [Cell(name, level).trial(3) for level in axis.levels[1:]]
        assert len({(trial.hardship, trial.width) for trial in others}) == len(others)
        assert all((other.hardship, other.width) != (Hardship(), trial.width) for other in others)
        assert set(axis.knowledge) <= set(OMITTABLE)


def test_missions_are_harder_by_what_their_axis_says():
    """Densities, frictions and distances are counted in the field that is drawn."""
    plain = field_of(MissionTrial(3))
    assert field_of(Cell("clutter", 0.0).trial(3)).rocks == 0
    double = field_of(Cell("clutter", 2.0).trial(3))
    assert (double.rocks, double.blocks) == (2 * plain.rocks, 2 * plain.blocks)
    assert field_of(Cell("friction", 0.2).trial(3)).friction_patches == (0.2, 0.7)
    trials = [Cell("distance", 10.0).trial(seed) for seed in range(5)]
    robots = [robot for trial in trials for robot in drawn(trial).robots]
    assert all(8.0 <= math.hypot(*robot.position) <= 10.0 for robot in robots)
    far = field_of(trials[0])
    assert far.size == (26.0, 26.0)
    assert far.rocks / 26.0**2 == pytest.approx(plain.rocks / 22.0**2, rel=1e-3)
    for name, axis in MISSIONS.items():
        assert set(axis.knowledge) <= set(MISSION_OMITTABLE)
        assert all(Cell(name, level).trial(3).hardness != Field() for level in axis.levels)


def drawn(trial):
    """Return the scene of a mission."""
    return draw_scene(trial.width, generators(trial.seed)[0], trial.hardness)


def field_of(trial):
    """Return the ground of a mission."""
    return drawn(trial).field


def test_an_ablation_takes_away_one_thing():
    for cell in cells_of(tuple(AXES)):
        assert cell.trial(5) == dataclasses.replace(cell.whole.trial(5), without=cell.without)


def shares_of(losses):
    """Return shares of cells of which each has lost as much; the whole ones succeed."""
    cells = [cell for cell in cells_of(tuple(INSERTIONS)) if cell.without]
    shares = {cell.whole: 1.0 for cell in cells}
    return cells, shares | {cell: 1.0 - loss for cell, loss in zip(cells, losses)}


def test_cells_that_lost_three_of_ten_are_confirmed_and_ten_at_least():
    count = len(shares_of([])[0])
    cells, shares = shares_of([0.3 if index % 2 else 0.2 for index in range(count)])
    lost = [cell for index, cell in enumerate(cells) if index % 2]
    assert chosen(shares) == lost and len(lost) > LEAST_CELLS
    cells, shares = shares_of([0.003 * index for index in range(count)])
    assert chosen(shares) == cells[-LEAST_CELLS:]


def test_missions_that_lost_five_of_ten_are_confirmed():
    cells, shares = shares_of([0.3] * len(shares_of([])[0]))
    missions = [cell for cell in cells_of(tuple(MISSIONS)) if cell.without]
    shares |= {cell.whole: 0.9 for cell in missions}
    shares |= {cell: 0.5 for cell in missions}
    shares[missions[1]] = 0.4
    assert chosen(shares) == [*cells, missions[1]]


@dataclasses.dataclass
class Outcome:
    """A result as far as it is counted."""

    success: bool
    reason: str = ""


def test_confirmed_cells_are_counted_in_pairs_of_other_seeds(monkeypatch, tmp_path):
    """Without force guidance the card jams at the narrow clearance, in nine pairs of ten."""
    seen = {"insertions screened": set(), "insertions confirmed": set()}

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
    screened, confirmed = seen.values()
    assert len(screened) == 10 and len(confirmed) == 30
    assert not screened & confirmed
    lost = sum(seed % 10 > 0 for seed in confirmed)
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
    omitted = {what for axis in AXES.values() for what in axis.knowledge}
    assert set(COLOURS) == {"whole", *(f"without_{what}" for what in omitted)}
    assert len(set(COLOURS.values())) == len(COLOURS)
