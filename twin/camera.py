"""Cameras of a scene: intrinsics, stereo rig, frustum culling and the one off-screen renderer.

A camera frame has x to the right, y down and z forward along the view, as images have it; pixel
centres lie at whole numbers.
"""

import atexit
import dataclasses
import functools
import importlib
import math
import os
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from models.datasheets import CAMERA
from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.pinhole import NO_DISTORTION, DistortedPinhole, Pinhole
from twin.optics.blur import FloatImage
from twin.optics.flow import Surfaces, View, block_lens, image_flow
from twin.optics.formation import ImageFormation
from twin.optics.realism import IDEAL_CAMERA, CameraRealism, MadeHead
from twin.robot import ImageChannel, RobotError

_SLACK = 1e-9  # [s]
_LOW_SUN = -0.05  # Downward part of the light of a sun whose shadows have no end.
_MAKING = 2  # Child of a head's seed, beside those of its two eyes.
_MAX_SAMPLES = 4  # Software rasterisers offer no more.
_HIDDEN_GROUP = 4  # First group of the truth markers, which no camera may show.
_MOVING = (
    mujoco.mjtState.mjSTATE_QPOS
    | mujoco.mjtState.mjSTATE_QVEL
    | mujoco.mjtState.mjSTATE_MOCAP_POS
    | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)
_PLACING = (
    mujoco.mj_kinematics,
    mujoco.mj_comPos,
    mujoco.mj_camlight,
    mujoco.mj_flex,
    mujoco.mj_tendon,
    mujoco.mj_comVel,
)
"""Stages of MuJoCo that compute poses and velocities of all that is drawn, from the joints' and the
mocap positions; mocap bodies have no velocity."""


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
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = named_index(model, "camera", camera)
        self._prepare(model, width, height)
        self._update(model, data, width / height)
        return self._colours(width, height)

    def render_view(
        self, model: mujoco.MjModel, data: mujoco.MjData, view: View
    ) -> tuple[ImageArray, Surfaces]:
        """Return (height, width, 3) uint8, and what stands at each of its blocks.

        Args:
            model: Compiled scene.
            data: State of the scene, after positions were computed.
            view: Camera that sees it, anywhere.

        Raises:
            RuntimeError: If no context can be made, or this process was forked off another.
        """
        lens = view.lens
        self._prepare(model, lens.width, lens.height)
        self._camera.type = mujoco.mjtCamera.mjCAMERA_USER
        _aim(self._scene, model, view)
        self._update(model, data, lens.width / lens.height)
        image = self._colours(lens.width, lens.height)
        # The blocks at the right and at the bottom reach beyond the image.
        blocks = View(block_lens(lens), view.pose)
        _aim(self._scene, model, blocks)
        return image, self._surfaces(model, blocks.lens.width, blocks.lens.height)

    def _update(self, model: mujoco.MjModel, data: mujoco.MjData, aspect: float) -> None:
        """List what is to be drawn."""
        everything = int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(
            model, data, self._option, None, self._camera, everything, self._scene
        )
        # What lies outside the view frustum may still throw a shadow or be mirrored into it.
        shadows = None if model.mat_reflectance.any() else shadow_reach(model, data)
        if shadows is not None:
            cull(self._scene, model, data, aspect, shadows)

    def _colours(self, width: int, height: int) -> ImageArray:
        """Draw the scene (height, width, 3) uint8."""
        viewport = mujoco.MjrRect(0, 0, width, height)
        image = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_render(viewport, self._scene, self._context)
        mujoco.mjr_readPixels(image, None, viewport, self._context)
        return image[::-1]

    def _surfaces(self, model: mujoco.MjModel, width: int, height: int) -> Surfaces:
        """Draw depths and bodies in place of colours."""
        flags, segment = self._scene.flags, mujoco.mjtRndFlag.mjRND_SEGMENT
        kept = flags.copy()
        flags[segment] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        viewport = mujoco.MjrRect(0, 0, width, height)
        colours, depths = np.empty((height, width, 3), np.uint8), np.empty((height, width), "f4")
        mujoco.mjr_render(viewport, self._scene, self._context)
        mujoco.mjr_readPixels(colours, depths, viewport, self._context)
        flags[:] = kept
        numbers = colours[::-1].astype(np.int64) @ [1, 1 << 8, 1 << 16]
        bodies = np.zeros(int(numbers.max()) + 1, dtype=np.int64)
        for number in np.unique(numbers[numbers > 0]).tolist():
            drawn = self._scene.geoms[number - 1]
            if drawn.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                bodies[number] = model.geom_bodyid[drawn.objid]
        near, far = model.stat.extent * model.vis.map.znear, model.stat.extent * model.vis.map.zfar
        # The buffer goes from 0 at the far to 1 at the near plane, straight in the inverse depth.
        closeness = depths[::-1].astype(float) * (1.0 / near - 1.0 / far) + 1.0 / far
        return Surfaces(np.where(numbers > 0, closeness, 0.0), bodies[numbers])

    def _prepare(self, model: mujoco.MjModel, width: int, height: int) -> None:
        """Make the context current, and its textures and buffer those of this scene."""
        if os.getpid() != self._process:
            raise RuntimeError("this process was forked after rendering; start it by spawning")
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
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
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
    # Threads of Mesa's rasteriser cost a quarter more processor time and save hardly any time.
    os.environ.setdefault("LP_NUM_THREADS", "0")
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


def _aim(scene: Any, model: mujoco.MjModel, view: View) -> None:
    """Give a scene a camera in place of one of the model's."""
    lens, pose = view
    rotation = pose.rotation.as_matrix()
    near = float(model.stat.extent * model.vis.map.znear)
    for eye in scene.camera:  # MuJoCo has two, for a left and a right image; they shall be one.
        eye.pos, eye.forward, eye.up = pose.translation, rotation[:, 2], -rotation[:, 1]
        eye.orthographic = 0
        eye.frustum_near, eye.frustum_far = near, float(model.stat.extent * model.vis.map.zfar)
        eye.frustum_width = 0.5 * near * lens.width / lens.fx
        eye.frustum_center = near * (0.5 * (lens.width - 1) - lens.cx) / lens.fx
        eye.frustum_top = near * (lens.cy + 0.5) / lens.fy
        eye.frustum_bottom = near * (lens.cy + 0.5 - lens.height) / lens.fy


def shadow_reach(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray | None:
    """Return the way from each geom to the end of its shadow, for each light that casts any.

    Args:
        model: Compiled scene.
        data: State of the scene.

    Returns:
        (lights, geoms, 3) [m], world; None where shadows may reach anywhere, as by lamps and low
        suns, and over ground that is not level.
    """
    casting = np.flatnonzero(model.light_castshadow & model.light_active)
    towards = np.asarray(data.light_xdir[casting], dtype=float)
    if not len(casting):
        return np.empty((0, model.ngeom, 3))
    suns = model.light_type[casting] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    upward = np.reshape(data.geom_xmat, (-1, 3, 3))[:, 2]
    level = np.all(upward[planes, 2] > 1.0 - 1e-9)
    if not (suns.all() and level and towards[:, 2].max() < _LOW_SUN) or model.nflex or model.nskin:
        return None
    height: FloatArray = np.asarray(data.geom_xpos[:, 2], dtype=float)
    middle, half = np.hsplit(np.asarray(model.geom_aabb, dtype=float), 2)
    bottom = height + np.sum(upward * middle - np.abs(upward) * half, axis=1)
    fall = height + np.asarray(model.geom_rbound) - np.min(np.where(planes, height, bottom))
    return fall[:, None] * (towards / -towards[:, 2:])[:, None]


def cull(
    scene: Any, model: mujoco.MjModel, data: mujoco.MjData, aspect: float, shadows: FloatArray
) -> None:
    """Remove the geoms that lie with their shadows wholly outside the view frustum from a scene.

    The driver would discard their faces one by one; the image is the same.

    Args:
        scene: Scene made by `mujoco.mjv_updateScene`; the type of the culled geoms becomes none.
        model: Compiled scene.
        data: State of the scene.
        aspect: Columns over rows of the image, for a camera that is given by its field of view.
        shadows: Ways from the geoms to the ends of their shadows, see `shadow_reach`.
    """
    eye = scene.camera[0]
    # MuJoCo has two eyes, the camera's own distance apart; the image is that from between them.
    middle = 0.5 * (np.array(eye.pos, dtype=float) + np.array(scene.camera[1].pos, dtype=float))
    forward, up = np.array(eye.forward, dtype=float), np.array(eye.up, dtype=float)
    to_camera = np.column_stack([np.cross(forward, up), up, forward])
    # A geom, swept along a straight line, is beyond a plane if it is so at both ends.
    ends = np.concatenate([[data.geom_xpos], data.geom_xpos + shadows])
    across, above, ahead = np.moveaxis((ends - middle) @ to_camera, -1, 0)
    half = eye.frustum_width or 0.5 * aspect * (eye.frustum_top - eye.frustum_bottom)
    radius = model.geom_rbound
    unseen = np.all(ahead < -radius, axis=0)
    for offset, low, high in (
        (across, eye.frustum_center - half, eye.frustum_center + half),
        (above, eye.frustum_bottom, eye.frustum_top),
    ):
        # Distances from the two planes through the camera and the image's edges.
        for slope, side in ((low / eye.frustum_near, -1.0), (high / eye.frustum_near, 1.0)):
            beyond = side * (offset - slope * ahead) > radius * np.hypot(1.0, slope)
            unseen |= np.all(beyond, axis=0)
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
    """Rate, noise, lenses and realism of a stereo pair.

    Attributes:
        rate: Pairs per second [Hz].
        noise_db: Full scale over r.m.s. noise [dB]; None for none.
        distortion: (k1, k2, p1, p2, k3) of both lenses; the corners that a barrel lens would show
            beyond the rendered field stay black.
        realism: Light, lenses and mounting of the head as made.
    """

    rate: float = 4.0
    noise_db: float | None = CAMERA.signal_to_noise_db
    distortion: tuple[float, float, float, float, float] = NO_DISTORTION
    realism: CameraRealism = IDEAL_CAMERA

    def __post_init__(self) -> None:
        """Refuse a rate that is not positive.

        Raises:
            ValueError: Naming it.
        """
        if not self.rate > 0.0:
            raise ValueError(f"stereo rate must be positive, got {self.rate}")


class TakenPair(NamedTuple):
    """A pair that was exposed, and can be drawn.

    Attributes:
        moving: Positions and velocities of the scene.
        frame: Number of the pair.
        time: Middle of the exposure [s].
    """

    moving: FloatArray
    frame: int
    time: float


class StereoState(NamedTuple):
    """Complete state of a `StereoHead`.

    Attributes:
        due: Time of the next pair [s].
        frame: Number of the next pair.
        waiting: Pairs that were exposed and have not arrived.
    """

    due: float
    frame: int
    waiting: tuple[TakenPair, ...] = ()


class StereoRig:
    """Two cameras that are drawn together.

    Args:
        model: Compiled scene.
        prefix: Prefix of the cameras' names, before stereo_left and stereo_right.
        config: Noise, lenses and realism of the cameras.
        seed: Seed of the errors of this rig as made; not needed for an ideal one.

    Attributes:
        cameras: Intrinsics of the left and the right camera as made.

    Raises:
        ValueError: If a camera is missing, the two differ in size, or the seed is missing.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        prefix: str,
        config: StereoConfig,
        seed: np.random.SeedSequence | None = None,
    ) -> None:
        self._names = (f"{prefix}stereo_left", f"{prefix}stereo_right")
        lenses = [camera_model(model, name) for name in self._names]
        self._eyes = [named_index(model, "camera", name) for name in self._names]
        self._made = None
        if config.realism != IDEAL_CAMERA:
            if seed is None:
                raise ValueError(f"cameras {self._names} have errors; give a seed to draw them")
            made = self._made = MadeHead.draw(config.realism, np.random.default_rng(seed))
            lenses = [made.lens(lens) for lens in lenses]
            self._formations = [ImageFormation(lens, config.realism, made.gain) for lens in lenses]
        self.cameras = tuple(DistortedPinhole(*c.intrinsics, config.distortion) for c in lenses)
        if len({(c.width, c.height) for c in self.cameras}) > 1:
            raise ValueError(f"cameras {self._names} differ in size")
        self._model, self._noise_db = model, config.noise_db
        distorted = any(config.distortion)
        self._maps = tuple(_distortion_map(c) if distorted else None for c in self.cameras)

    def poses(self, data: mujoco.MjData) -> tuple[RigidTransform, RigidTransform]:
        """Return the poses of the left and the right camera as made, camera to world; truth."""
        left, right = (
            RigidTransform.from_components(place, Rotation.from_matrix(rotation))
            for rotation, place in (camera_pose(data, eye) for eye in self._eyes)
        )
        return (left, right) if self._made is None else self._made.poses((left, right))

    def capture(
        self, data: mujoco.MjData, noise: tuple[np.random.Generator, np.random.Generator]
    ) -> ImageArray:
        """Return (2, height, width) uint8, left and right, read-only.

        Args:
            data: State of the scene, after positions and, for motion blur, velocities were
                computed.
            noise: Random generators for the noise of the left and of the right image; may be one.
        """
        first = self.cameras[0]
        pair = np.empty((2, first.height, first.width), np.uint8)
        lights = self._drawn(data) if self._made is None else self._formed(data)
        for seen, image, warp, rng in zip(lights, pair, self._maps, noise, strict=True):
            bent = seen if warp is None else cv2.remap(seen, warp[0], warp[1], cv2.INTER_LINEAR)
            grey = np.asarray(bent, dtype=np.float32)
            if self._noise_db is not None:
                sigma = np.float32(255.0 * 10.0 ** (-self._noise_db / 20.0))
                grey = grey + sigma * rng.standard_normal(image.shape, dtype=np.float32)
            image[:] = np.clip(np.rint(grey), 0, 255)
        pair.flags.writeable = False
        return pair

    def _drawn(self, data: mujoco.MjData) -> Iterator[ImageArray | FloatImage]:
        """Yield what each eye sees (height, width) as drawn, but for its lens' distortion."""
        size = self.cameras[0].width, self.cameras[0].height
        for name in self._names:
            yield _grey(renderer().render(self._model, data, name, *size))

    def _formed(self, data: mujoco.MjData) -> Iterator[ImageArray | FloatImage]:
        """Yield what each eye sees (height, width) as made, but for its lens' distortion."""
        twists = _twists(self._model, data)
        bodies = self._model.cam_bodyid[self._eyes].tolist()
        for lens, pose, body, formation in zip(
            self.cameras, self.poses(data), bodies, self._formations, strict=True
        ):
            view = View(Pinhole(*lens.intrinsics), pose)
            colours, surfaces = renderer().render_view(self._model, data, view)
            yield formation.form(_grey(colours), surfaces, image_flow(view, surfaces, body, twists))


class StereoHead:
    """Stereo pairs of one robot of a simulation, drawn when they are read.

    A pair holds the scene's positions and velocities at its time. Its noise depends on its number
    alone: which pairs are read, and when, changes no pixel. Cameras with latency ran before the
    simulation began, when the scene stood as it does then: so the first pair is there at once.

    Args:
        model: Compiled scene.
        prefix: Prefix of the robot's names in the scene.
        config: Rate, noise, lenses and realism of the cameras.
        seed: Seed of this head: each eye and frame has a child of it for its noise, and the head
            as made has one.

    Attributes:
        state: Complete state; may be set to one that was read before.
        latest: The newest pair that has arrived, for `draw`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        prefix: str,
        config: StereoConfig,
        seed: np.random.SeedSequence,
    ) -> None:
        self._model, self._seed = model, seed
        self._rig = StereoRig(model, prefix, config, self._child(_MAKING))
        self._period, self._latency = 1.0 / config.rate, config.realism.latency
        self.state = StereoState(0.0, 0)
        self.latest = TakenPair(np.empty(0), 0, 0.0)
        self._closed = False

    def poll(self, data: mujoco.MjData, time: float) -> ImageChannel | None:
        """Expose a pair if one is due at `time` [s]; return the one that arrives, or None."""
        due, frame, waiting = self.state
        if time >= due - _SLACK:
            times = [time]
            if frame == 0:
                under_way = math.floor(self._latency / self._period + _SLACK)
                times = [time - self._latency + k * self._period for k in range(under_way + 1)]
                due = times[-1]
            moving = np.empty(mujoco.mj_stateSize(self._model, _MOVING))
            mujoco.mj_getState(self._model, data, moving, _MOVING)
            taken = (TakenPair(moving, frame + k, each) for k, each in enumerate(times))
            waiting = (*waiting, *taken)
            due, frame = max(due + self._period, times[-1]), frame + len(times)
        arrived = [pair for pair in waiting if time >= pair.time + self._latency - _SLACK]
        self.state = StereoState(due, frame, waiting[len(arrived) :])
        if not arrived:
            return None
        newest = self.latest = arrived[-1]
        return ImageChannel.deferred(lambda: self.draw(newest), newest.time)

    def draw(self, taken: TakenPair) -> ImageArray:
        """Return a pair (2, height, width) uint8.

        Args:
            taken: Pair that was exposed.

        Raises:
            RobotError: If the simulation is closed.
        """
        if self._closed:
            raise RobotError(
                f"the stereo pair of {taken.time:.3f} s was not read before its simulation was "
                "closed"
            )
        data = mujoco.MjData(self._model)
        mujoco.mj_setState(self._model, data, taken.moving, _MOVING)
        for compute in _PLACING:
            compute(self._model, data)
        left, right = (np.random.default_rng(self._child(eye, taken.frame)) for eye in range(2))
        return self._rig.capture(data, (left, right))

    def poses(self, data: mujoco.MjData) -> tuple[RigidTransform, RigidTransform]:
        """Return the poses of the left and the right camera as made, camera to world; truth."""
        return self._rig.poses(data)

    def _child(self, *key: int) -> np.random.SeedSequence:
        """Return a child of the head's seed."""
        return np.random.SeedSequence(self._seed.entropy, spawn_key=(*self._seed.spawn_key, *key))

    def close(self) -> None:
        """Refuse from now on to draw pairs that were not read."""
        self._closed = True


def _grey(colours: ImageArray) -> ImageArray:
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(colours), cv2.COLOR_RGB2GRAY), np.uint8)


def _twists(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return (bodies, 6) the bodies' angular and linear velocities at the world's origin."""
    twists = np.array(data.cvel, dtype=float)
    # MuJoCo has them at the centre of mass of the whole tree that a body belongs to.
    twists[:, 3:] += np.cross(data.subtree_com[model.body_rootid], twists[:, :3])
    return twists


def _distortion_map(camera: DistortedPinhole) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return, for each pixel of the lens' image, the column and row of the rendered one."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    straight = cv2.undistortPoints(
        pixels, camera.matrix, np.array(camera.distortion), None, None, camera.matrix
    )
    grid = np.asarray(straight, dtype=np.float32).reshape(camera.height, camera.width, 2)
    return np.ascontiguousarray(grid[..., 0]), np.ascontiguousarray(grid[..., 1])
