"""Each fault changes what it says, when it says, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.insertion.card_inserter import InsertionStage
from experiments.ch5.insertion_faults import AFTER, BEGINS, ENDS_IN, Fault, FaultyEyes
from experiments.ch5.insertion_scene import MASTER, SLAVE
from twin.robot import Channel, Observation, Validity

SEEN_BY_MASTER = {Fault.BLACK, Fault.HIDDEN, Fault.LOST, Fault.FROZEN}
SHORT = {Fault.HIDDEN}


def observations(time: float):
    def channel(value):
        return Channel(np.asarray(value), time, Validity.MEASURED)

    pair = np.full((2, 3, 4), round(10 * time) % 256, dtype=np.uint8)
    return {
        MASTER: Observation(time, stereo=channel(pair)),
        SLAVE: Observation(
            time, inclinometer=channel(np.zeros(2)), arm_base_wrench=channel(np.zeros(6))
        ),
    }


def changed(eyes: FaultyEyes, time: float, stage: InsertionStage) -> set[str]:
    """Names of what differs from what was measured."""
    before = observations(time)
    after = eyes.change(before, stage)
    names = set()
    for robot, seen in before.items():
        for name, old, new in zip(seen._fields[1:], seen[1:], after[robot][1:], strict=True):
            if old.validity is not new.validity or not np.array_equal(old.value, new.value):
                names.add(f"{robot} {name}")
    return names | ({"radio"} if eyes.outage(time, stage) else set())


def test_every_fault_has_a_begin_and_a_stated_end():
    assert set(BEGINS) == set(ENDS_IN) == set(Fault)
    for inserted, reason in ENDS_IN.values():
        assert inserted == (reason == "")


@pytest.mark.parametrize("fault", Fault)
def test_fault_begins_in_its_stage_and_touches_only_its_channel(fault):
    eyes, begin = FaultyEyes(fault), BEGINS[fault]
    wanted = {Fault.TILT: f"{SLAVE} inclinometer", Fault.RADIO: "radio"}.get(
        fault, f"{MASTER} stereo" if fault in SEEN_BY_MASTER else f"{SLAVE} arm_base_wrench"
    )
    if begin is None:
        assert changed(eyes, 1.0, InsertionStage.WAIT) == {wanted}
        return
    assert changed(eyes, 1.0, InsertionStage.WAIT) == set()
    assert changed(eyes, 2.0, begin) == set()  # from here on it counts
    assert changed(eyes, 2.0 + AFTER - 0.01, begin) == set()
    first = changed(eyes, 2.0 + AFTER + 1e-6, begin)
    later = changed(eyes, 2.0 + AFTER + 1.0, begin)
    assert first in ({wanted}, set() if fault is Fault.FROZEN else {wanted})
    assert later == {wanted}
    after = changed(eyes, 2.0 + AFTER + 2.26, InsertionStage.INSERT)
    short = fault in SHORT or fault in (Fault.RADIO, Fault.SPIKE)
    assert after == (set() if short else {wanted})


def test_no_fault_changes_nothing():
    eyes = FaultyEyes(None)
    given = observations(3.0)
    assert eyes.change(given, InsertionStage.INSERT) is given and not eyes.outage(
        3.0, InsertionStage.APPROACH
    )


def test_frozen_camera_has_new_stamps_on_one_old_picture():
    eyes = FaultyEyes(Fault.FROZEN)
    eyes.change(observations(0.0), InsertionStage.APPROACH)
    seen = [
        eyes.change(observations(time), InsertionStage.APPROACH)[MASTER].stereo
        for time in (2.0, 3.0)
    ]
    np.testing.assert_array_equal(seen[0].value, seen[1].value)
    assert [each.stamp for each in seen] == [2.0, 3.0]
