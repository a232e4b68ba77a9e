"""Foreign robots as made, which nobody is told: drawn by a seed, and simulated by plain steps.

A hidden robot is its drawing with every parameter in question elsewhere. Its physics takes steps of
a tenth of the model's, its commands act late, and its sensors are sampled unevenly, with noise.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np

from experiments.own.identification import load_model
from perception.geometry.arrays import FloatArray, IndexArray
from twin.logs.log import Log, Signal
from twin.prediction.parameters import Parameter, explicit, select, write_all
from twin.prediction.predictor import SETTLING

ROBOTS = Path(__file__).parents[1] / "robots"
PERIOD, SAMPLING = 0.002, 0.01
"""Between two commands, and two samples [s]."""
LATE, JITTER = 0.0033, 0.001
"""Of the first sample, and of each about its time [s]."""
FINE = 10
"""Steps of the hidden robot in one of the model."""
SPREAD = 1.0
"""Range of what is off, to both sides, in deviations beforehand (30 % of most values)."""


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of robot, and what is asked of it.

    Attributes:
        name: Name of its model file.
        parameters: What is to be identified, as `select` takes it.
        planted: What no motion tells, by the model's own mechanics.
        highest: Highest frequency of its motions [Hz].
    """

    name: str
    parameters: tuple[str, ...]
    planted: tuple[str, ...]
    highest: float

    @property
    def path(self) -> Path:
        """File of its model."""
        return ROBOTS / f"{self.name}.xml"

    def spec(self) -> mujoco.MjSpec:
        """Return its model as drawn."""
        return load_model(self.path)

    def selected(self) -> list[Parameter]:
        """Return its parameters, those planted last."""
        return select(explicit(self.spec()), [*self.parameters, *self.planted], {})


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        each.name: each
        for each in (
            Kind(
                "arm",
                (
                    "joint.*",
                    "body.fore.mass",
                    "body.tool.mass",
                    "body.tool.centre_x",
                    "body.tool.centre_z",
                    "delay",
                ),
                ("body.base.centre_z", "body.shoulder.centre_z"),
                2.0,
            ),
            Kind(
                "leg",
                (
                    "joint.*",
                    "body.thigh.mass",
                    "body.shank.mass",
                    "body.shank.centre_z",
                    "actuator.*.gain",
                    "delay",
                ),
                ("body.stand.mass", "body.stand.centre_x"),
                4.0,
            ),
            Kind(
                "cart",
                (
                    "joint.*.damping",
                    "joint.*.stiffness",
                    "joint.rail.friction",
                    "body.*.mass",
                    "delay",
                ),
                ("body.cart.centre_x", "body.cart.stretch_y"),
                6.0,
            ),
        )
    }
)


def drawn_coordinates(kind: Kind, generator: np.random.Generator) -> FloatArray:
    """Return the coordinates (n,) of a robot as made; its delay is a whole number of fine steps."""
    parameters = kind.selected()
    off = SPREAD * generator.uniform(-1.0, 1.0, len(parameters))
    step = kind.spec().option.timestep / FINE
    for index, each in enumerate(parameters):
        if each.name == "delay":
            off[index] = step * round(abs(off[index]) * each.spread / step) / each.spread
    return off


def logged(
    kind: Kind, coordinates: FloatArray, commands: FloatArray, generator: np.random.Generator
) -> Log:
    """Let a robot as made follow commands, and return its log.

    Args:
        kind: The kind of robot.
        coordinates: (n,) of its parameters.
        commands: (m, k) commands, one a `PERIOD`.
        generator: Random generator of the sensors.
    """
    parameters = kind.selected()
    spec = explicit(kind.spec())
    write_all(spec, parameters, coordinates)
    delay = sum(each.value(at) for each, at in zip(parameters, coordinates) if each.name == "delay")
    spec.option.timestep /= FINE
    model = spec.compile()
    step: float = model.opt.timestep
    end = PERIOD * len(commands)
    ideal = np.arange(LATE, end, SAMPLING)
    ticks = np.round((ideal + JITTER * generator.uniform(-1.0, 1.0, len(ideal))) / step).astype(int)
    rows = _sensed(model, commands, delay, ticks)
    noise = np.repeat(model.sensor_noise, model.sensor_dim)
    rows += noise * generator.standard_normal(rows.shape)
    return _log(model, commands, step * ticks, rows)


def _sensed(
    model: mujoco.MjModel, commands: FloatArray, delay: float, ticks: IndexArray
) -> FloatArray:
    """Return what sensors read (n, r) at some steps, the first of which is that of time zero."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = commands[0]
    mujoco.mj_step(model, data, round(SETTLING / model.opt.timestep))
    held = round(PERIOD / model.opt.timestep)
    late = round(delay / model.opt.timestep)
    rows = np.empty((len(ticks), model.nsensordata))
    done = 0
    for tick in range(int(ticks[-1]) + 1):
        data.ctrl[:] = commands[max(0, tick - late) // held]
        mujoco.mj_step(model, data)  # Sensors are those of the step's beginning.
        if tick == ticks[done]:
            rows[done] = data.sensordata
            done += 1
    return rows


def _log(model: mujoco.MjModel, commands: FloatArray, stamps: FloatArray, rows: FloatArray) -> Log:
    given: FloatArray = PERIOD * np.arange(len(commands), dtype=np.float64)
    signals = {
        model.actuator(index).name: Signal("actuator", given, commands[:, [index]])
        for index in range(model.nu)
    }
    for index in range(model.nsensor):
        first, count = int(model.sensor_adr[index]), int(model.sensor_dim[index])
        signals[model.sensor(index).name] = Signal("sensor", stamps, rows[:, first : first + count])
    return Log(signals)
