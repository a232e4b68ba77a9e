"""A model driven by the commands of logs, for many values of its parameters at once."""

# mujoco.rollout has no stubs.
# pyright: reportMissingTypeStubs=false

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from perception.geometry.arrays import FloatArray
from twin.logs.log import Log, LogError
from twin.prediction.parameters import Parameter, explicit, write_all

SETTLING = 2.0
"""Time that a model is given to come to rest under the first commands [s]."""
BATCH = 64e6
"""Most numbers of a batch of simulations that are held at once."""
SMALL = 1e-6
"""Step of a coordinate that derivatives need, in deviations beforehand: dry friction bends what is
predicted so sharply that 1e-4 shows information on what no log can tell."""
ELSEWHERE = 4.0
"""Distance from the key frame of a joint that is measured elsewhere, in deviations of the noise."""
START_ANGLE, START_RATE = 0.1, 1.0
"""Spread of each degree of freedom's place about its measured one, and of its rate [SI]."""

HOLDING = 1e6
"""Inertia that holds a measured joint while all else comes to rest [kg m^2, kg]."""

_FILTERS = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)

Start = Literal["rest", "held", "moving"]
STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
"""What a simulation's state is: time, places, rates and activations."""


@dataclasses.dataclass(frozen=True)
class _Reading:
    """One sensor's samples, and where a simulation has them.

    Attributes:
        name: Name of the sensor.
        stamps: (n,) times of the samples [s].
        values: (n, k) samples.
        place: First column in the sensors' data, or in the state.
        in_state: Whether it is read from the state: the place or the rate of a joint.
        noise: (k,) standard deviations of the noise.
    """

    name: str
    stamps: FloatArray
    values: FloatArray
    place: int
    in_state: bool
    noise: FloatArray


@dataclasses.dataclass(frozen=True)
class _Run:
    """A log as a model needs it.

    Attributes:
        begin: Time of the first step [s].
        steps: Number of steps.
        commands: Stamps and values of each actuator's command.
        readings: What was measured.
        start: (nq,) places at the beginning, as far as they were measured.
        joints: Joints that were measured, with the names of their signals.
    """

    begin: float
    steps: int
    commands: Mapping[int, tuple[FloatArray, FloatArray]]
    readings: Sequence[_Reading]
    start: FloatArray
    joints: Mapping[int, str]


class ModelPredictor:
    """Predicts what the sensors of a model read, from the commands of logs.

    Commands act from their stamp on, later by the actuator's delay; over a step acts their mean. A
    signal is of the actuator or sensor of its name; ``JOINT.position`` and ``JOINT.velocity`` are
    those of a joint, without a sensor.

    Args:
        spec: The model as drawn.
        parameters: Parameters of the model.
        logs: Runs of the robot; NaN among their samples are left out.
        start: ``rest``: each run begins where the model comes to rest under its first commands,
            from the first key frame, or where joints were measured beyond noise of it; ``held``:
            joints that were measured are held so until the first command, and all else has come to
            rest; ``moving``: places and rates at the beginning are sought as well, two
            coordinates for each degree of freedom and run, after those of the parameters.

    Attributes:
        names: Names of all coordinates.
        lowest: (n,) their least values.
        measured: (r,) all samples, run by run, sensor by sensor, number by number.
        sigma: (r,) standard deviations of their noise: what the log says, else the model's sensor,
            else what its samples scatter about a smooth curve.
        channels: Where in `measured` the samples of each sensor's number are, by run and name.
        steps: (n,) steps of the coordinates that derivatives need: commands change in steps, so
            that of a delay is a time step.

    Raises:
        LogError: If a signal is of nothing in the model, or none is measured or commanded.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        parameters: Sequence[Parameter],
        logs: Sequence[Log],
        start: Start = "rest",
    ) -> None:
        self.parameters = list(parameters)
        self._spec = explicit(spec)
        self._model = self._spec.compile()
        self._start: Start = start
        self._runs = [_run(self._model, log) for log in logs]
        self._pool: Any = Rollout(nthread=os.cpu_count() or 1)
        self._data = [mujoco.MjData(self._model) for _ in range(os.cpu_count() or 1)]
        self.names = [each.name for each in parameters]
        if start == "moving":
            self.names += [
                f"run {run}: {what} of degree of freedom {dof}"
                for run in range(len(logs))
                for what in ("place", "rate")
                for dof in range(self._model.nv)
            ]
        lowest = [each.lowest for each in parameters]
        self.lowest = np.array(lowest + [-np.inf] * (len(self.names) - len(lowest)))
        step = self._model.opt.timestep
        own = [
            step / each.spread if each.scale == "from zero" and each.unit == "s" else SMALL
            for each in parameters
        ]
        self.steps = np.array(own + [SMALL] * (len(self.names) - len(own)))
        values: list[FloatArray] = []
        noise: list[FloatArray] = []
        self.channels: dict[tuple[int, str], slice] = {}
        end = 0
        for number, run in enumerate(self._runs):
            for reading in run.readings:
                count = reading.values.shape[1]
                for column, samples in enumerate(reading.values.T):
                    label = reading.name + (f"[{column}]" if count > 1 else "")
                    self.channels[number, label] = slice(end, end + len(samples))
                    end += len(samples)
                    values.append(samples)
                    noise.append(np.full(len(samples), reading.noise[column]))
        self.measured, self.sigma = np.concatenate(values), np.concatenate(noise)

    def close(self) -> None:
        """End the threads."""
        self._pool.close()

    def stamps(self, run: int, channel: str) -> FloatArray:
        """Return the times of a channel's samples [s]."""
        name = channel.partition("[")[0]
        return next(each.stamps for each in self._runs[run].readings if each.name == name)

    def tuned(self, coordinates: FloatArray) -> mujoco.MjSpec:
        """Return the model's specification with parameters at coordinates (n,)."""
        spec = self._spec.copy()
        write_all(spec, self.parameters, coordinates[: len(self.parameters)])
        return spec

    def __call__(self, coordinates: FloatArray) -> FloatArray:
        """Return what would be measured.

        Args:
            coordinates: (m, n) coordinates of each simulation.

        Returns:
            (m, r) predictions, in the order of `measured`; NaN where a simulation diverged.
        """
        result = np.empty((len(coordinates), len(self.measured)))
        models = [self.tuned(each).compile() for each in coordinates]
        end = 0
        for number, run in enumerate(self._runs):
            size = sum(reading.values.size for reading in run.readings)
            width = self._model.nq + self._model.nv + self._model.nsensordata + self._model.nu
            batch = max(1, int(BATCH / (run.steps * width)))
            for first in range(0, len(models), batch):
                rows = slice(first, first + batch)
                part = self._simulate(number, models[rows], coordinates[rows])
                result[rows, end : end + size] = part
            end += size
        return result

    def _simulate(
        self, number: int, models: list[mujoco.MjModel], coordinates: FloatArray
    ) -> FloatArray:
        run = self._runs[number]
        values = [self._values(each) for each in coordinates]
        control = np.array([self._control(run, each) for each in values])
        begin = self._begin(number, models, coordinates, control)
        states, sensed = self._roll(models, begin, control, run.steps)
        states = np.concatenate([begin[:, None], states[:, :-1]], axis=1)
        step = self._model.opt.timestep
        found = np.empty((len(models), sum(reading.values.size for reading in run.readings)))
        for row, own in enumerate(values):
            parts: list[FloatArray] = []
            for reading in run.readings:
                source = states if reading.in_state else sensed
                count = reading.values.shape[1]
                columns = source[row, :, reading.place : reading.place + count]
                parts.append(_sampled(columns, reading, run.begin, step, own).T.ravel())
            found[row] = np.concatenate(parts)
        return found

    def _values(self, coordinates: FloatArray) -> dict[str, float]:
        """Return the value of each parameter, by name."""
        return {
            each.name: each.value(coordinate)
            for each, coordinate in zip(self.parameters, coordinates.tolist())
        }

    def _control(self, run: _Run, values: Mapping[str, float]) -> FloatArray:
        """Return the mean command of each step (steps, nu)."""
        step = self._model.opt.timestep
        times = run.begin + step * np.arange(run.steps + 1)
        control = np.zeros((run.steps, self._model.nu))
        for index, (stamps, commands) in run.commands.items():
            name = self._model.actuator(index).name
            own = values.get(f"actuator.{name}.delay", 0.0)
            late = times - values.get("delay", 0.0) - own
            control[:, index] = np.diff(_integral(stamps, commands, late)) / step
        return control

    def _begin(
        self,
        number: int,
        models: list[mujoco.MjModel],
        coordinates: FloatArray,
        control: FloatArray,
    ) -> FloatArray:
        """Return the state of each simulation at the beginning of a run."""
        begin = np.empty((len(models), mujoco.mj_stateSize(self._model, STATE)))
        data, nv = self._data[0], self._model.nv
        first = len(self.parameters) + 2 * nv * number
        run = self._runs[number]
        for model, own, state, commands in zip(models, coordinates, begin, control[:, 0]):
            rest(model, data, run.start, commands)
            values = self._values(own)
            for joint, name in run.joints.items():
                data.qpos[model.jnt_qposadr[joint]] -= values.get(f"sensor.{name}.bias", 0.0)
            if self._start == "moving":
                off = START_ANGLE * own[first : first + nv]
                mujoco.mj_integratePos(model, data.qpos, off, 1.0)
                data.qvel[:] = START_RATE * own[first + nv : first + 2 * nv]
            mujoco.mj_getState(model, data, state, STATE)
        if self._start == "moving":
            return begin
        dofs = [self._model.jnt_dofadr[joint] for joint in run.joints]
        own_inertia = [model.dof_armature.copy() for model in models]
        if self._start == "held":
            for model in models:
                model.dof_armature[dofs] = HOLDING
        steps = round(SETTLING / self._model.opt.timestep)
        settled, _ = self._roll(models, begin, control[:, :1], steps)
        for model, inertia in zip(models, own_inertia):
            model.dof_armature[:] = inertia
        begin = settled[:, -1].copy()
        begin[:, 0] = 0.0
        return begin

    def _roll(
        self, models: list[mujoco.MjModel], begin: FloatArray, control: FloatArray, steps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return the states after each step, and what sensors read before it."""
        return self._pool.rollout(models, self._data, begin, control, nstep=steps)


def _integral(stamps: FloatArray, values: FloatArray, times: FloatArray) -> FloatArray:
    """Return the integral of a held command from its first stamp to some times."""
    sums = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(stamps))])
    last = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, len(stamps) - 1)
    return sums[last] + values[last] * (times - stamps[last])


def _sampled(
    columns: FloatArray, reading: _Reading, begin: float, step: float, values: Mapping[str, float]
) -> FloatArray:
    """Return a sensor's numbers (n, k) at its stamps, with its delay, gain and bias."""
    late = reading.stamps - values.get(f"sensor.{reading.name}.delay", 0.0)
    steps = np.clip((late - begin) / step, 0.0, len(columns) - 1.0)
    before = np.minimum(steps.astype(int), len(columns) - 2)
    share = (steps - before)[:, None]
    found: FloatArray = (1.0 - share) * columns[before] + share * columns[before + 1]
    count = found.shape[1]
    for column in range(count):
        end = f"_{column}" if count > 1 else ""
        found[:, column] *= values.get(f"sensor.{reading.name}.gain{end}", 1.0)
        found[:, column] += values.get(f"sensor.{reading.name}.bias{end}", 0.0)
    return found


def _run(model: mujoco.MjModel, log: Log) -> _Run:
    commands: dict[int, tuple[FloatArray, FloatArray]] = {}
    readings: list[_Reading] = []
    start, joints = rest_of(model), dict[int, str]()
    for name, signal in log.signals.items():
        good = np.isfinite(signal.values).all(axis=1) & np.isfinite(signal.stamps)
        order = np.flatnonzero(good)
        order = order[np.argsort(signal.stamps[order], kind="stable")]
        stamps, values = signal.stamps[order], signal.values[order]
        if not len(stamps):
            raise LogError(f"{name}: no sample is a number")
        if signal.role == "actuator":
            index = _index(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name, "actuator")
            _expect(name, values, 1)
            commands[index] = stamps, values[:, 0]
        else:
            reading = _reading(model, name, stamps, values, signal.noise)
            readings.append(reading)
            joint = _joint_of(model, reading)
            if joint is not None:
                joints[joint] = name
                place = int(model.jnt_qposadr[joint])
                # Where dry friction holds a joint, the first sample's noise would stay.
                if abs(values[0, 0] - start[place]) > ELSEWHERE * reading.noise[0]:
                    start[place] = values[0, 0]
    if not readings or not commands:
        raise LogError("no sensor is measured" if commands else "no actuator is commanded")
    ends = [stamps for stamps, _ in commands.values()] + [each.stamps for each in readings]
    begin = min(float(each[0]) for each in ends)
    last = max(float(each.stamps[-1]) for each in readings)
    steps = int(np.ceil((last - begin) / model.opt.timestep)) + 2
    return _Run(begin, steps, commands, readings, start, joints)


def rest_of(model: mujoco.MjModel) -> FloatArray:
    """Return the places (nq,) at rest: those of the first key frame, if there is one."""
    return model.key_qpos[0].copy() if model.nkey else model.qpos0.copy()


def rest(
    model: mujoco.MjModel, data: mujoco.MjData, places: FloatArray, command: FloatArray
) -> None:
    """Set a simulation to rest at places (nq,) under a command (nu,) that filters have followed."""
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.ctrl[:] = places, command
    for index in np.flatnonzero(np.isin(model.actuator_dyntype, _FILTERS)):
        data.act[model.actuator_actadr[index]] = command[index]


def _joint_of(model: mujoco.MjModel, reading: _Reading) -> int | None:
    """Return the joint of which a reading is the place, or none."""
    if reading.in_state:
        places = np.flatnonzero(model.jnt_qposadr == reading.place - 1)
        return int(places[0]) if len(places) else None
    sensor = int(np.flatnonzero(model.sensor_adr == reading.place)[0])
    is_place = model.sensor_type[sensor] == mujoco.mjtSensor.mjSENS_JOINTPOS
    return int(model.sensor_objid[sensor]) if is_place else None


def _reading(
    model: mujoco.MjModel, name: str, stamps: FloatArray, values: FloatArray, noise: float
) -> _Reading:
    joint, _, what = name.rpartition(".")
    sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    if sensor < 0 and what in ("position", "velocity"):
        index = _index(model, mujoco.mjtObj.mjOBJ_JOINT, joint, "joint")
        kind = mujoco.mjtJoint(model.jnt_type[index])
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            raise LogError(f"{name}: only hinges and slides can be measured without a sensor")
        _expect(name, values, 1)
        place = 1 + int(model.jnt_qposadr[index])
        if what == "velocity":
            place = 1 + model.nq + int(model.jnt_dofadr[index])
        return _Reading(name, stamps, values, place, True, _noise(values, noise))
    index = _index(model, mujoco.mjtObj.mjOBJ_SENSOR, name, "sensor")
    _expect(name, values, int(model.sensor_dim[index]))
    noise = noise if noise > 0.0 else float(model.sensor_noise[index])
    place = int(model.sensor_adr[index])
    return _Reading(name, stamps, values, place, False, _noise(values, noise))


def _noise(values: FloatArray, known: float) -> FloatArray:
    """Return the deviation of each number's noise (k,): `known`, if it is above zero.

    Else that of its scatter about a curve that is smooth over seven samples, but no less than what
    rounding to the smallest difference of two samples leaves.
    """
    if known > 0.0:
        return known * np.ones(values.shape[1])
    found = np.empty(values.shape[1])
    for column, samples in enumerate(values.T):
        sixth: FloatArray = np.diff(samples, 6)
        scatter = np.sqrt(np.mean(sixth**2) / 924.0) if len(sixth) else 0.0
        apart: FloatArray = np.diff(np.unique(samples))
        rounding = float(np.min(apart)) / 12.0**0.5 if len(apart) else 0.0
        found[column] = max(float(scatter), float(rounding))
    if not np.all(found > 0.0):
        raise LogError("never changes, so that its noise cannot be told; say it in the mapping")
    return found


def _index(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str, what: str) -> int:
    index = mujoco.mj_name2id(model, kind, name)
    if index < 0:
        count = {"actuator": model.nu, "sensor": model.nsensor, "joint": model.njnt}[what]
        there = [getattr(model, what)(each).name for each in range(count)]
        raise LogError(f"the model has no {what} {name!r}; there are {', '.join(there) or 'none'}")
    return index


def _expect(name: str, values: FloatArray, count: int) -> None:
    if values.shape[1] != count:
        raise LogError(f"{name}: {values.shape[1]} numbers in the log, {count} in the model")
