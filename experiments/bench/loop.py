"""Time of the loop beside bare physics: contract, sensors and servos of two rovers."""

from collections.abc import Callable

import mujoco
import numpy as np

from controllers.motion.simple_motions import DriveAndHold
from experiments.bench.bench_options import Options
from experiments.harness.output import Output
from experiments.harness.timing import compare
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from twin.loop import LoopRecorder, Tick, run
from twin.simulation import Simulation

ROBOTS = ("rover1", "rover2")
WHEEL_SPEED = 2.0  # [rad/s]
SPAN = 0.5  # [s] of simulated time in one timed call
SUBSTEPS = 10
OVERHEAD_BOUND = 1.2
FIELDS = {
    # name -> (field, least real-time factor on one core)
    "plane": (FieldConfig(), 10.0),
    "rocks": (FieldConfig(rocks=40), 4.0),
    "patches": (FieldConfig(friction_patches=(0.3, 0.9)), 10.0),
}


class VoltageRecorder(LoopRecorder):
    """Records the motor voltages of every tick, for the peer to repeat."""

    def __init__(self, data: mujoco.MjData) -> None:
        self.voltages: list[np.ndarray] = []
        self._data = data

    def record(self, tick: Tick) -> None:
        """Record the voltages at the end of the previous tick."""
        if tick.step > 0:
            self.voltages.append(self._data.ctrl.copy())


def bench_loop(options: Options, output: Output) -> None:
    """Time the loop against ``mj_step(nstep=10)`` of the same motion of the same scene.

    Args:
        options: ``quick`` takes fewer rounds.
        output: Receives ``loop_overhead`` (on the plane), ``loop_overhead/<field>`` and
            ``rtf/<field>``, the real-time factor of the loop. The peer's tyres keep the friction
            with which they begin.
    """
    rounds = 10 if options.quick else 40
    for name, (field, least) in FIELDS.items():
        ours, peer = contestants(field)
        times = compare(ours, peer, rounds)
        overhead = times["ratio"]
        output.measure("loop_overhead" if name == "plane" else f"loop_overhead/{name}", overhead)
        value = overhead["median"]
        output.check(
            f"loop overhead, {name}", value, f"<= {OVERHEAD_BOUND}", value <= OVERHEAD_BOUND
        )
        factor = SPAN / times["ours_s"]["median"]
        output.measure(f"rtf/{name}", factor)
        output.check(f"real-time factor, {name}", factor, f">= {least:g}", factor >= least)


def contestants(field: FieldConfig) -> tuple[Callable[[], object], Callable[[], object]]:
    """Return two functions that move two rovers alike for `SPAN`: by the loop, and bare.

    Both begin at rest each time; the bare one repeats the voltages of the loop.

    Args:
        field: Ground that they drive on.
    """
    placements = [RobotPlacement(ROBOTS[0]), RobotPlacement(ROBOTS[1], (1.0, 0.0))]
    model = make_model(field, placements)
    simulation = Simulation(model, ROBOTS, data=settle(model))
    clock, controllers = simulation, [DriveAndHold(WHEEL_SPEED)]
    begin = simulation.save()

    def ours() -> None:
        simulation.restore(begin)
        run(simulation.robots, controllers, clock, duration=SPAN)

    recorder = VoltageRecorder(simulation.data)
    run(simulation.robots, controllers, clock, [recorder], duration=SPAN + simulation.period)
    data = mujoco.MjData(model)

    def peer() -> None:
        mujoco.mj_setState(model, data, begin.physics, mujoco.mjtState.mjSTATE_INTEGRATION)
        for voltages in recorder.voltages:
            data.ctrl[:] = voltages
            mujoco.mj_step(model, data, SUBSTEPS)

    return ours, peer
