"""What the loop costs beside bare physics: contract, sensors and servos of two rovers."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from experiments.contract import Options
from experiments.output import Output
from experiments.timing import compare
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from twin.clock import SimClock
from twin.loop import run
from twin.robot import WHEELS, Command, Observation
from twin.simulation import Simulation

ROBOTS = ("rover1", "rover2")
DUTY = 0.5
SPAN = 0.5  # [s] of simulated time in one timed call
OVERHEAD_BOUND = 1.2
FIELDS = {
    # name -> (field, least real-time factor on one core)
    "plane": (FieldConfig(), 10.0),
    "rocks": (FieldConfig(rocks=40), 4.0),
}


class ConstantDuty:
    """Drives all robots straight on; costs next to nothing."""

    def __init__(self) -> None:
        command = Command(wheels=np.full(4, DUTY))
        self._commands = {name: command for name in ROBOTS}

    def reset(self) -> None:
        """Nothing is remembered."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the same commands whatever is seen."""
        return self._commands


def bench_loop(options: Options, output: Output) -> None:
    """Time the loop against ``mj_step(nstep=10)`` of the same scene under the same voltages.

    Args:
        options: ``quick`` takes fewer rounds.
        output: Receives ``loop_overhead`` (on the plane) and ``rtf/<field>``.
    """
    rounds = 10 if options.quick else 40
    for name, (field, least) in FIELDS.items():
        model = make_model(
            field, [RobotPlacement(ROBOTS[0]), RobotPlacement(ROBOTS[1], (1.0, 0.0))]
        )
        times = compare(looped(model), bare(model), rounds)
        overhead = times["ratio"]
        if name == "plane":
            output.measure("loop_overhead", overhead)
            bound = f"<= {OVERHEAD_BOUND}"
            value = overhead["median"]
            output.check("loop overhead on the plane", value, bound, value <= OVERHEAD_BOUND)
        else:
            output.measure(f"loop_overhead/{name}", overhead)
        factor = SPAN / times["ours_s"]["median"]
        output.measure(f"rtf/{name}", factor)
        output.check(f"real-time factor, {name}", factor, f">= {least:g}", factor >= least)


def looped(model: mujoco.MjModel) -> Callable[[], object]:
    """Return a function that runs the rovers through the loop for `SPAN`."""
    simulation = Simulation(model, ROBOTS, data=settle(model))
    clock, controllers = SimClock(simulation), [ConstantDuty()]
    return lambda: run(simulation.robots, controllers, clock, duration=SPAN)


def bare(model: mujoco.MjModel) -> Callable[[], object]:
    """Return a function that steps the same scene for `SPAN` with nothing around it."""
    data = settle(model)
    for robot in ROBOTS:
        for wheel in WHEELS:
            motor = model.actuator(f"{robot}/{wheel}").id
            data.ctrl[motor] = DUTY * model.actuator_ctrlrange[motor, 1]
    nstep = 10
    ticks = round(SPAN / (nstep * model.opt.timestep))

    def step() -> None:
        for _ in range(ticks):
            mujoco.mj_step(model, data, nstep)

    return step
