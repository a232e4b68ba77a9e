"""Recordings for the rerun viewer: bodies, sensors, commands, images and estimates.

Everything goes to a file, in columns of half a second, so that recording costs little and an
interrupted run loses hardly more, unless told otherwise. They are written a few in each tick, so
that none takes long.
``python -m twin.recording.record screenshot RUN.rrd OUT.png`` makes a picture of one.
"""

import atexit
import contextlib
import ctypes
import errno
import socket
import sys
import time
import types
from collections.abc import Generator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import cv2
import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import tyro
from rerun.experimental import ViewerClient

from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.files import RECORDING, check_size
from twin.description import RobotDescription
from twin.loop import LoopRecorder, Tick
from twin.recording.layout import default_blueprint
from twin.recording.scene_mesh import body_mesh
from twin.robot import Channel, ImageChannel, Robot, Validity
from twin.sensors import CHANNELS

_XYZ = ("x", "y", "z")
_COMPONENTS: Mapping[str, Sequence[str]] = {
    "centre_angle": ("centre",),
    "inclinometer": ("pitch", "roll"),
    "arm_base_wrench": tuple(f"force {a}" for a in _XYZ) + tuple(f"moment {a}" for a in _XYZ),
    "accelerometer": _XYZ,
    "gyro": _XYZ,
    "heading": ("yaw",),
}
_ADVICE = (
    "the viewer needs a graphics driver; on Debian and Ubuntu install mesa-vulkan-drivers "
    "for the software one"
)
_PNG_END = b"IEND\xaeB`\x82"  # Chunk that ends every PNG file.
_BODY_RATE = 25.0  # Poses of bodies per second [Hz].
_AT_ONCE = 4  # Entities whose columns are written in a tick.
_IMAGE_RATE = 4.0  # Stereo pairs per second, at most [Hz].
_JPEG = [int(cv2.IMWRITE_JPEG_QUALITY), 60]
_LONGEST_FLUSH = 30.0  # Wall time [s].
_BEGINNING = 2**20  # More than the layout and the meshes of a scene take [byte].
_SLACK = 1e-9
_POINT = 0.003  # Radius of a point in space [m].
_MARK = (230, 60, 40)
_Sample = tuple[int, float, FloatArray]  # Step, time [s] and values.


class RecordedScene(Protocol):
    """A simulated scene that a recorder reads.

    Attributes:
        model: Compiled model of the scene.
        data: State of the scene.
    """

    model: mujoco.MjModel
    data: mujoco.MjData


class Recorder(LoopRecorder):
    """Writes a run to a file; an argument of `twin.loop.run`.

    Controllers and experiments add their own curves by `log_scalars` and `log_band`.
    """

    def __init__(
        self,
        path: Path | str,
        robots: Mapping[str, Robot] = types.MappingProxyType({}),
        simulation: RecordedScene | None = None,
        blueprint: rrb.Blueprint | None = None,
        draws: bool = True,
        period: float = 0.5,
    ) -> None:
        """Open the file and write the static entities.

        Args:
            path: File to write, ``.rrd``; folders are made.
            robots: Robots that are recorded, by name.
            simulation: Scene whose bodies are recorded; None for real robots.
            blueprint: Layout of the viewer; None for `default_blueprint`.
            draws: Whether stereo pairs are drawn for the recording that no controller has read.
            period: Robot time between writes [s]; longer ones take less room.

        Raises:
            OSError: If the file cannot be written.
        """
        self._draws, self._period = draws, period
        self.path = Path(path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = rr.RecordingStream("fieldtwin")
        layout = blueprint or default_blueprint(list(robots))
        _check_room(self.path)
        with self._writing():
            self._stream.save(self.path, default_blueprint=layout)
        # Samples of each curve that are not written yet, and those that are to be written next.
        self._curves: dict[str, list[_Sample]] = {}
        self._due: list[tuple[str, list[_Sample]]] = []
        self._widths: dict[str, int] = {}
        self._step, self._time = 0, 0.0
        self._next_flush = self._next_bodies = -np.inf
        self._next_image: dict[str, float] = {}
        self._seen: dict[str, float] = {}
        self._components = {
            f"{name}/{channel}": components
            for name, robot in robots.items()
            for channel, components in _components(robot.description).items()
        }
        self._moving: dict[str, tuple[FloatArray, FloatArray]] = {}
        if simulation is not None:
            self._moving = log_meshes(self._stream, simulation.model, simulation.data)

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def record(self, tick: Tick) -> None:
        """Record one servo tick; channels without a new sample are left out."""
        self._step, self._time = tick.step, tick.time
        for name, observation in tick.observations.items():
            for channel in CHANNELS:
                self._take_channel(name, channel, getattr(observation, channel))
            if observation.stereo.validity is not Validity.MISSING:
                self._take_stereo(name, observation.stereo)
        for name, command in tick.applied.items():
            self._take_row(f"{name}/duty/wheels", command.wheels)
            self._take_row(f"{name}/duty/arm", command.arm)
        if tick.time >= self._next_bodies - _SLACK:
            self._next_bodies = tick.time + 1.0 / _BODY_RATE
            for path, pose in self._moving.items():
                self._append(path, np.concatenate(pose))
        if tick.time >= self._next_flush - _SLACK:
            self._next_flush = tick.time + self._period
            self._end_columns()
        self._write(_AT_ONCE)

    def log_scalars(
        self, path: str, values: float | Iterable[float], names: Sequence[str] = ()
    ) -> None:
        """Add a sample to the curves of an entity, at the latest tick's time.

        Args:
            path: Entity, such as ``estimates/mass``.
            values: One number for each curve, always as many.
            names: Names of the curves in the legend.

        Raises:
            ValueError: If the number of values changes.
        """
        self._append(path, values, names)

    def log_band(
        self,
        path: str,
        mean: float | Iterable[float],
        low: float | Iterable[float],
        high: float | Iterable[float],
        names: Sequence[str] = (),
    ) -> None:
        """Add a sample with its interval; the bounds are thin curves beside the mean.

        Args:
            path: Entity; the curves are ``path/mean``, ``path/low`` and ``path/high``.
            mean: One number for each curve.
            low: Lower bounds.
            high: Upper bounds.
            names: Names of the curves in the legend.

        Raises:
            ValueError: If the number of values changes.
        """
        for part, values, width in (("mean", mean, 2.0), ("low", low, 0.7), ("high", high, 0.7)):
            row = np.atleast_1d(np.asarray(values, dtype=float))
            labels = [f"{n} {part}" for n in names] or [f"{path} {part}"] * row.size
            self._append(f"{path}/{part}", row, labels, width)

    def log_text(self, path: str, text: str) -> None:
        """Add a line to a log, at the latest tick's time."""
        self._stream.send_columns(path, self._now(), rr.TextLog.columns(text=[text]))

    def log_image(self, path: str, image: ImageArray) -> None:
        """Add an image, compressed, at the latest tick's time.

        Args:
            path: Entity, such as ``camera``.
            image: (height, width) grey levels, or (height, width, 3) blue, green and red.
        """
        _, data = cv2.imencode(".jpg", image, _JPEG)
        packed = rr.EncodedImage.columns(blob=[data.tobytes()], media_type=["image/jpeg"])
        self._stream.send_columns(path, self._now(), packed)

    def log_marks(self, path: str, pixels: FloatArray, radius: float = 6.0) -> None:
        """Mark pixels of an image, at the latest tick's time; they replace older marks.

        Args:
            path: Entity below the image's, such as ``rover1/stereo/left/markers``.
            pixels: (N, 2) column and row [px].
            radius: Radius of the marks [px].
        """
        marks = np.asarray(pixels, dtype=float).reshape(-1, 2)
        columns = rr.Points2D.columns(
            positions=marks,
            colors=[_MARK] * len(marks),
            radii=[radius] * len(marks),
        ).partition([len(marks)])
        self._stream.send_columns(path, self._now(), columns)

    def log_points(self, path: str, points: FloatArray, shades: FloatArray) -> None:
        """Show points in space, at the latest tick's time; they replace older ones.

        Args:
            path: Entity, such as ``map``.
            points: (N, 3) [m], in the entity's frame.
            shades: (N,) from 0, dark, to 1, bright.
        """
        grey = np.rint(60.0 + 180.0 * np.clip(shades, 0.0, 1.0)).astype(np.uint8)
        columns = rr.Points3D.columns(
            positions=points.astype(np.float32),
            colors=np.repeat(grey[:, None], 3, axis=1),
            radii=[_POINT] * len(points),
        ).partition([len(points)])
        self._stream.send_columns(path, self._now(), columns)

    def log_line(self, path: str, points: FloatArray) -> None:
        """Show a line in space, at the latest tick's time; it replaces an older one.

        Args:
            path: Entity, such as ``map/path``.
            points: (N, 3) [m], in the entity's frame; none for no line.
        """
        strips = [points.astype(np.float32)] if len(points) else []
        columns = rr.LineStrips3D.columns(
            strips=strips, colors=[_MARK] * len(strips), radii=[3.0 * _POINT] * len(strips)
        ).partition([len(strips)])
        self._stream.send_columns(path, self._now(), columns)

    def flush(self) -> None:
        """Write everything recorded so far to the file.

        Raises:
            OSError: If it cannot be written, as on a full disk; then what came since is lost.
        """
        with self._writing():
            self._end_columns()
            self._write(len(self._due))
            self._stream.flush(timeout_sec=_LONGEST_FLUSH)

    def close(self) -> None:
        """Write the rest and close the file.

        Raises:
            OSError: As `flush`.
        """
        self.flush()
        self._stream.disconnect()

    @contextlib.contextmanager
    def _writing(self) -> Generator[None]:
        """Name the file in errors of the SDK, which have no type of their own."""
        try:
            yield
        except RuntimeError as error:
            # The SDK would wait for ever for what it cannot write: neither is the stream to be
            # collected, nor the program to wait for it at its end.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._stream))
            atexit.unregister(rr.rerun_shutdown)
            reason = f"the recording cannot be written ({error})"
            raise OSError(errno.EIO, reason, str(self.path)) from None

    def _append(
        self,
        path: str,
        values: float | Iterable[float],
        names: Sequence[str] = (),
        width: float | None = None,
    ) -> None:
        """Add a sample to an entity; the first one sets the curves' names and line width."""
        row = np.atleast_1d(np.asarray(values, dtype=float))
        if path not in self._widths:
            self._widths[path] = row.size
            if names:
                widths = None if width is None else [width] * row.size
                style = rr.SeriesLines(names=list(names), widths=widths)
                self._stream.log(path, style, static=True)
        if row.size != self._widths[path]:
            raise ValueError(f"curve {path!r} has {self._widths[path]} values, got {row.size}")
        self._curves.setdefault(path, []).append((self._step, self._time, row))

    def _take_channel(self, robot: str, name: str, channel: Channel) -> None:
        path = f"{robot}/sensors/{name}"
        if channel.validity is Validity.MISSING or self._seen.get(path) == channel.stamp:
            return
        self._seen[path] = channel.stamp
        self._take_row(path, channel.value.astype(float))

    def _take_row(self, path: str, values: FloatArray) -> None:
        if values.size:  # a robot without an arm has no curves of one
            self.log_scalars(path, values, self._components.get(path, ()))

    def _take_stereo(self, robot: str, stereo: Channel) -> None:
        if not self._draws and isinstance(stereo, ImageChannel) and not stereo.drawn:
            return
        early = self._time < self._next_image.get(robot, -np.inf) - _SLACK
        if early or self._seen.get(f"{robot}/stereo") == stereo.stamp:
            return
        self._seen[f"{robot}/stereo"] = stereo.stamp
        self._next_image[robot] = self._time + 1.0 / _IMAGE_RATE
        for side, image in zip(("left", "right"), stereo.value):
            self.log_image(f"{robot}/stereo/{side}", np.asarray(image, dtype=np.uint8))

    def _end_columns(self) -> None:
        """Begin new columns; those until now are due."""
        self._write(len(self._due))
        self._due, self._curves = list(self._curves.items()), {}

    def _write(self, count: int) -> None:
        """Write some of the columns that are due."""
        for path, samples in self._due[:count]:
            steps, times, values = zip(*samples, strict=True)
            index = [
                rr.TimeColumn("sim_time", duration=times),
                rr.TimeColumn("step", sequence=steps),
            ]
            rows = np.array(values)
            if path in self._moving:
                columns = rr.Transform3D.columns(
                    translation=rows[:, :3], quaternion=np.roll(rows[:, 3:], -1, axis=1)
                )
            else:
                columns = rr.Scalars.columns(scalars=rows.ravel())
                columns = columns.partition([rows.shape[1]] * len(rows))
            self._stream.send_columns(path, index, columns)
        del self._due[:count]

    def _now(self) -> list[rr.TimeColumn]:
        # The SDK's own `log` would add wall-clock timelines; a run has its own time only.
        return [
            rr.TimeColumn("sim_time", duration=[self._time]),
            rr.TimeColumn("step", sequence=[self._step]),
        ]


def _check_room(path: Path) -> None:
    """Refuse a full disk: the SDK waits for ever if it fills up while a file is begun.

    Raises:
        OSError: If the beginning of a recording cannot be written.
    """
    try:
        with path.open("wb") as stream:
            stream.write(bytes(_BEGINNING))
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _components(robot: RobotDescription) -> dict[str, Sequence[str]]:
    """Return the names of the values of each curve of a robot, by entity below the robot."""
    wheels, joints = robot.wheel_names, robot.joint_names
    named = {"wheel_speeds": wheels, "arm_angles": joints, "arm_rates": joints, **_COMPONENTS}
    sensors = {f"sensors/{channel}": names for channel, names in named.items()}
    return {**sensors, "duty/wheels": wheels, "duty/arm": joints}


def log_meshes(
    stream: rr.RecordingStream, model: mujoco.MjModel, data: mujoco.MjData
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Log each body's mesh once, and the pose of those that never move.

    Args:
        stream: Recording.
        model: Compiled scene.
        data: State of the scene.

    Returns:
        Position (3,) [m] and quaternion (4,), scalar first, of the bodies that move, by entity
        path: views of the state.
    """
    moving: dict[str, tuple[FloatArray, FloatArray]] = {}
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for body in range(model.nbody):
        shown = body_mesh(model, body)
        if shown is None:
            continue
        mesh, colours = shown
        path = f"world/{model.body(body).name or f'body_{body}'}"
        shape = rr.Mesh3D(
            vertex_positions=mesh.vertices,
            triangle_indices=mesh.faces,
            vertex_normals=mesh.vertex_normals,
            vertex_colors=colours,
            albedo_factor=[255, 255, 255, int(colours[:, 3].min())],
        )
        stream.log(path, shape, static=True)
        pose = data.xpos[body], data.xquat[body]
        if int(model.body_weldid[body]) != 0:
            moving[path] = pose
        else:
            xyzw = rr.Quaternion(xyzw=np.roll(data.xquat[body], -1))
            place = rr.Transform3D(translation=data.xpos[body], quaternion=xyzw)
            stream.log(path, place, static=True)
    return moving


def screenshot(run: Path, out: Path, at: float | None = None, patience: float = 60.0) -> None:
    """Open a recording in a headless viewer and save what it shows.

    Args:
        run: Recording, ``.rrd``.
        out: Picture to write, ``.png``.
        at: Time on ``sim_time`` to show [s]; None for the end.
        patience: Wall time after which to give up [s].

    Raises:
        OSError: If there is no such recording, it is larger than the viewer should load, or the
            picture cannot be written.
        RuntimeError: If the viewer cannot start or show it.
    """
    if not run.is_file():
        raise FileNotFoundError(f"no recording {run}")
    check_size(run, RECORDING)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.unlink(missing_ok=True)
    deadline = time.monotonic() + patience
    try:
        # The viewer of this Python environment need not be on the path.
        beside = Path(sys.executable).parent / "rerun"
        executable = str(beside) if beside.is_file() else None
        with ViewerClient.spawn(
            headless=True, port=_free_port(), executable_path=executable
        ) as viewer:
            _open(viewer, run, deadline)
            # A viewer that follows the latest data would go back there.
            shown = _end(viewer) if at is None else at
            viewer.set_time("sim_time", duration=shown, play_state="paused")
            time.sleep(2.0)  # The viewer decodes images and meshes over several frames.
            viewer.save_screenshot(str(out.resolve()))
            _wait_for(out, deadline)
    except RuntimeError:
        raise
    except Exception as error:
        raise RuntimeError(f"no screenshot of {run}: {error}; {_ADVICE}") from error


def _open(viewer: ViewerClient, run: Path, deadline: float) -> None:
    """Open the recording, once the viewer answers, and wait until it is loaded."""
    while True:
        try:
            viewer.open(run.resolve().as_uri())
            break
        except Exception as error:
            if time.monotonic() > deadline:
                raise RuntimeError(f"the viewer does not answer: {error}; {_ADVICE}") from error
            time.sleep(0.5)
    while viewer.get_state().loading:
        if time.monotonic() > deadline:
            raise RuntimeError(f"the viewer does not finish loading {run}")
        time.sleep(0.2)


def _end(viewer: ViewerClient) -> float:
    """Return the last time on ``sim_time`` [s], or zero if nothing is on it."""
    ends = [
        line.end
        for recording in viewer.get_state().recordings
        for line in recording.timelines
        if line.name == "sim_time" and line.end is not None
    ]
    return max(ends, default=0) * 1e-9


def _wait_for(out: Path, deadline: float) -> None:
    """Wait until the viewer has written the picture to its end: closing it would cut that off."""
    while not (out.is_file() and out.read_bytes().endswith(_PNG_END)):
        if time.monotonic() > deadline:
            raise RuntimeError(f"the viewer did not write {out}; {_ADVICE}")
        time.sleep(0.1)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    """Run the command line: ``screenshot RUN.rrd OUT.png``."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            {"screenshot": _screenshot}, prog="python -m twin.recording.record"
        )
    except (OSError, RuntimeError) as error:
        sys.exit(str(error))


def _screenshot(run: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path]) -> None:
    """Save what the viewer shows of a recording, without a screen.

    Args:
        run: Recording, .rrd.
        out: Picture to write, .png.
    """
    screenshot(run, out)


if __name__ == "__main__":
    main()
