"""What the pair's forces, rates and messages amount to, in closed form."""

import numpy as np
import pytest

from controllers.insertion.cooperation import (
    NO_FORCES,
    REPORT,
    SET_POINT,
    SLAVE_FORCES,
    HybridConfig,
    HybridGrip,
    encode,
)
from controllers.insertion.guide import Phase
from controllers.insertion.master_slave import Master, Slave, Stage
from controllers.insertion.planar_grip import Stance
from tests.controllers.insertion.test_cooperation import ARM, BENDS, LEFT, PAIR, RIGHT, seen

TICK = PAIR.period


class Felt:
    """Replaces the grip's sensor: returns the value that it is set to."""

    def __init__(self, wrench=(0.0, 0.0, 0.0)):
        self.wrench = np.array(wrench)

    def felt(self, observation, stance):
        return self.wrench


class Still:
    """Stands for the guide: stays at a pose and keeps the wrenches that it gets."""

    phase, reason, tries, over = Phase.INSERT, "", 0, False

    def __init__(self, angle):
        self.pose, self.wrenches = np.array([0.003, 0.004, angle]), []

    def step(self, wrench):
        self.wrenches.append(wrench)
        return self.pose.copy()


def started(forces, sensor, **changes):
    config = HybridConfig(forces, (-1.0, 0.0, 0.0), **changes)
    grip = HybridGrip(config, ARM, sensor, Stance((0.55, 0.06), -1))
    grip.hold(seen())
    return grip, grip.start(0.0)


def test_wrench_is_low_passed_with_its_time_constant():
    sensor = Felt()
    grip, _ = started(SLAVE_FORCES, sensor, filter_time=0.05)
    grip.feel(seen())
    sensor.wrench = np.array([2.0, 0.0, 0.0])
    for _ in range(5):
        grip.feel(seen())
    assert grip.wrench[0] == pytest.approx(2.0 * (1.0 - (0.05 / 0.06) ** 5))


def test_missing_force_moves_the_grip_at_most_at_the_corrections_speed():
    grip, begin = started(SLAVE_FORCES, Felt([50.0, 0.0, 0.0]), speed=0.01)
    grip.feel(seen())
    places = [
        grip.stance.to_plan(ARM.task(grip.command(begin, np.zeros(3)).arm[1:]))[0]
        for _ in range(20)
    ]
    np.testing.assert_allclose(np.diff(places), -0.01 * TICK, rtol=0.02)


def test_no_joint_is_asked_to_go_faster_than_it_may():
    grip, begin = started(NO_FORCES, Felt(), take_up=1e-3, speed=10.0, joint_rate=0.2)
    grip.command(begin, np.zeros(3))
    before = BENDS
    for _ in range(5):
        command = grip.command(begin + [0.1, 0.05, 0.0], np.array([5.0, 0.0, 0.0]))
        assert np.abs(command.arm[1:] - before).max() == pytest.approx(0.2 * TICK)
        assert np.abs(command.arm_rates).max() == pytest.approx(0.2)
        before = command.arm[1:]


def test_rates_are_those_at_which_the_joints_follow_a_moving_plan():
    grip, begin = started(NO_FORCES, Felt())
    rate, arms = np.array([0.01, -0.02, 0.05]), []
    for tick in range(20):
        command = grip.command(begin + tick * TICK * rate, rate)
        arms.append(command.arm)
    np.testing.assert_allclose(command.arm_rates, (arms[-1] - arms[-2]) / TICK, atol=1e-3)
    assert np.abs(command.arm_rates).max() > 0.02


@pytest.mark.parametrize("angle, weight", [(0.0, 1.0), (0.05, 0.0)])
def test_guide_gets_what_the_stage_puts_on_the_segment_by_both_grips(angle, weight):
    """Less what the grips carried before; a tilted segment that they carried would turn as well."""
    sensor, held = Felt(weight * np.array([-1.0, 1.5, 0.1])), weight * np.array([1.0, 1.4, -0.05])
    grip = HybridGrip(HybridConfig(NO_FORCES), ARM, sensor, Stance((-0.55, 0.06), 1))
    guide = Still(angle)
    master = Master(grip, PAIR, lambda config, start: guide)
    for _ in range(100):
        master.step(seen(), [encode(REPORT, held)])
    assert master.stage is Stage.INSERT
    np.testing.assert_allclose(master.felt, 0.0, atol=1e-9)
    # The guide's x is along s and its y down, so its angles turn the other way.
    s, z = PAIR.mouth
    np.testing.assert_allclose(master.target, [s + 0.003, z - 0.004, -angle])
    own, other = np.array([0.4, -0.6, 0.01]), np.array([0.5, 0.8, 0.02])
    sensor.wrench = sensor.wrench + own
    for _ in range(100):
        master.step(seen(), [encode(REPORT, held + other)])
    moment = 0.0
    for grip, more in ((LEFT, own), (RIGHT, other)):
        x, y = grip.lever(-angle)
        moment += more[2] + x * more[1] - y * more[0]
    # What both grips put on it more, the stage takes; along and down in the tilted segment.
    c, n = np.cos(angle), np.sin(angle)
    along, up = -(own + other)[:2]
    expected = [c * along - n * up, -(n * along + c * up), moment]
    np.testing.assert_allclose(master.felt, expected, atol=3e-3)
    np.testing.assert_array_equal(guide.wrenches[-1], master.felt)


def test_slave_makes_up_for_the_messages_latency():
    stance = Stance((0.55, 0.06), -1)
    slave = Slave(HybridGrip(HybridConfig(NO_FORCES), ARM, Felt(), stance), PAIR)
    pitched = Stance(stance.place, -1, tilt=0.02)  # as `seen` has it
    begin, rate = RIGHT.segment_of(pitched.to_plan(ARM.task(BENDS))), np.array([0.01, 0.0, 0.0])
    behind = round(PAIR.latency / TICK)
    for tick in range(250):
        heard = []
        if tick % PAIR.every == 0:
            sent = begin + (tick - behind) * TICK * rate
            heard = [encode(SET_POINT, [*sent, *rate])]
        command, _ = slave.step(seen(), heard)
    place = pitched.to_plan(ARM.task(command.arm[1:]))
    assert place[0] == pytest.approx(RIGHT.on(begin + 249 * TICK * rate)[0], abs=1e-4)
