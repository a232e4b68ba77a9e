"""Recordings for the rerun viewer: bodies, sensors, commands, images and estimates.

Everything goes to a file, in columns of half a second, so that recording costs little and an
interrupted run keeps what it had. ``python -m twin.record screenshot RUN.rrd OUT.png`` shows one.
"""

import dataclasses
import sys
import types
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol

import cv2
import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import tyro

from perception.geometry.arrays import FloatArray, ImageArray
from twin.description import RobotDescription
from twin.layout import default_blueprint
from twin.loop import LoopRecorder, Tick
from twin.robot import Channel, Robot, Validity
from twin.scene_mesh import body_mesh
from twin.screenshot import screenshot
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
_SLACK = 1e-9
_POINT = 0.003  # Radius of a point in space [m].
_MARK = (230, 60, 40)


@dataclasses.dataclass(frozen=True)
class RecorderConfig:
    """How densely to record.

    Attributes:
        body_rate: Poses of bodies per second [Hz].
        image_rate: Stereo pairs per second, at most [Hz].
        jpeg_quality: JPEG quality of stereo images, 0 to 100.
        flush_period: Robot time between writes [s].
    """

    body_rate: float = 25.0
    image_rate: float = 4.0
    jpeg_quality: int = 60
    flush_period: float = 0.5


@dataclasses.dataclass
class _Curve:
    """Samples of one entity that are not written yet."""

    width: int
    steps: list[int] = dataclasses.field(default_factory=list[int])
    times: list[float] = dataclasses.field(default_factory=list[float])
    values: list[FloatArray] = dataclasses.field(default_factory=list[FloatArray])


class RecordedScene(Protocol):
    """A simulated scene, as far as a recorder reads it.

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
        config: RecorderConfig | None = None,
    ) -> None:
        """Open the file and write what never changes.

        Args:
            path: File to write, ``.rrd``; folders are made.
            robots: Robots that are recorded, by name.
            simulation: Scene whose bodies are recorded; None for real robots.
            blueprint: Layout of the viewer; None for `default_blueprint`.
            config: How densely to record.
        """
        self.path = Path(path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._config = config or RecorderConfig()
        self._stream = rr.RecordingStream("fieldtwin")
        self._stream.save(self.path, default_blueprint=blueprint or default_blueprint(list(robots)))
        self._curves: dict[str, _Curve] = {}
        self._named: set[str] = set()
        self._step, self._time = 0, 0.0
        self._next_flush = self._next_bodies = -np.inf
        self._next_image: dict[str, float] = {}
        self._seen: dict[str, float] = {}
        self._components = {
            f"{name}/{channel}": components
            for name, robot in robots.items()
            for channel, components in _components(robot.description).items()
        }
        self._simulation = simulation
        self._moving: list[tuple[int, str]] = []
        if simulation is not None:
            self._write_scene(simulation)

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def record(self, tick: Tick) -> None:
        """Take one servo tick; channels that say nothing new are left out."""
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
            self._next_bodies = tick.time + 1.0 / self._config.body_rate
            self._take_bodies()
        if tick.time >= self._next_flush - _SLACK:
            self._next_flush = tick.time + self._config.flush_period
            self._write_curves()

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
        row = np.atleast_1d(np.asarray(values, dtype=float))
        if path not in self._named and names:
            self._stream.log(path, rr.SeriesLines(names=list(names)), static=True)
        self._named.add(path)
        self._append(path, row)

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
            entity = f"{path}/{part}"
            row = np.atleast_1d(np.asarray(values, dtype=float))
            if entity not in self._named:
                labels = [f"{n} {part}" for n in names] or [f"{path} {part}"] * row.size
                style = rr.SeriesLines(names=labels, widths=[width] * row.size)
                self._stream.log(entity, style, static=True)
                self._named.add(entity)
            self._append(entity, row)

    def log_text(self, path: str, text: str) -> None:
        """Add a line to a log, at the latest tick's time."""
        self._stream.send_columns(path, self._now(), rr.TextLog.columns(text=[text]))

    def log_image(self, path: str, image: ImageArray) -> None:
        """Add an image, compressed, at the latest tick's time.

        Args:
            path: Entity, such as ``camera``.
            image: (height, width) grey levels, or (height, width, 3) blue, green and red.
        """
        quality = [int(cv2.IMWRITE_JPEG_QUALITY), self._config.jpeg_quality]
        _, data = cv2.imencode(".jpg", image, quality)
        packed = rr.EncodedImage.columns(blob=[data.tobytes()], media_type=["image/jpeg"])
        self._stream.send_columns(path, self._now(), packed)

    def log_marks(self, path: str, pixels: FloatArray, radius: float = 6.0) -> None:
        """Mark pixels of an image, at the latest tick's time; none takes older marks away.

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
        """Show points in space, at the latest tick's time; they take the place of older ones.

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

    def flush(self) -> None:
        """Write everything taken so far to the file."""
        self._write_curves()
        self._stream.flush()

    def close(self) -> None:
        """Write the rest and close the file."""
        self.flush()
        self._stream.disconnect()

    def _append(self, path: str, row: FloatArray) -> None:
        curve = self._curves.get(path)
        if curve is None:
            curve = self._curves[path] = _Curve(row.size)
        if row.size != curve.width:
            raise ValueError(f"curve {path!r} has {curve.width} values, got {row.size}")
        curve.steps.append(self._step)
        curve.times.append(self._time)
        curve.values.append(row)

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
        early = self._time < self._next_image.get(robot, -np.inf) - _SLACK
        if early or self._seen.get(f"{robot}/stereo") == stereo.stamp:
            return
        self._seen[f"{robot}/stereo"] = stereo.stamp
        self._next_image[robot] = self._time + 1.0 / self._config.image_rate
        for side, image in zip(("left", "right"), stereo.value):
            self.log_image(f"{robot}/stereo/{side}", np.asarray(image, dtype=np.uint8))

    def _take_bodies(self) -> None:
        if self._simulation is None:
            return
        data = self._simulation.data
        for body, path in self._moving:
            self._append(path, np.concatenate([data.xpos[body], data.xquat[body]]))

    def _write_scene(self, simulation: RecordedScene) -> None:
        """Write each body's mesh once, and the pose of those that never move."""
        model, data = simulation.model, simulation.data
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for body in range(model.nbody):
            mesh = body_mesh(model, body)
            if mesh is None:
                continue
            path = f"world/{body_name(model, body)}"
            shape = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.faces,
                vertex_normals=mesh.normals,
                vertex_colors=mesh.colours,
            )
            self._stream.log(path, shape, static=True)
            if int(model.body_weldid[body]) != 0:
                self._moving.append((body, path))
                continue
            pose = rr.Transform3D(
                translation=data.xpos[body], quaternion=np.roll(data.xquat[body], -1)
            )
            self._stream.log(path, pose, static=True)

    def _write_curves(self) -> None:
        bodies = {path for _, path in self._moving}
        for path, curve in self._curves.items():
            if not curve.steps:
                continue
            index = [
                rr.TimeColumn("sim_time", duration=curve.times),
                rr.TimeColumn("step", sequence=curve.steps),
            ]
            rows = np.array(curve.values)
            if path in bodies:
                columns = rr.Transform3D.columns(
                    translation=rows[:, :3], quaternion=np.roll(rows[:, 3:], -1, axis=1)
                )
            else:
                columns = rr.Scalars.columns(scalars=rows.ravel())
                columns = columns.partition([curve.width] * len(rows))
            self._stream.send_columns(path, index, columns)
            curve.steps.clear()
            curve.times.clear()
            curve.values.clear()

    def _now(self) -> list[rr.TimeColumn]:
        # The SDK's own `log` would add wall-clock timelines; a run has its own time only.
        return [
            rr.TimeColumn("sim_time", duration=[self._time]),
            rr.TimeColumn("step", sequence=[self._step]),
        ]


def _components(robot: RobotDescription) -> dict[str, Sequence[str]]:
    """Return the names of the values of each curve of a robot, by entity below the robot."""
    wheels, joints = robot.wheel_names, robot.joint_names
    named = {"wheel_speeds": wheels, "arm_angles": joints, "arm_rates": joints, **_COMPONENTS}
    sensors = {f"sensors/{channel}": names for channel, names in named.items()}
    return {**sensors, "duty/wheels": wheels, "duty/arm": joints}


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return a body's entity path below ``world``."""
    return str(model.body(body).name) or f"body_{body}"


def main() -> None:
    """Run the command line: ``screenshot RUN.rrd OUT.png``."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            {"screenshot": _screenshot}, prog="python -m twin.record"
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
