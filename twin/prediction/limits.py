"""What a robot may do in a motion, and whether a motion keeps to it; checked by simulation."""

# mujoco.rollout has no stubs.
# pyright: reportMissingTypeStubs=false

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
from mujoco.rollout import rollout

from perception.geometry import files
from perception.geometry.arrays import FloatArray
from twin.prediction.parameters import ModelError
from twin.prediction.predictor import SETTLING, STATE, rest, rest_of

STRIDE = 5
"""Steps between two looks at forces, sites and contacts."""
_KEYS = {
    "joints": {"position", "rate"},
    "actuators": {"command", "force"},
    "sites": {"low", "high"},
}


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits of a motion, by name in the model; what is not named is free.

    Attributes:
        positions: Lowest and highest position of hinges and slides [rad, m].
        rates: Largest rate of these [rad/s, m/s].
        commands: Lowest and highest command of actuators.
        forces: Largest force of actuators [N, N m].
        sites: Corners of a box in the world that a site keeps within [m].
        contacts: Whether bodies may touch that do not touch at the start.
    """

    positions: Mapping[str, tuple[float, float]]
    rates: Mapping[str, float]
    commands: Mapping[str, tuple[float, float]]
    forces: Mapping[str, float]
    sites: Mapping[str, tuple[FloatArray, FloatArray]]
    contacts: bool = False

    @classmethod
    def of_model(cls, model: mujoco.MjModel) -> "Limits":
        """Return the ranges that a model states."""
        joints = [model.joint(index) for index in range(model.njnt)]
        actuators = [model.actuator(index) for index in range(model.nu)]
        return cls(
            {each.name: _pair(each.range) for each in joints if model.jnt_limited[each.id]},
            {},
            {each.name: _pair(each.ctrlrange) for each in actuators if each.ctrllimited[0]},
            {
                each.name: float(np.abs(each.forcerange).min())
                for each in actuators
                if each.forcelimited[0]
            },
            {},
        )

    def excess(self, model: mujoco.MjModel, controls: FloatArray) -> float:
        """Return how far a motion goes, over what it may: at most 1 keeps to all limits.

        A position counts by its distance from the start, over the limit's. A motion that starts
        outside of a limit, diverges, or lets bodies touch is infinitely far off.

        Args:
            model: The model.
            controls: (steps, nu) commands of each time step; it is settled under the first.
        """
        data = mujoco.MjData(model)
        rest(model, data, rest_of(model), controls[0])
        mujoco.mj_step(model, data, round(SETTLING / model.opt.timestep))
        touching = data.ncon
        start = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, start, STATE)
        rolled: Any = cast(Any, rollout)(model, data, start[None], controls[None])
        states: FloatArray = np.concatenate([start[None], rolled[0][0]])
        if not np.isfinite(states).all():
            return np.inf
        found = [0.0]
        for name, (low, high) in self.commands.items():
            found.append(_share(controls[:, model.actuator(name).id], low, high))
        for name, (low, high) in self.positions.items():
            found.append(_share(states[:, 1 + int(model.joint(name).qposadr[0])], low, high))
        for name, most in self.rates.items():
            rates = states[:, 1 + model.nq + int(model.joint(name).dofadr[0])]
            found.append(float(np.abs(rates).max()) / most)
        if self.forces or self.sites or not self.contacts:
            found.append(self._seen(model, data, states[::STRIDE], touching))
        return max(found)

    def _seen(
        self, model: mujoco.MjModel, data: mujoco.MjData, states: FloatArray, touching: int
    ) -> float:
        """Return by how much what the state does not hold is off."""
        forces = np.empty((len(states), model.nu))
        places = {name: np.empty((len(states), 3)) for name in self.sites}
        for row, state in enumerate(states):
            mujoco.mj_setState(model, data, state, STATE)
            mujoco.mj_forward(model, data)
            if data.ncon > touching and not self.contacts:
                return np.inf
            forces[row] = data.actuator_force
            for name, found in places.items():
                found[row] = data.site(name).xpos
        shares = [
            float(np.abs(forces[:, model.actuator(name).id]).max()) / most
            for name, most in self.forces.items()
        ]
        for name, (low, high) in self.sites.items():
            corners = zip(places[name].T, low.tolist(), high.tolist())
            shares += [_share(column, first, last) for column, first, last in corners]
        return max(shares, default=0.0)


def read_limits(path: Path, model: mujoco.MjModel) -> Limits:
    """Read limits, on top of the ranges that the model states.

    Raises:
        ModelError: In one line that names the file, the entry and what is expected.
    """
    try:
        return _limits(files.read_toml(path, files.SETTINGS), model)
    except (OSError, ValueError, TypeError) as error:
        text = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise ModelError(f"{path}: {text}") from None


def _limits(content: Mapping[str, Any], model: mujoco.MjModel) -> Limits:
    found = Limits.of_model(model)
    positions, commands = dict(found.positions), dict(found.commands)
    rates, forces = dict(found.rates), dict(found.forces)
    sites: dict[str, tuple[FloatArray, FloatArray]] = {}
    if unknown := sorted(content.keys() - _KEYS.keys() - {"contacts"}):
        raise ValueError(f"unknown entry {unknown[0]}; there are contacts, {', '.join(_KEYS)}")
    for table, known in _KEYS.items():
        there = _names(model, table)
        for name, entry in cast("dict[str, dict[str, Any]]", content.get(table, {})).items():
            where = f"{table}.{name}"
            if name not in there:
                raise ValueError(f"{where}: not in the model; there are {', '.join(there)}")
            if not set(entry) <= known:
                raise ValueError(f"{where}: expected some of {', '.join(sorted(known))}")
            for key, value in entry.items():
                match key:
                    case "position":
                        positions[name] = _ends(where, value)
                    case "command":
                        commands[name] = _ends(where, value)
                    case "rate":
                        rates[name] = _most(where, value)
                    case "force":
                        forces[name] = _most(where, value)
                    case _:
                        pass
            if table == "sites":
                corners = [np.array(entry.get(key, []), dtype=float) for key in ("low", "high")]
                if any(corner.shape != (3,) for corner in corners):
                    raise ValueError(f"{where}: low and high are x, y and z [m]")
                sites[name] = corners[0], corners[1]
    contacts = content.get("contacts", False)
    if not isinstance(contacts, bool):
        raise ValueError("contacts is true or false")
    return Limits(positions, rates, commands, forces, sites, contacts)


def _names(model: mujoco.MjModel, table: str) -> list[str]:
    counts = {"joints": model.njnt, "actuators": model.nu, "sites": model.nsite}
    return [getattr(model, table[:-1])(index).name for index in range(counts[table])]


def _ends(where: str, value: Any) -> tuple[float, float]:
    low, high = _pair(value)
    if not low < high:
        raise ValueError(f"{where}: expected [lowest, highest], got {value}")
    return low, high


def _most(where: str, value: Any) -> float:
    if not float(value) > 0.0:
        raise ValueError(f"{where}: expected a number above 0, got {value}")
    return float(value)


def _pair(values: Any) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _share(values: FloatArray, low: float, high: float) -> float:
    """Return the longest way from the first value, over that to the limit on its side."""
    start = float(values[0])
    if not low < start < high:
        return np.inf
    above, below = float(values.max()) - start, start - float(values.min())
    return max(above / (high - start), below / (start - low))
