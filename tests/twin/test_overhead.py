"""What the loop adds to the physics: counted in calls, which are the same on every machine."""

import sys

import mujoco
import numpy as np

from twin.connect import connect
from twin.loop import LoopRecorder, run
from twin.robot import ArmMode, Command, WheelMode

TICKS = 60
CALLS = 60
"""Most calls a tick; it makes 27."""


class Drive:
    """A constant command, so that the loop alone is counted."""

    def __init__(self):
        self.command = Command(
            np.full(4, 2.0), np.array([0.0, 0.9, -1.4, 0.1]), WheelMode.SPEED, ArmMode.POSITION
        )

    def reset(self):
        pass

    def step(self, observations):
        return {"rover1": self.command}


class Voltages(LoopRecorder):
    def __init__(self):
        self.rows = []

    def record(self, tick):
        duty = tick.applied["rover1"]
        self.rows.append(12.0 * np.concatenate([duty.wheels, duty.arm]))


def calls_of(action):
    """Return how many functions, Python's and compiled ones, an action calls."""
    count = 0

    def note(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
    return count


def test_loop_of_one_rover_makes_few_calls_a_tick():
    """A guard against gross regressions, where a time would be another one on each machine.

    The benchmark of the loop measures the time with care, and holds the bar of 1.2 beside it.
    """
    with connect("sim") as link:
        saved = link.simulation.save()

        def drive(ticks):
            link.simulation.restore(saved)
            run(link.robots, [Drive()], link.clock, (), ticks * 0.01)

        drive(TICKS)  # What is done but once is done here.
        few, many = (calls_of(lambda ticks=ticks: drive(ticks)) for ticks in (TICKS, 2 * TICKS))
    assert (many - few) / TICKS < CALLS


def test_loop_steps_the_physics_as_bare_voltages_do():
    with connect("sim") as link:
        simulation = link.simulation
        saved, log = simulation.save(), Voltages()
        run(link.robots, [Drive()], link.clock, [log], TICKS * 0.01)
        reached = simulation.data.qpos.copy()
        simulation.restore(saved)
        for row in log.rows:
            simulation.data.ctrl[:] = row
            mujoco.mj_step(simulation.model, simulation.data, 10)
        np.testing.assert_array_equal(simulation.data.qpos, reached)
