import numpy as np
import pytest

from tests.twin.scene import SERVO, compile_scene
from twin.clock import PacedClock, WallClock
from twin.loop import LoopRecorder, run
from twin.robot import Command, Lifecycle, RobotError
from twin.sensors import IDEAL
from twin.simulation import Simulation

pytestmark = pytest.mark.real_time

MODEL = compile_scene(("rover1", "rover2"))


@pytest.fixture
def simulation():
    return Simulation(MODEL, ["rover1", "rover2"], suite=IDEAL, servo=SERVO)


class Push:
    def __init__(self, *names, fail_at=None, error=None):
        self.names, self.fail_at, self.error, self.calls = names, fail_at, error, 0

    def reset(self):
        self.calls = 0

    def step(self, observations):
        if self.calls == self.fail_at:
            raise self.error
        self.calls += 1
        return {name: Command(np.full(4, 0.5)) for name in self.names}


class Log(LoopRecorder):
    def __init__(self):
        self.ticks, self.flushed = [], 0

    def record(self, tick):
        self.ticks.append((tick.step, tick.time, sorted(tick.observations), sorted(tick.applied)))

    def flush(self):
        self.flushed += 1


def all_inactive(simulation):
    states = {robot.lifecycle for robot in simulation.robots.values()}
    return states == {Lifecycle.INACTIVE} and not np.any(simulation.data.ctrl)


def test_loop_ticks_at_the_servo_rate_and_deactivates_at_the_end(simulation):
    log = Log()
    summary = run(simulation.robots, [Push("rover1")], simulation, [log], duration=0.5)
    assert summary.duration == pytest.approx(0.5)
    assert log.ticks[0] == (0, 0.0, ["rover1", "rover2"], ["rover1"])
    assert log.ticks[-1][1] == pytest.approx(0.49)
    assert log.flushed == 1 and all_inactive(simulation)


def test_loop_ends_early_on_its_condition(simulation):
    push = Push("rover1")
    summary = run(
        simulation.robots, [push], simulation, duration=0.5, until=lambda: push.calls == 7
    )
    assert summary.duration == pytest.approx(0.07)
    assert all_inactive(simulation)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("bug")])
def test_interrupted_run_stops_every_robot_and_flushes(simulation, error):
    log = Log()
    with pytest.raises(type(error)):
        run(simulation.robots, [Push("rover1", fail_at=7, error=error)], simulation, [log])
    assert len(log.ticks) == 7 and log.flushed == 1 and all_inactive(simulation)


def test_failing_robot_stops_the_others(simulation):
    class Break(Push):
        def step(self, observations):
            commands = super().step(observations)
            if self.calls == 5:
                simulation.robots["rover2"].fail("injected")
            return commands

    with pytest.raises(RobotError, match="rover2"):
        run(simulation.robots, [Break("rover1")], simulation)
    assert simulation.robots["rover1"].lifecycle is Lifecycle.INACTIVE
    assert simulation.robots["rover2"].lifecycle is Lifecycle.ERROR
    assert not np.any(simulation.data.ctrl)


@pytest.mark.parametrize("bug", [None, ValueError("bug")])
def test_robot_that_cannot_be_stopped_hides_neither_the_others_nor_what_went_wrong(
    simulation, monkeypatch, bug
):
    def unreachable():
        raise RobotError("no answer")

    monkeypatch.setattr(simulation.robots["rover1"], "deactivate", unreachable)
    log, push = Log(), Push("rover1", "rover2", fail_at=bug and 3, error=bug)
    with pytest.raises(ValueError if bug else RobotError) as raised:
        run(simulation.robots, [push], simulation, [log], duration=0.05)
    texts = str(raised.value), *getattr(raised.value, "__notes__", ())
    assert texts == (("bug", "and at the end: no answer") if bug else ("no answer",))
    assert log.flushed == 1
    assert simulation.robots["rover2"].lifecycle is Lifecycle.INACTIVE


def test_unknown_and_doubly_commanded_robots_are_refused(simulation):
    with pytest.raises(ValueError, match=r"'ghost'.*rover1.*rover2"):
        run(simulation.robots, [Push("ghost")], simulation)
    with pytest.raises(ValueError, match="two controllers command robot 'rover1'"):
        run(simulation.robots, [Push("rover1"), Push("rover1")], simulation)
    assert all_inactive(simulation)


class FakeTime:
    def __init__(self):
        self.now, self.slept = 100.0, []

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def test_slowed_clock_passes_a_period_in_as_many_of_the_walls():
    fake = FakeTime()
    clock = WallClock(0.01, 8.0, lambda: fake.now, fake.sleep)
    start = fake.now
    for _ in range(5):
        clock.tick()
    assert clock.misses == 0 and clock.time == pytest.approx(0.05)
    assert fake.now - start == pytest.approx(8 * 0.05)


def test_wall_clock_keeps_absolute_deadlines():
    fake = FakeTime()
    clock = WallClock(0.01, 1.0, lambda: fake.now, fake.sleep)
    for work in (0.004, 0.009, 0.001):
        fake.now += work
        clock.tick()
    assert clock.time == pytest.approx(0.03) and clock.misses == 0
    np.testing.assert_allclose(fake.slept, [0.006, 0.001, 0.009])


def test_wall_clock_counts_and_skips_missed_deadlines():
    fake = FakeTime()
    clock = WallClock(0.01, 1.0, lambda: fake.now, fake.sleep)
    clock.tick()
    fake.now += 0.035
    clock.tick()
    assert clock.misses == 3
    assert clock.time == pytest.approx(0.05)
    clock.tick()
    assert clock.time == pytest.approx(0.06) and clock.misses == 3


def test_wall_clock_misses_nothing_while_robots_are_set_up():
    fake = FakeTime()
    clock = WallClock(0.01, 1.0, lambda: fake.now, fake.sleep)
    fake.now += 2.503
    clock.tick()
    assert clock.time == pytest.approx(2.51) and clock.misses == 0


def test_paced_clock_lets_each_tick_of_a_simulation_take_its_period(simulation):
    fake = FakeTime()
    clock = PacedClock(simulation, WallClock(0.01, 1.0, lambda: fake.now, fake.sleep))
    begin, start = clock.time, fake.now
    for work in (0.004, 0.035, 0.001):
        fake.now += work
        clock.tick()
    assert clock.period == 0.01 and clock.time - begin == pytest.approx(0.03)
    assert fake.now - start == pytest.approx(0.06)  # The second tick missed three deadlines.


def test_wall_clock_really_waits():
    clock = WallClock(0.005)
    for _ in range(10):
        clock.tick()
    assert clock.time >= 0.05 - 1e-4


def test_wall_clock_needs_a_positive_period():
    with pytest.raises(ValueError, match="positive"):
        WallClock(0.0)
