import time

import mujoco
import numpy as np

from twin.connect import connect
from twin.loop import run
from twin.robot import ArmMode, Command, WheelMode

TICKS = 60


class Drive:
    """A constant command, so that the loop alone is timed; keeps what was applied."""

    def __init__(self):
        self.command = Command(
            np.full(4, 2.0), np.array([0.0, 0.9, -1.4, 0.1]), WheelMode.SPEED, ArmMode.POSITION
        )

    def reset(self):
        pass

    def step(self, observations):
        return {"rover1": self.command}


class Voltages:
    def __init__(self):
        self.rows = []

    def record(self, step, time, observations, applied):
        duty = applied["rover1"]
        self.rows.append(12.0 * np.concatenate([duty.wheels, duty.arm]))

    def flush(self):
        pass


def test_loop_of_one_rover_on_a_plane_stays_below_1_7_of_the_bare_steps():
    """A guard against regressions; one rover on a plane is the cheapest physics there is.

    The benchmark of the loop holds the bar of 1.2 beside its own measurement.
    """
    with connect("sim") as link:
        simulation = link.simulation
        saved, log = simulation.save(), Voltages()
        run(link.robots, [Drive()], link.clock, log, TICKS * 0.01)
        reached = simulation.data.qpos.copy()
        loop, bare = [], []
        # CPU time in turns, and the least of each: other processes disturb both alike.
        for _ in range(8):
            simulation.restore(saved)
            begin = time.process_time()
            run(link.robots, [Drive()], link.clock, None, TICKS * 0.01)
            loop.append(time.process_time() - begin)
            simulation.restore(saved)
            begin = time.process_time()
            for row in log.rows:
                simulation.data.ctrl[:] = row
                mujoco.mj_step(simulation.model, simulation.data, 10)
            bare.append(time.process_time() - begin)
            np.testing.assert_array_equal(simulation.data.qpos, reached)
    assert min(loop) <= 1.7 * min(bare), f"{min(loop) / min(bare):.3f}"
    print(f"loop / bare = {min(loop) / min(bare):.3f}")
