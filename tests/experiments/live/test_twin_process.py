"""What a twin in a process of its own is handed of a rover's images."""

import numpy as np

from experiments.live.twin_process import handed_on
from twin.robot import MISSING, ImageChannel

PAIR = np.zeros((2, 4, 6), np.uint8)


def test_a_pair_a_second_is_handed_on_of_those_that_were_looked_at():
    made = []

    def draw():
        made.append(PAIR)
        return PAIR

    pair = ImageChannel.deferred(draw, 7.0)
    assert handed_on(pair, -np.inf) is MISSING and made == []
    assert np.all(pair.value == PAIR)
    assert handed_on(pair, 5.5) is pair and len(made) == 1
    assert handed_on(pair, 6.5) is MISSING
    assert handed_on(MISSING, -np.inf) is MISSING
