import time

import mujoco
import numpy as np
import pytest

from twin.connect import connect
from twin.loop import LoopRecorder, run
from twin.robot import ArmMode, Command, WheelMode

pytestmark = pytest.mark.real_time

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


class Voltages(LoopRecorder):
    def __init__(self):
        self.rows = []

    def record(self, tick):
        duty = tick.applied["rover1"]
        self.rows.append(12.0 * np.concatenate([duty.wheels, duty.arm]))


def test_loop_of_one_rover_on_a_plane_costs_less_than_its_physics():
    """A guard against gross regressions; one rover on a plane is the cheapest physics there is.

    The benchmark of the loop measures the ratio with care, and holds the bar of 1.2 beside it.
    """
    with connect("sim") as link:
        simulation = link.simulation
        saved, log = simulation.save(), Voltages()
        run(link.robots, [Drive()], link.clock, [log], TICKS * 0.01)
        reached = simulation.data.qpos.copy()
        ratios = []
        # Each turn compares its own neighbours: a shared machine changes pace from turn to turn.
        for _ in range(15):
            simulation.restore(saved)
            begin = time.process_time()
            run(link.robots, [Drive()], link.clock, (), TICKS * 0.01)
            loop = time.process_time() - begin
            simulation.restore(saved)
            begin = time.process_time()
            for row in log.rows:
                simulation.data.ctrl[:] = row
                mujoco.mj_step(simulation.model, simulation.data, 10)
            ratios.append(loop / (time.process_time() - begin))
            np.testing.assert_array_equal(simulation.data.qpos, reached)
    ratio = np.median(ratios)
    assert ratio < 2.0, f"{ratio:.3f}"
    print(f"loop / bare = {ratio:.3f}")
