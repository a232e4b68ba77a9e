"""``mujoco.sysid`` on the same log: the same parameters, coordinates, noise and delay."""

# mujoco.sysid has no stubs.
# pyright: reportMissingTypeStubs=false

import io
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from mujoco.sysid import ModelSequences  # mujoco.sysid is there, but empty, without its extra.

from perception.geometry.arrays import FloatArray
from twin.logs.log import Log
from twin.prediction.parameters import Parameter, explicit, write_all
from twin.prediction.predictor import SETTLING, rest, rest_of

SPAN = 3.0
"""Bounds of the coordinates, in deviations beforehand."""
SKIPPED = 0.5
"""Beginning that does not count [s]: where it comes to rest is that of the drawing."""
THETA = "theta"


def fit_by_peer(spec: mujoco.MjSpec, parameters: Sequence[Parameter], log: Log) -> FloatArray:
    """Return the coordinates (n,) that ``mujoco.sysid`` finds.

    Delayed commands are delayed readings, as the robot rests before; so its own remedy serves.
    """
    drawn = explicit(spec)
    model = drawn.compile()
    step = float(model.opt.timestep)
    control = _control(model, log)
    sensors = [model.sensor(index).name for index in range(model.nsensor)]
    stamps = log.signals[sensors[0]].stamps
    measured = np.hstack([log.signals[name].values for name in sensors])
    sigma = np.repeat(model.sensor_noise, model.sensor_dim)
    used = stamps > SKIPPED

    def build(params: Any, changed: mujoco.MjSpec) -> mujoco.MjModel:
        copy = changed.copy()
        write_all(copy, parameters, params[THETA].value)
        return copy.compile()

    def compare(
        params: Any, predicted: Any, recorded: Any, *_: Any, **__: Any
    ) -> tuple[FloatArray, Any, Any]:
        delay = sum(
            each.value(at)
            for each, at in zip(parameters, params[THETA].value)
            if each.name == "delay"
        )
        times = step * np.arange(len(predicted.data))
        columns = [np.interp(stamps[used] - delay, times, each) for each in predicted.data.T]
        off = (np.column_stack(columns) - measured[used]) / sigma
        return off.ravel(), recorded, recorded

    unused = sysid.TimeSeries(control.times[:1], np.zeros((1, model.nsensordata)))
    sequences = [ModelSequences("robot", drawn, "run", _settled(model, control), control, unused)]
    residual = sysid.build_residual_fn(
        models_sequences=sequences,
        build_model=build,
        modify_residual=compare,
        resample_true=False,
        n_threads=1,
    )
    params = sysid.ParameterDict()
    lowest = np.maximum([each.lowest for each in parameters], -SPAN)
    begin = np.maximum(np.zeros(len(parameters)), lowest)
    params.add(sysid.Parameter(THETA, begin, lowest, np.full(len(parameters), SPAN)))
    found, _ = sysid.optimize(
        params, residual, optimizer="mujoco", verbose=False, output=io.StringIO()
    )
    return np.asarray(found[THETA].value)


def _control(model: mujoco.MjModel, log: Log) -> Any:
    """Return each step's command, that which was last given at its beginning."""
    step = float(model.opt.timestep)
    first = log.signals[model.actuator(0).name]
    times = np.arange(0.0, float(first.stamps[-1]), step)
    rows = np.searchsorted(first.stamps, times + 1e-9, side="right") - 1
    columns = [log.signals[model.actuator(k).name].values[rows, 0] for k in range(model.nu)]
    return sysid.TimeSeries(times, np.column_stack(columns))


def _settled(model: mujoco.MjModel, control: Any) -> FloatArray:
    data = mujoco.MjData(model)
    rest(model, data, rest_of(model), control.data[0])
    mujoco.mj_step(model, data, round(SETTLING / model.opt.timestep))
    return sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
