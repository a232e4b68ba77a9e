"""Ways that begin with the same state, and leave it as it is."""

import numpy as np
import pytest

from experiments.living.branches import branches


def test_each_way_begins_with_what_there_is_and_changes_none_of_it():
    rng, places = np.random.default_rng(3), [0.0]

    def go_on(step):
        places.append(places[-1] + step)
        return list(places), float(rng.normal())

    expected = float(np.random.default_rng(3).normal())
    found = branches([lambda step=step: go_on(step) for step in (1.0, 2.0)])
    assert found == [([0.0, 1.0], expected), ([0.0, 2.0], expected)]
    assert places == [0.0]
    assert float(rng.normal()) == expected


def test_a_way_that_fails_is_named(capfd):
    def fail():
        raise ValueError("the wheel came off")

    with pytest.raises(RuntimeError, match="way 1 of 2 ended"):
        branches([lambda: 0, fail])
    assert "the wheel came off" in capfd.readouterr().err
