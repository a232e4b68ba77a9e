"""The chapter 2 plant in MuJoCo, and the noise on what is measured of it."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.identification.arm_motion import Trajectory, mode_axes
from controllers.identification.compliant_base import CHANNELS
from models.compliant_base.build import compile_plant

FloatArray = NDArray[np.float64]

NOISE_FRACTION = 0.1
"""White noise of up to 10 % of the maximum sensed value (Thesis section 2.6.1)."""


class Plant:
    """One mode of the simplified plant, from static rest with the arm at `rest_angle`."""

    def __init__(
        self,
        parameters: Mapping[str, float],
        mode: str,
        rest_angle: float = np.pi / 4,
        time_step: float = 0.0005,
        hinges_outermost: bool = False,
    ) -> None:
        """Compile the plant and load its springs so that it rests.

        Args:
            parameters: The 22 true values by name.
            mode: "x", "y" or "z".
            rest_angle: Arm angle at rest [rad].
            time_step: Physics step [s]; the compliance is stiff, keep it at or below 0.5 ms.
            hinges_outermost: Build the joints in the order that the estimators do not expect.
        """
        self._axis, self._rotation = mode_axes(mode)
        self._model = compile_plant(parameters, self._axis, self._rotation, hinges_outermost)
        first, second = slice(0, 3), slice(3, 6)
        self._slides, self._hinges = (second, first) if hinges_outermost else (first, second)
        self._model.opt.timestep = time_step
        self._data = mujoco.MjData(self._model)
        self._data.qpos[6] = rest_angle
        mujoco.mj_forward(self._model, self._data)
        self._data.qfrc_applied[:] = self._data.qfrc_bias
        mujoco.mj_forward(self._model, self._data)
        self._rest_wrench = self._wrench()

    def _wrench(self) -> FloatArray:
        """Return force and moment (6,) on the arm at the mount, base frame."""
        turn = np.empty(9)
        quaternion = np.empty(4)
        mujoco.mju_axisAngle2Quat(quaternion, self._axis, self._data.qpos[6])
        mujoco.mju_quat2Mat(turn, quaternion)
        to_base = turn.reshape(3, 3) @ self._rotation
        sensed = self._data.sensordata.reshape(2, 3)
        return (sensed @ to_base.T).ravel()

    def follow(self, trajectory: Trajectory) -> FloatArray:
        """Swing the arm along `trajectory`, which starts where the arm is.

        Returns:
            (n, 24) noise-free outputs at the steps' ends, rows as `compliant_base.SIGNALS`.
        """
        steps = round(trajectory.time_step / self._model.opt.timestep)
        outputs = np.empty((len(trajectory.jerk), CHANNELS))
        data = self._data
        for row, jerk in zip(outputs, trajectory.jerk, strict=True):
            data.ctrl[0] = jerk
            mujoco.mj_step(self._model, data, nstep=steps)
            mujoco.mj_forward(self._model, data)
            for start, state in enumerate((data.qpos, data.qvel, data.qacc)):
                row[3 * start : 3 * start + 3] = state[self._slides]
                row[9 + 3 * start : 12 + 3 * start] = state[self._hinges]
            row[18:24] = self._wrench() - self._rest_wrench
        return outputs
