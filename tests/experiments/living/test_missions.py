"""Missions in whose midst something happens: when it does, who is told, and how they are scored."""

import json
import types

import numpy as np
import pytest
import scipy.stats

from controllers.sensing.diagnosis import Finding
from experiments.harness.output import Output
from experiments.living import missions
from experiments.living.living_twin_options import Options
from experiments.living.missions import (
    CHANGES,
    MIDWAY,
    Happening,
    LivingMission,
    LivingOutcome,
    TwinTells,
    measure_missions,
)
from experiments.mission.scene import SLAVE
from models.compose import RobotPlacement
from models.configuration import FieldConfig
from twin.connect import connect


def tick(time):
    return types.SimpleNamespace(time=time, observations={SLAVE: None}, applied={SLAVE: None})


@pytest.mark.parametrize("patches", [None, (0.5, 0.5)])
@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("load", lambda model: model.body(f"{SLAVE}/rear_chassis").mass[0]),
        ("spring", lambda model: model.joint(f"{SLAVE}/rear_left_suspension_joint").stiffness[0]),
        ("grip", lambda model: model.geom(f"{SLAVE}/rear_left_tyre").friction[0]),
    ],
)
def test_it_happens_to_the_slave_once_midway_and_for_good(change, what, patches):
    _, size = CHANGES[change]
    placed, field = RobotPlacement(SLAVE, card=True), FieldConfig(friction_patches=patches)
    with connect("sim", robots=[placed], field=field, seed=1) as connection:
        ended = []
        mission = types.SimpleNamespace(
            connection=connection, team=types.SimpleNamespace(ended=ended)
        )
        happening = Happening(mission, change)
        model = connection.simulation.model
        before = what(model)
        happening.record(tick(1.0))
        assert what(model) == before and np.isnan(happening.time)
        ended += ["identify", "search", MIDWAY]
        for time in (2.0, 3.0):
            happening.record(tick(time))
            connection.simulation.tick()
        expected = before + size if change == "load" else before * (1.0 - size)
        assert what(model) == pytest.approx(expected)
        assert happening.time == 2.0  # noqa: PLR2004


def test_the_slave_is_told_what_its_twin_names_until_it_inserts_the_card(monkeypatch):
    made = []

    class Twin:
        def __init__(self, placed, learning, threads, rough):
            made.append((placed, rough))
            self.named, self.ticks = [], 0

        def step(self, tick):
            self.ticks += 1
            if self.ticks == 2:  # noqa: PLR2004
                found = Finding("load base", 1.9, 0.1, 9.0)
                self.named.append(types.SimpleNamespace(time=0.02, finding=found))

    monkeypatch.setattr(missions, "TwinBeside", Twin)
    told, stage = [], types.SimpleNamespace(name="approach")
    slave = types.SimpleNamespace(stage=stage, told=told.append)
    as_made = RobotPlacement(SLAVE, card=True, mast=0.1)
    mission = types.SimpleNamespace(
        team=types.SimpleNamespace(slave=slave),
        scene=types.SimpleNamespace(robots=[RobotPlacement("rover1"), as_made]),
    )
    tells = TwinTells(mission)
    for number in range(4):
        tells.record(tick(0.01 * number))
    assert [each.name for each in told] == ["load base"]
    assert tells.named == ((0.02, "load base"),)
    assert made == [(RobotPlacement(SLAVE, card=True, mast=0.1), True)]
    stage.name = "insert"
    tells.record(tick(0.05))
    assert tells._twin.ticks == 4  # noqa: PLR2004


def test_missions_are_compared_with_the_unchanged_ones_and_in_pairs(tmp_path):
    """Of 12 seeds: 11 unchanged; with a load 10 against 1, with a soft spring 9 against 10."""
    shares = {
        "nothing/with": 11, "nothing/without": 12, "load/with": 10, "load/without": 1,
        "spring/with": 9, "spring/without": 10,
    }  # fmt: skip
    trials, results = [], []
    for key, count in shares.items():
        change, twin = key.split("/")
        for seed in range(12):
            trials.append(LivingMission(seed, change, twin == "with"))
            results.append(LivingOutcome(seed < count, "", 300.0, 100.0, ()))
    output = Output("living-twin", Options(out=tmp_path), [])
    measure_missions(trials, results, output)
    output.finish()
    output.close()
    told = json.loads((tmp_path / "living-twin" / "metrics.json").read_text())
    found = told["measured"]
    for key, count in shares.items():
        assert found[f"mission_success/{key}"]["mean"] == pytest.approx(count / 12)
    for change, pairs in (("nothing", (0, 1)), ("load", (9, 0)), ("spring", (0, 1))):
        p = scipy.stats.binomtest(pairs[0], sum(pairs), 0.5).pvalue
        assert found[f"mission_p/{change}"] == pytest.approx(p)
    checks = {each["name"]: each["ok"] for each in told["checks"]}
    assert checks == {
        "missions, load": True, "missions, spring": False, "changes in which a twin helps": True,
    }  # fmt: skip
