"""Compiled scenes and what tests read off them, and the line of a motor."""

import dataclasses

import mujoco
import numpy as np

from models.compose import FLAT, FieldConfig, RobotPlacement, make_model, settle
from models.datasheets import MotorSheet

PLAIN = dataclasses.replace(FLAT, texture_pixels=16)
"""Flat ground with a small texture: quick to compile."""


@dataclasses.dataclass
class Scene:
    """A compiled scene and its state at rest; `start` gives a fresh copy of that state."""

    model: mujoco.MjModel
    rest: mujoco.MjData

    def start(self) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        mujoco.mj_copyData(data, self.model, self.rest)
        return data

    def run(self, data: mujoco.MjData, seconds: float) -> mujoco.MjData:
        mujoco.mj_step(self.model, data, round(seconds / self.model.opt.timestep))
        assert not warnings(data)
        return data


def warnings(data: mujoco.MjData) -> dict[str, int]:
    """Return MuJoCo's warnings so far, by name."""
    kinds = mujoco.mjtWarning
    return {
        kinds(i).name: w.number for i, w in enumerate(data.warning) if w.number and i < len(kinds)
    }


def make_scene(*robots: RobotPlacement, field: FieldConfig = PLAIN) -> Scene:
    model = make_model(field, robots)
    return Scene(model, settle(model))


def tilt(data: mujoco.MjData, body: str) -> np.ndarray:
    """Return pitch and roll of a body [rad]."""
    rotation = data.body(body).xmat.reshape(3, 3)
    return np.arctan2([rotation[2, 1], -rotation[2, 0]], [rotation[1, 1], rotation[2, 2]])


def shaft_torque(motor: MotorSheet, duty: float, speed: float) -> float:
    """Return the torque [N m] left at a shaft that turns forward [rad/s] at a duty of -1 to 1."""
    drive = duty - speed / motor.gross_no_load_speed
    return motor.gross_stall_torque * drive - motor.friction
