"""Maps that both rovers of a mission exchange over their radio."""

import numpy as np
import pytest

from controllers.mission.belief import MissionBelief
from controllers.mission.map_exchange import BUDGET, MapExchange
from controllers.mission.radio import FRAME_BYTES, STATUS, MissionRadio, SlotPose
from tests.controllers.mission.hand_made import MASTER, SLAVE, HandLink, hand_links, localized
from tests.controllers.motion.seen import seen_at

GREY = np.zeros((2, 492, 510), np.uint8)
"""A pair that shows nothing."""


class Pair:
    """Two localized rovers that exchange what they have mapped."""

    def __init__(self) -> None:
        self.links: tuple[HandLink, HandLink] = hand_links()
        self.beliefs: list[MissionBelief] = [localized(MASTER), localized(SLAVE)]
        names = SLAVE, MASTER
        self.radios = [MissionRadio(*each) for each in zip(self.links, names, strict=True)]
        self.ends = [
            MapExchange(belief, radio, number)
            for number, (belief, radio) in enumerate(zip(self.beliefs, self.radios, strict=True))
        ]
        self.ticks = 0

    def play(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            now, self.ticks = 0.1 * self.ticks, self.ticks + 1
            for radio, end in zip(self.radios, self.ends, strict=True):
                radio.begin_tick(now)
                end.step(now)

    def meet(self) -> None:
        """Let each rover know where the other stands."""
        for one, other in ((0, 1), (1, 0)):
            self.beliefs[one].partner = self.beliefs[other].slot_now()


def put_ground(belief: MissionBelief, lower: tuple[float, float], side: float) -> np.ndarray:
    """Map a square of level ground with a block in its middle; return the block's cells."""
    ground = belief.navigator.ground
    local = ground.grid.centres - np.array(lower)
    inside = (local > 0.0).all(axis=-1) & (local < side).all(axis=-1)
    ground.heights[inside], ground.variances[inside] = -0.2, 1e-5
    block = (np.abs(local - 0.5 * side) < 0.08).all(axis=-1)
    ground.heights[block] = -0.1
    return block


def test_a_block_that_one_has_mapped_is_in_the_others_plan_and_not_in_its_map() -> None:
    pair = Pair()
    block = put_ground(pair.beliefs[0], (2.0, 2.0), 1.5)
    pair.play(25.0)
    navigator = pair.beliefs[1].navigator
    assert navigator.received is not None
    np.testing.assert_allclose(navigator.received.heights[block], -0.1, atol=0.01)
    assert not navigator.ground.known.any()


def test_a_rover_is_not_told_that_an_obstacle_stands_where_it_stands_itself() -> None:
    pair = Pair()
    pair.meet()
    first, second = (belief.navigator for belief in pair.beliefs)
    block = put_ground(pair.beliefs[0], tuple(second.place - 0.75), 1.5)
    first.take(seen_at(0.0, stereo=GREY), at_rest=False)
    assert not first.ground.known[block].any() and first.ground.known.sum() > 500
    pair.play(25.0)
    received = second.received
    assert received is not None
    assert received.known.sum() > 500 and not received.known[block].any()


def test_what_is_known_no_more_before_it_was_sent_is_not_told() -> None:
    pair, rng = Pair(), np.random.default_rng(1)
    ground = pair.beliefs[0].navigator.ground
    ground.newest.heights[300:400, 300:400] = rng.normal(0.0, 0.05, (100, 100))
    ground.newest.variances[300:400, 300:400] = 1e-4
    pair.play(2.0)
    received = pair.beliefs[1].navigator.received
    assert received is not None
    sent, middle = received.known.copy(), ground.grid.centres[350, 350]
    ground.newest.forget(middle, 1.0)
    gone = np.hypot(*np.moveaxis(ground.grid.centres - middle, -1, 0)) < 1.0
    pair.play(25.0)
    new = received.known & ~sent
    assert new[~gone].sum() > 2000 > new[gone].sum()


def test_where_a_rover_stands_itself_nothing_stands_of_what_it_was_told() -> None:
    pair = Pair()
    navigator = pair.beliefs[1].navigator
    block = put_ground(pair.beliefs[0], tuple(navigator.place - 0.75), 1.5)
    pair.play(25.0)
    received = navigator.received
    assert received is not None and received.known[block].all()
    navigator.take(seen_at(0.0, stereo=GREY), at_rest=False)
    assert received.known.sum() > 500 and not received.known[block].any()


def test_bytes_on_the_air_stay_within_twenty_thousand_for_both() -> None:
    pair, rng = Pair(), np.random.default_rng(0)
    for belief in pair.beliefs:
        ground = belief.navigator.ground
        ground.heights[300:420, 300:420] = rng.normal(0.0, 0.05, (120, 120))
        ground.variances[300:420, 300:420] = 1e-4
    pair.play(60.0)
    sent = [sum(len(m) + FRAME_BYTES for m in link.sent) for link in pair.links]
    counted = [sum(radio.bytes_sent.values()) for radio in pair.radios]
    assert sent == counted and min(sent) > 8000 and sum(sent) < 20_000
    for link in pair.links:
        assert 0.9 * BUDGET < sum(len(message) for message in link.sent) <= BUDGET
        assert all(message[0] != STATUS for message in link.sent)


def test_slots_that_are_told_place_the_other_rover() -> None:
    pair = Pair()
    pair.meet()
    partner = pair.beliefs[0].partner
    assert isinstance(partner, SlotPose)
    place = pair.beliefs[0].partner_place()
    assert place is not None
    assert float(np.linalg.norm(place)) == pytest.approx(0.9, abs=1e-6)
