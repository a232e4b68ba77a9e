"""A payload that a gripper takes while a scene runs."""

import mujoco

from models.configuration import RobotPlacement


class TakenLoad:
    """The box in a robot's gripper, which weighs nothing before the gripper takes it.

    Args:
        model: Compiled scene; the box's weight is taken off it at once.
        robot: Robot as placed in the scene, with a payload.
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotPlacement) -> None:
        assert robot.payload is not None
        self._model, self._time = model, robot.payload.taken
        self._body = model.body(f"{robot.name}/payload").id
        self._mass = float(model.body_mass[self._body])
        self._inertia = model.body_inertia[self._body].copy()
        self._held = True
        self.weigh(0.0)

    def weigh(self, time: float) -> None:
        """Let the box weigh what it weighs at a time [s]."""
        held = time >= self._time
        if held == self._held:
            return
        self._held = held
        self._model.body_mass[self._body] = self._mass if held else 0.0
        self._model.body_inertia[self._body] = self._inertia if held else 0.0
        # What MuJoCo derives from masses, at the model's own reference posture.
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))
