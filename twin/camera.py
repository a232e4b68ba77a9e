"""Cameras of a scene: intrinsics, stereo rig, frustum culling and the one off-screen renderer.

A camera frame has x to the right, y down and z forward along the view, as images have it; pixel
centres lie at whole numbers.
"""

import atexit
import dataclasses
import functools
import importlib
import os
from typing import Any, Literal, NamedTuple

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.pinhole import NO_DISTORTION, DistortedPinhole, Pinhole
from twin.robot import ImageChannel, RobotError

_MAX_SAMPLES = 4  # Software rasterisers offer no more.
_HIDDEN_GROUP = 4  # First group of the truth markers, which no camera may show.
_POSITIONS = mujoco.mjtState.mjSTATE_QPOS | (
    mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)
_PLACING = (
    mujoco.mj_kinematics,
    mujoco.mj_comPos,
    mujoco.mj_camlight,
    mujoco.mj_flex,
    mujoco.mj_tendon,
)
"""Stages of MuJoCo that compute the poses of all that is drawn from joint and mocap positions."""


def named_index(model: mujoco.MjModel, kind: Literal["actuator", "camera"], name: str) -> int:
    """Return the index of an element of a scene.

    Args:
        model: Compiled scene.
        kind: Kind of the element.
        name: Name of the element.

    Raises:
        ValueError: If there is no such element.
    """
    count, element = {"actuator": (model.nu, model.actuator), "camera": (model.ncam, model.camera)}[
        kind
    ]
    names = [element(index).name for index in range(count)]
    if name not in names:
        raise ValueError(f"the scene has no {kind} {name!r}; it has: {', '.join(names) or 'none'}")
    return names.index(name)


def camera_model(model: mujoco.MjModel, name: str) -> Pinhole:
    """Return the intrinsics of a scene's camera.

    Args:
        model: Compiled scene.
        name: Name of the camera.

    Raises:
        ValueError: If there is no such camera or it has no sensor size.
    """
    index = named_index(model, "camera", name)
    width, height = (int(n) for n in model.cam_resolution[index])
    size = model.cam_sensorsize[index]
    if not np.all(size > 0.0):
        raise ValueError(f"camera {name!r} has no sensorsize, so its intrinsics are unknown")
    focal_x, focal_y, shift_x, shift_y = model.cam_intrinsic[index].tolist()
    return Pinhole(
        width,
        height,
        focal_x / float(size[0]) * width,
        focal_y / float(size[1]) * height,
        (width - 1) / 2.0 - shift_x / float(size[0]) * width,
        (height - 1) / 2.0 - shift_y / float(size[1]) * height,
    )


def camera_pose(data: mujoco.MjData, camera: int) -> tuple[FloatArray, FloatArray]:
    """Return rotation (3, 3) and translation (3,) [m], camera to world; truth, for tests."""
    flip = np.diag([1.0, -1.0, -1.0])  # MuJoCo's cameras view along -z with y up.
    rotation = np.array(data.cam_xmat[camera], dtype=float).reshape(3, 3) @ flip
    return rotation, np.array(data.cam_xpos[camera], dtype=float)


class Renderer:
    """An off-screen OpenGL context; use the process' own through `renderer`."""

    def __init__(self) -> None:
        """Allocate the options; the context is made for the first image."""
        self._process = os.getpid()
        self._gl: Any = None
        self._context: Any = None
        self._scene: Any = None
        self._model: Any = None
        self._size = (0, 0)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._option.geomgroup[_HIDDEN_GROUP:] = 0
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED

    def render(
        self, model: mujoco.MjModel, data: mujoco.MjData, camera: str, width: int, height: int
    ) -> ImageArray:
        """Return (height, width, 3) uint8, red, green and blue.

        Args:
            model: Compiled scene.
            data: State of the scene, after positions were computed.
            camera: Name of a camera of the scene.
            width: Columns [px].
            height: Rows [px].

        Raises:
            RuntimeError: If no context can be made, or this process was forked off another.
            ValueError: If there is no such camera.
        """
        if os.getpid() != self._process:
            raise RuntimeError("this process was forked after rendering; start it by spawning")
        self._camera.fixedcamid = named_index(model, "camera", camera)
        self._prepare(model, width, height)
        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(
            model, data, self._option, None, self._camera, everything, self._scene
        )
        # What lies outside the view frustum may still throw a shadow or be mirrored into it.
        if not (model.light_castshadow.any() or model.mat_reflectance.any()):
            cull(self._scene, model, data, width / height)
        viewport = mujoco.MjrRect(0, 0, width, height)
        image = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_render(viewport, self._scene, self._context)
        mujoco.mjr_readPixels(image, None, viewport, self._context)
        return image[::-1]

    def _prepare(self, model: mujoco.MjModel, width: int, height: int) -> None:
        """Make the context current, and its textures and buffer those of this scene."""
        if self._gl is None:
            self._gl = _make_gl(width, height)
            # Registered after the driver's own clean-up, so that it runs before.
            atexit.register(self.close)
        # Another library may have made its own context current.
        self._gl.make_current()
        if self._model is model and self._size[0] >= width and self._size[1] >= height:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
            return
        if self._context is not None:
            self._context.free()
        size = (max(width, self._size[0]), max(height, self._size[1]))
        quality, screen = model.vis.quality, model.vis.global_
        quality.offsamples = min(int(quality.offsamples), _MAX_SAMPLES)
        screen.offwidth = max(int(screen.offwidth), size[0])
        screen.offheight = max(int(screen.offheight), size[1])
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 1000)
        self._model, self._size = model, size

    def close(self) -> None:
        """Free the context; a later `render` makes a new one."""
        if self._gl is None or os.getpid() != self._process:
            return
        self._gl.make_current()
        if self._context is not None:
            self._context.free()
        self._gl.free()
        atexit.unregister(self.close)
        self._gl = self._context = self._scene = self._model = None
        self._size = (0, 0)


def _make_gl(width: int, height: int) -> Any:
    """Return an off-screen context of the kind that MUJOCO_GL names, EGL by default."""
    kind = os.environ.get("MUJOCO_GL", "egl").lower()
    try:
        # Imported here because it loads the driver, and by name because without MUJOCO_GL at its
        # own import MuJoCo would offer GLFW, which needs a display.
        module = importlib.import_module("mujoco.egl" if kind == "egl" else "mujoco")
        return module.GLContext(width, height)
    except Exception as error:
        raise RuntimeError(
            f"no off-screen rendering with MUJOCO_GL={kind} ({error}); "
            "install libegl1 and libgl1-mesa-dri for software EGL"
        ) from error


def cull(scene: Any, model: mujoco.MjModel, data: mujoco.MjData, aspect: float) -> None:
    """Remove the geoms that lie wholly outside the view frustum from a scene.

    The driver would discard their faces one by one; the image is the same.

    Args:
        scene: Scene made by `mujoco.mjv_updateScene`; the type of the culled geoms becomes none.
        model: Compiled scene.
        data: State of the scene.
        aspect: Columns over rows of the image, for a camera that is given by its field of view.
    """
    eye = scene.camera[0]
    # MuJoCo has two eyes, the camera's own distance apart; the image is that from between them.
    middle = 0.5 * (np.array(eye.pos, dtype=float) + np.array(scene.camera[1].pos, dtype=float))
    forward, up = np.array(eye.forward, dtype=float), np.array(eye.up, dtype=float)
    to_camera = np.column_stack([np.cross(forward, up), up, forward])
    across, above, ahead = ((data.geom_xpos - middle) @ to_camera).T
    half = eye.frustum_width or 0.5 * aspect * (eye.frustum_top - eye.frustum_bottom)
    radius = model.geom_rbound
    unseen = ahead < -radius
    for offset, low, high in (
        (across, eye.frustum_center - half, eye.frustum_center + half),
        (above, eye.frustum_bottom, eye.frustum_top),
    ):
        # Distances from the two planes through the camera and the image's edges.
        for slope, side in ((low / eye.frustum_near, -1.0), (high / eye.frustum_near, 1.0)):
            unseen |= side * (offset - slope * ahead) > radius * np.hypot(1.0, slope)
    # A plane has no end, and no radius.
    unseen &= radius > 0.0
    nothing, geom = int(mujoco.mjtGeom.mjGEOM_NONE), int(mujoco.mjtObj.mjOBJ_GEOM)
    for drawn in scene.geoms[: scene.ngeom]:
        if drawn.objtype == geom and unseen[drawn.objid]:
            drawn.type = nothing


@functools.cache
def renderer() -> Renderer:
    """Return the process' only renderer; it is closed when the process ends."""
    return Renderer()


@dataclasses.dataclass(frozen=True)
class StereoConfig:
    """Rate, noise and lenses of a stereo pair.

    Attributes:
        rate: Pairs per second [Hz].
        noise_db: Full scale over r.m.s. noise [dB]; None for none.
        distortion: (k1, k2, p1, p2, k3) of both lenses; the corners that a barrel lens would show
            beyond the rendered field stay black.
    """

    rate: float = 4.0
    noise_db: float | None = CAMERA.signal_to_noise_db
    distortion: tuple[float, float, float, float, float] = NO_DISTORTION

    def __post_init__(self) -> None:
        """Refuse a rate that is not positive.

        Raises:
            ValueError: Naming it.
        """
        if not self.rate > 0.0:
            raise ValueError(f"stereo rate must be positive, got {self.rate}")


class StereoState(NamedTuple):
    """Complete state of a `StereoHead`.

    Attributes:
        due: Time of the next pair [s].
        frame: Number of the next pair.
    """

    due: float
    frame: int


class StereoRig:
    """Two cameras that are drawn together.

    Args:
        model: Compiled scene.
        prefix: Prefix of the cameras' names, before stereo_left and stereo_right.
        config: Noise and lenses of the cameras.

    Raises:
        ValueError: If a camera is missing or the two differ in size.
    """

    def __init__(self, model: mujoco.MjModel, prefix: str, config: StereoConfig) -> None:
        self._names = (f"{prefix}stereo_left", f"{prefix}stereo_right")
        lenses = (camera_model(model, name) for name in self._names)
        self.cameras = tuple(DistortedPinhole(*c.intrinsics, config.distortion) for c in lenses)
        if len({(c.width, c.height) for c in self.cameras}) > 1:
            raise ValueError(f"cameras {self._names} differ in size")
        self._model, self._noise_db = model, config.noise_db
        distorted = any(config.distortion)
        self._maps = tuple(_distortion_map(c) if distorted else None for c in self.cameras)

    def capture(
        self, data: mujoco.MjData, noise: tuple[np.random.Generator, np.random.Generator]
    ) -> ImageArray:
        """Return (2, height, width) uint8, left and right, read-only.

        Args:
            data: State of the scene, after positions were computed.
            noise: Random generators for the noise of the left and of the right image; may be one.
        """
        first = self.cameras[0]
        pair = np.empty((2, first.height, first.width), np.uint8)
        for image, name, warp, rng in zip(pair, self._names, self._maps, noise, strict=True):
            colour = renderer().render(self._model, data, name, first.width, first.height)
            grey = cv2.cvtColor(np.ascontiguousarray(colour), cv2.COLOR_RGB2GRAY)
            if warp is not None:
                grey = cv2.remap(grey, warp[0], warp[1], cv2.INTER_LINEAR)
            image[:] = grey
            if self._noise_db is not None:
                sigma = np.float32(255.0 * 10.0 ** (-self._noise_db / 20.0))
                errors = sigma * rng.standard_normal(image.shape, dtype=np.float32)
                image[:] = np.clip(np.rint(image + errors), 0, 255)
        pair.flags.writeable = False
        return pair


class StereoHead:
    """Stereo pairs of one robot of a simulation, drawn when they are read.

    A pair holds the scene's positions at its time. Its noise depends on its number alone: which
    pairs are read, and when, changes no pixel.

    Args:
        model: Compiled scene.
        prefix: Prefix of the robot's names in the scene.
        config: Rate, noise and lenses of the cameras.
        seed: Seed of this head's image noise; each eye and frame has a child of it.

    Attributes:
        state: Complete state; may be set to one that was read before.
        latest: Positions, number and time [s] of the newest pair, for `draw`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        prefix: str,
        config: StereoConfig,
        seed: np.random.SeedSequence,
    ) -> None:
        self._rig = StereoRig(model, prefix, config)
        self._model, self._seed = model, seed
        self._period = 1.0 / config.rate
        self.state = StereoState(0.0, 0)
        self.latest = np.empty(0), 0, 0.0
        self._closed = False

    def poll(self, data: mujoco.MjData, time: float) -> ImageChannel | None:
        """Return a new pair if one is due at `time` [s], else None."""
        due, frame = self.state
        if time < due - 1e-9:
            return None
        self.state = StereoState(max(due + self._period, time), frame + 1)
        positions = np.empty(mujoco.mj_stateSize(self._model, _POSITIONS))
        mujoco.mj_getState(self._model, data, positions, _POSITIONS)
        self.latest = positions, frame, time
        return ImageChannel.deferred(lambda: self.draw(positions, frame, time), time)

    def draw(self, positions: FloatArray, frame: int, time: float) -> ImageArray:
        """Return the pair of a frame at saved positions.

        Raises:
            RobotError: If the simulation is closed.
        """
        if self._closed:
            raise RobotError(
                f"the stereo pair of {time:.3f} s was not read before its simulation was closed"
            )
        data = mujoco.MjData(self._model)
        mujoco.mj_setState(self._model, data, positions, _POSITIONS)
        for compute in _PLACING:
            compute(self._model, data)
        left, right = (
            np.random.SeedSequence(
                self._seed.entropy, spawn_key=(*self._seed.spawn_key, eye, frame)
            )
            for eye in range(2)
        )
        return self._rig.capture(data, (np.random.default_rng(left), np.random.default_rng(right)))

    def close(self) -> None:
        """Refuse from now on to draw pairs that were not read."""
        self._closed = True


def _distortion_map(camera: DistortedPinhole) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return, for each pixel of the lens' image, the column and row of the rendered one."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    straight = cv2.undistortPoints(
        pixels, camera.matrix, np.array(camera.distortion), None, None, camera.matrix
    )
    grid = np.asarray(straight, dtype=np.float32).reshape(camera.height, camera.width, 2)
    return np.ascontiguousarray(grid[..., 0]), np.ascontiguousarray(grid[..., 1])
