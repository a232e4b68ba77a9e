"""Each fault changes what it says, when it says, and nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest

from controllers.insertion.card_inserter import InsertionStage
from experiments.ch5.insertion_faults import AFTER, BEGINS, ENDS_IN, Fault, FaultInjector
from experiments.ch5.insertion_scene import MASTER, SLAVE
from twin.hardware.emulator.modem import virtual_links
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


class Injected:
    """A fault with a stage and a clock that are set."""

    def __init__(self, fault: Fault):
        self.stage, self.time = InsertionStage.WAIT, 0.0
        self.injector = FaultInjector(fault, lambda: self.stage, lambda: self.time)

    def changed(self, time: float, stage: InsertionStage) -> set[str]:
        """Names of what differs from what was measured."""
        self.stage, self.time = stage, time
        names = set()
        for robot, seen in observations(time).items():
            after = self.injector.observed(robot, seen)
            for name, old, new in zip(seen._fields[1:], seen[1:], after[1:], strict=True):
                if old.validity is not new.validity or not np.array_equal(old.value, new.value):
                    names.add(f"{robot} {name}")
        return names | ({"radio"} if self.injector.outage() else set())


def test_every_fault_has_a_begin_and_a_stated_end():
    assert set(BEGINS) == set(ENDS_IN) == set(Fault)
    for inserted, reason in ENDS_IN.values():
        assert inserted == (reason == "")


@pytest.mark.parametrize("fault", Fault)
def test_fault_begins_in_its_stage_and_touches_only_its_channel(fault):
    injected, begin = Injected(fault), BEGINS[fault]
    wanted = {Fault.TILT: f"{SLAVE} inclinometer", Fault.RADIO: "radio"}.get(
        fault, f"{MASTER} stereo" if fault in SEEN_BY_MASTER else f"{SLAVE} arm_base_wrench"
    )
    if begin is None:
        assert injected.changed(1.0, InsertionStage.WAIT) == {wanted}
        return
    assert injected.changed(1.0, InsertionStage.WAIT) == set()
    assert injected.changed(2.0, begin) == set()  # from here on it counts
    assert injected.changed(2.0 + AFTER - 0.01, begin) == set()
    first = injected.changed(2.0 + AFTER + 1e-6, begin)
    later = injected.changed(2.0 + AFTER + 1.0, begin)
    assert first in ({wanted}, set() if fault is Fault.FROZEN else {wanted})
    assert later == {wanted}
    after = injected.changed(2.0 + AFTER + 2.26, InsertionStage.INSERT)
    short = fault in SHORT or fault in (Fault.RADIO, Fault.SPIKE)
    assert after == (set() if short else {wanted})


def test_frozen_camera_has_new_stamps_on_one_old_picture():
    injected = Injected(Fault.FROZEN)
    injected.changed(0.0, InsertionStage.APPROACH)
    seen = []
    for injected.time in (2.0, 3.0):
        given = observations(injected.time)[MASTER]
        seen.append(injected.injector.observed(MASTER, given).stereo)
    np.testing.assert_array_equal(seen[0].value, seen[1].value)
    assert [each.stamp for each in seen] == [2.0, 3.0]


def test_robots_and_links_under_a_fault_pass_on_all_else():
    injected = Injected(Fault.TILT)
    injected.stage = InsertionStage.APPROACH
    robot = SimpleNamespace(
        lifecycle="active", command=lambda c: c, observe=lambda: observations(9.0)[SLAVE]
    )
    injected.injector.observed(SLAVE, observations(0.0)[SLAVE])
    # The robot's own clock has no part in it.
    injected.time = 9.0 - 7.0
    faulty = injected.injector.robots({SLAVE: robot})[SLAVE]
    assert not faulty.observe().inclinometer.usable
    assert faulty.command(3) == 3 and faulty.lifecycle == "active"


def test_silent_radio_loses_what_is_sent_and_what_arrives():
    injected = Injected(Fault.RADIO)
    link = virtual_links([MASTER, SLAVE], lambda: injected.time, np.random.default_rng(0))
    links = injected.injector.links(link)

    def hear(begin: float) -> list[bytes]:
        injected.time = begin
        links[MASTER].send_latest(b"look")
        links[MASTER].poll()
        injected.time = begin + 0.2
        return links[SLAVE].poll().messages

    injected.stage = InsertionStage.APPROACH
    assert hear(0.5) == [b"look"]
    assert hear(0.5 + AFTER + 0.1) == []
    assert hear(0.5 + AFTER + 2.5) == [b"look"]
