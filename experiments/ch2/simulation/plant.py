"""The chapter 2 plant in MuJoCo, and the noise on what is measured of it."""

from collections.abc import Mapping

import mujoco
import numpy as np

from controllers.identification.arm_motion import Trajectory, mode_axes
from controllers.identification.compliant_base import CHANNELS
from controllers.identification.parameters import NAMES, inertia_tensor
from models.compliant_base.build import compile_plant
from perception.geometry.arrays import FloatArray

NOISE_FRACTION = 0.1
"""White noise of up to 10 % of the maximum sensed value (Thesis section 2.6.1)."""

SAMPLING = 0.005  # [s] (Thesis section 2.6.1)


def stable_step(parameters: Mapping[str, float]) -> float:
    """Return a step [s] that RK4 bears, a whole fraction of 5 ms and at most 0.5 ms.

    The stiffest motion is rotation held back by its damping alone, at b / I; RK4 is stable up to
    2.8 I / b.
    """
    inertia = inertia_tensor(np.array([parameters[name] for name in NAMES]))
    fastest = max(parameters[name] for name in ("b_pitch", "b_roll", "b_yaw"))
    longest = min(0.0005, 2 * float(np.linalg.eigvalsh(inertia)[0]) / fastest)
    return SAMPLING / int(np.ceil(SAMPLING / longest - 1e-9))


class Plant:
    """One mode of the simplified plant, from static rest with the arm at `rest_angle`."""

    def __init__(
        self,
        parameters: Mapping[str, float],
        mode: str,
        rest_angle: float = np.pi / 4,
        time_step: float | None = None,
        hinges_outermost: bool = False,
    ) -> None:
        """Compile the plant and load its springs so that it rests.

        Args:
            parameters: The 22 true values by name.
            mode: "x", "y" or "z".
            rest_angle: Arm angle at rest [rad].
            time_step: Physics step [s]; unless given, one at which the compliance is stable.
            hinges_outermost: Build the joints in the order that the estimators do not expect.
        """
        self._axis, self._rotation = mode_axes(mode)
        self._model = compile_plant(parameters, self._axis, self._rotation, hinges_outermost)
        first, second = slice(0, 3), slice(3, 6)
        self._slides, self._hinges = (second, first) if hinges_outermost else (first, second)
        self._model.opt.timestep = time_step or stable_step(parameters)
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
        steps = max(1, round(trajectory.time_step / self._model.opt.timestep))
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
