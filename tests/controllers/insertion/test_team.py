"""The team of the insertion goes on when the master was mistaken."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion.card_inserter import InsertionStage
from controllers.insertion.guidance import Guidance, GuidanceLink
from controllers.insertion.team import (
    InsertionMaster,
    InsertionSlave,
    InsertionTeam,
    surrogate_sensing,
)
from controllers.motion.base_tilt import drawn_springs
from twin.describe import describe_rover
from twin.hardware.emulator.modem import virtual_links
from twin.robot import Command, Observation

MASTER, SLAVE = "rover1", "rover2"


def heard_of(distance: float) -> list[Guidance]:
    """Return what the slave hears of one look that places the slot so far from the card [m]."""
    pose = RigidTransform.from_translation([distance, 0.0, 0.0])
    looks = iter([None] * 20 + [Guidance(0.15, True, True, pose, np.eye(6) * 1e-6)])
    received: list[Guidance] = []
    time = 0.0

    def act(seen, messages):
        received.extend(messages)
        return Command()

    marker_guide = SimpleNamespace(step=lambda seen: (Command(), next(looks, None)))
    inserter = SimpleNamespace(
        stage=InsertionStage.APPROACH, config=SimpleNamespace(period=0.01), step=act, stop=None
    )
    sensing = SimpleNamespace(
        step=lambda seen, dt, contact, obstacles: SimpleNamespace(
            observation=seen, failed=frozenset(), stop=""
        )
    )
    links = virtual_links([MASTER, SLAVE], lambda: time, np.random.default_rng(0))
    team = InsertionTeam(
        InsertionMaster(MASTER, marker_guide, GuidanceLink(links[MASTER])),
        InsertionSlave(SLAVE, inserter, sensing, GuidanceLink(links[SLAVE])),
    )
    for tick in range(40):
        time = 0.01 * tick
        team.step({name: Observation(time) for name in (MASTER, SLAVE)})
    return received


def test_look_arrives_by_radio():
    (look,) = heard_of(0.3)
    np.testing.assert_allclose(look.transform_slot_to_card.translation, [0.3, 0.0, 0.0], atol=2e-5)
    assert look.time == pytest.approx(0.15, abs=2e-3)


def test_look_that_no_message_can_tell_is_left_out():
    assert heard_of(0.8) == []


def test_lost_sensors_are_replaced_up_to_1_n_and_5_degrees():
    rover = describe_rover(SLAVE, card=True)
    sensing = surrogate_sensing(rover, 0.2, drawn_springs(rover))
    limits = {name: monitor.limits for name, monitor in sensing._monitors.items()}
    wrench, tilt = limits["arm_base_wrench"], limits["inclinometer"]
    np.testing.assert_allclose(wrench.largest, [1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    np.testing.assert_allclose(np.degrees(tilt.largest), [5.0, 5.0])
    # Tilt changes slower than force.
    assert tilt.longest > wrench.longest
