"""A scene that a person looks at, drives and pushes, one image at a time."""

import math
from collections.abc import Mapping
from typing import Any, Literal, TypedDict

import mujoco
import numpy as np

from experiments.live.page_server import jpeg
from models.compose import WHEELS

_SIDES = np.array([-1.0 if "left" in wheel else 1.0 for wheel in WHEELS])
_VOLTAGE = 6.0  # Of the motors of a rover that is driven [V].
_LATEST = 0.2  # Time within which a key that is held has to be told again [s].
_ORBIT = 180.0  # Turn of the camera that a drag across the whole image brings [deg].


class SceneTold(TypedDict, total=False):
    """What a page may tell of a person's hands.

    Attributes:
        drive: Ahead and left, -1 to 1.
        press: What is pressed.
        orbit: Right and down, over the image's height; likewise ``shift`` and ``pull``.
        zoom: Logarithm of the distance's growth.
        grab: Right and down, over the image's size.
        release: Told where what was grabbed is let go.
    """

    drive: tuple[float, float]
    press: Literal["pause", "reset", "next"]
    orbit: tuple[float, float]
    shift: tuple[float, float]
    pull: tuple[float, float]
    zoom: float
    grab: tuple[float, float]
    release: bool


class TouchedScene:
    """Physics, camera and hand of a scene.

    Args:
        model: Compiled scene.
        size: Width and height of the images [px].

    Attributes:
        paused: Whether time stands still.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        model.vis.global_.offwidth = max(int(model.vis.global_.offwidth), size[0])
        model.vis.global_.offheight = max(int(model.vis.global_.offheight), size[1])
        self._renderer = mujoco.Renderer(model, size[1], size[0])
        self._aspect = size[0] / size[1]
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._hand = mujoco.MjvPerturb()
        self._robots = [
            name.removesuffix(f"/{WHEELS[0]}")
            for name in (model.actuator(index).name for index in range(model.nu))
            if name.endswith(f"/{WHEELS[0]}")
        ]
        self._driven, self._held, self._told = 0, (0.0, 0.0), -math.inf
        self.paused = False
        self._look()
        self.reset()

    @property
    def time(self) -> float:
        """Time of the scene [s]."""
        return float(self._data.time)

    @property
    def about(self) -> Mapping[str, Any]:
        """What is told beside an image: times [s], and the name and place (2,) [m] of a rover."""
        about = {"time": round(self.time, 2), "paused": self.paused, "robots": len(self._robots)}
        if not self._robots:
            return about
        robot = self._robots[self._driven]
        place = self._data.body(f"{robot}/chassis").xpos[:2]
        return about | {"driven": robot, "place": np.round(place, 3).tolist()}

    def reset(self) -> None:
        """Begin anew, at the first key frame if there is one."""
        if self._model.nkey:
            mujoco.mj_resetDataKeyframe(self._model, self._data, 0)
        else:
            mujoco.mj_resetData(self._model, self._data)
        mujoco.mj_forward(self._model, self._data)

    def take(self, told: Mapping[str, Any], now: float) -> None:
        """Take what a person does.

        Args:
            told: One entry of `SceneTold`, or ``closed``.
            now: Time of the wall clock [s].
        """
        if "drive" in told:
            ahead, left = (min(max(part, -1.0), 1.0) for part in told["drive"])
            self._held, self._told = (ahead, left), now
        elif "press" in told:
            self._press(told["press"])
        elif "grab" in told:
            self._grab(*told["grab"])
        elif "pull" in told:
            self._move_hand(*told["pull"])
        elif "orbit" in told:
            right, down = told["orbit"]
            self._camera.azimuth -= _ORBIT * right
            self._camera.elevation = min(max(self._camera.elevation - _ORBIT * down, -89.0), 89.0)
        elif "shift" in told:
            self._move_camera(mujoco.mjtMouse.mjMOUSE_MOVE_V, *told["shift"])
        elif "zoom" in told:
            self._camera.distance *= math.exp(min(max(told["zoom"], -1.0), 1.0))
        if "release" in told or "closed" in told:
            self._hand.active = self._hand.select = 0
            self._data.xfrc_applied[:] = 0.0
        if "closed" in told:
            self._held = 0.0, 0.0

    def advance(self, seconds: float, now: float) -> None:
        """Let time pass, unless it stands still.

        Args:
            seconds: Time of the scene [s].
            now: Time of the wall clock [s].
        """
        if self.paused:
            return
        self._drive(now)
        for _ in range(max(round(seconds / self._model.opt.timestep), 1)):
            if self._hand.active:
                mujoco.mjv_applyPerturbForce(self._model, self._data, self._hand)
            mujoco.mj_step(self._model, self._data)

    def image(self) -> bytes:
        """Return a JPEG of the scene."""
        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, self._hand, self._camera, everything,
            self._renderer.scene,
        )  # fmt: skip
        return jpeg(self._renderer.render())

    def close(self) -> None:
        """Free what draws."""
        self._renderer.close()

    def _press(self, key: str) -> None:
        if key == "pause":
            self.paused = not self.paused
        elif key == "reset":
            self.reset()
        elif key == "next" and self._robots:
            self._driven = (self._driven + 1) % len(self._robots)
            self._follow()

    def _drive(self, now: float) -> None:
        """Set the voltages of the wheels; all rest that are not driven."""
        if now > self._told + _LATEST:
            self._held = 0.0, 0.0
        ahead, left = self._held
        for index, robot in enumerate(self._robots):
            share = ahead + left * _SIDES if index == self._driven else np.zeros(len(WHEELS))
            share = share / max(1.0, float(np.abs(share).max()))
            for wheel, part in zip(WHEELS, share, strict=True):
                self._data.actuator(f"{robot}/{wheel}").ctrl = _VOLTAGE * part

    def _look(self) -> None:
        """Look at the first rover, or at the middle of the scene."""
        mujoco.mjv_defaultFreeCamera(self._model, self._camera)
        if self._robots:
            self._camera.distance = 1.6
            self._follow()

    def _follow(self) -> None:
        """Let the camera follow the rover that is driven."""
        body = self._model.body(f"{self._robots[self._driven]}/chassis").id
        self._camera.type, self._camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, body

    def _grab(self, right: float, down: float) -> None:
        """Take hold of the body that an image point shows."""
        place = np.zeros(3)
        geom, flex, skin = (np.zeros(1, np.int32) for _ in range(3))
        body = mujoco.mjv_select(
            self._model, self._data, self._option, self._aspect, right, 1.0 - down,
            self._renderer.scene, place, geom, flex, skin,
        )  # fmt: skip
        if body <= 0 or not self._model.body_weldid[body]:
            return
        self._hand.select = body
        rotation = self._data.xmat[body].reshape(3, 3)
        self._hand.localpos = rotation.T @ (place - self._data.xpos[body])
        mujoco.mjv_initPerturb(self._model, self._data, self._renderer.scene, self._hand)
        self._hand.active = int(mujoco.mjtPertBit.mjPERT_TRANSLATE)

    def _move_hand(self, right: float, down: float) -> None:
        if self._hand.active:
            mujoco.mjv_movePerturb(
                self._model, self._data, mujoco.mjtMouse.mjMOUSE_MOVE_V, right, down,
                self._renderer.scene, self._hand,
            )  # fmt: skip

    def _move_camera(self, how: mujoco.mjtMouse, right: float, down: float) -> None:
        if self._camera.type == mujoco.mjtCamera.mjCAMERA_TRACKING:
            self._camera.lookat = self._data.xpos[self._camera.trackbodyid]
            self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        mujoco.mjv_moveCamera(self._model, how, right, down, self._camera)
