"""Swarms: the options, and a small one end to end."""

import json

import numpy as np
import pytest

from experiments.ch3.planar import swarm as ch3_swarm
from experiments.ch3.planar.trial import PlanarTrial, build_world, run_trial
from experiments.harness.contract import OptionError
from experiments.harness.output import Output


def test_a_swarm_starts_on_as_many_different_free_cells():
    world = build_world(PlanarTrial("indoor", 1, "information"))
    starts = world.starts(50)
    assert len(set(starts)) == 50
    assert starts[0] == world.start
    assert not world.occupied[tuple(np.array(starts).T)].any()


def test_five_cooperating_robots_map_more_than_five_independent_ones():
    mapped = {}
    for cooperative in (True, False):
        trial = PlanarTrial("indoor", 2, "information", 75.0, 10.0, 8, 5, cooperative)
        mapped[cooperative] = run_trial(trial, build_world(trial)).fraction[-1]
    assert mapped[True] > mapped[False]


def test_every_robot_moves_cell_by_cell():
    trial = PlanarTrial("indoor", 3, "information", 75.0, 10.0, 4, 10)
    result = run_trial(trial, build_world(trial))
    for robot in range(10):
        path = result.paths[result.paths[:, 0] == robot, 1:]
        steps = np.abs(np.diff(path, axis=0))
        assert steps.max(initial=0) <= 1


@pytest.mark.parametrize("size", [0, 1000])
def test_swarms_that_are_none_are_refused(size):
    with pytest.raises(OptionError, match=f"--robots {size}"):
        ch3_swarm.Options(robots=(size,))


def test_sizes_are_sorted_and_each_once():
    assert ch3_swarm.Options(robots=(5, 2, 5)).sizes() == (2, 5)
    assert ch3_swarm.Options().sizes() == (1, 2, 5, 10, 20, 50)


@pytest.mark.slow
def test_a_small_swarm_is_measured(tmp_path):
    options = ch3_swarm.Options(seeds=1, jobs=1, robots=(10,), out=tmp_path)
    output = Output("ch3-swarm", options)
    ch3_swarm.run(options, output)
    output.finish()
    measured = json.loads((tmp_path / "ch3-swarm" / "metrics.json").read_text())["measured"]
    assert measured["rounds_to_90/10"]["median"] < 80
    assert measured["reached_90_fraction/10"]["median"] == 1.0
    assert (tmp_path / "ch3-swarm" / "figures" / "swarm.png").is_file()
