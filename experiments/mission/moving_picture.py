"""Moving picture of a mission: both rovers' tracks in the field, and what both see."""

from pathlib import Path

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from experiments.ch5.task_film import scene_picture
from experiments.harness.figure_style import COLOURS, rgb
from experiments.harness.recording import write_gif
from experiments.mission.figures import ROLES, draw_field
from experiments.mission.scene import CARD_PLACE, MASTER, SLAVE
from experiments.mission.trial import Mission
from models.card_and_slot.stand import OVERVIEW
from perception.geometry.arrays import FloatArray, ImageArray
from twin.loop import LoopRecorder, Tick
from twin.robot import ImageChannel

_SIDE = 400  # Height of a picture, and width of the field's part [px].
_EVERY, _EVERY_INSERTING = 300, 100  # Ticks between two pictures.
_FRAME, _LAST = 100.0, 2000.0  # Time for which each is shown, and the last one [ms].
_MARGIN = 1.5  # Ground shown about initial poses and slot [m].


class MovingPicture(LoopRecorder):
    """Draws a simulated mission every three seconds, the insertion every second.

    Args:
        mission: Mission, ready to run.

    Attributes:
        frames: Pictures: the field with the tracks, later the slot, beside what both heads saw.
    """

    def __init__(self, mission: Mission) -> None:
        self.frames: list[ImageArray] = []
        self._mission = mission
        self._field = _FieldMap(mission)
        self._tracks: dict[str, list[FloatArray]] = {MASTER: [], SLAVE: []}
        self._seen = {name: np.zeros((2, 2), np.uint8) for name in self._tracks}

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        for name, seen in tick.observations.items():
            stereo = seen.stereo
            # What no controller has read is not drawn.
            if isinstance(stereo, ImageChannel) and stereo.usable and stereo.drawn:
                self._seen[name] = np.asarray(stereo.value[0], dtype=np.uint8)
        inserts = self._mission.insertion is not None
        if tick.step % (_EVERY_INSERTING if inserts else _EVERY):
            return
        simulation = self._mission.connection.simulation
        assert simulation is not None
        for name, track in self._tracks.items():
            track.append(self._mission.place(name)[:2])
        if inserts:
            scene = scene_picture(simulation, OVERVIEW)
            aside = (scene.shape[1] - scene.shape[0]) // 2
            left = _resized(scene[:, aside : aside + scene.shape[0]], _SIDE)
        else:
            left = self._field.with_tracks(self._tracks)
        eyes = np.vstack([_eye(self._seen[name]) for name in self._tracks])
        self.frames.append(np.hstack([left, eyes]))

    def save(self, path: Path) -> None:
        """Write the GIF.

        Args:
            path: File to write, ``.gif``.
        """
        frames = [Image.fromarray(frame) for frame in self.frames]
        some = np.vstack([self.frames[0], self.frames[len(frames) // 2], self.frames[-1]])
        palette = Image.fromarray(some).quantize(64, method=Image.Quantize.FASTOCTREE)
        write_gif(path, frames, palette, _FRAME, _LAST)


class _FieldMap:
    """Map of a mission's field, drawn once, to which tracks are added.

    Args:
        mission: Mission, ready to run.
    """

    def __init__(self, mission: Mission) -> None:
        places = np.array([*(robot.position for robot in mission.scene.robots), CARD_PLACE[:2]])
        low, high = places.min(axis=0) - _MARGIN, places.max(axis=0) + _MARGIN
        middle, half = 0.5 * (low + high), 0.5 * float((high - low).max())
        self._corner, self._scale = middle - half, _SIDE / (2.0 * half)
        figure = Figure(figsize=(_SIDE / 100.0, _SIDE / 100.0), dpi=100.0)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        draw_field(axes, mission.trial)
        axes.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        self._empty = np.array(canvas.buffer_rgba())[:, :, :3]

    def with_tracks(self, tracks: dict[str, list[FloatArray]]) -> ImageArray:
        """Return the map with tracks of (2,) places by robot [m]."""
        picture = self._empty.copy()
        for name, track in tracks.items():
            pixels = (np.array(track) - self._corner) * self._scale
            pixels[:, 1] = _SIDE - pixels[:, 1]
            line = np.rint(pixels).astype(np.int32)
            colour = rgb(COLOURS[ROLES[name]])
            cv2.polylines(picture, [line[:, None]], False, colour, 1, cv2.LINE_AA)
            cv2.circle(picture, tuple(line[-1].tolist()), 5, colour, -1, cv2.LINE_AA)
        return picture


def _eye(image: ImageArray) -> ImageArray:
    """Return a head's left image as a small colour picture."""
    aside = (image.shape[1] - image.shape[0]) // 2
    square = image[:, aside : aside + image.shape[0]]
    return _resized(cv2.cvtColor(square, cv2.COLOR_GRAY2RGB), _SIDE // 2)


def _resized(picture: ImageArray | cv2.typing.MatLike, side: int) -> ImageArray:
    """Return a picture, brought to a square of some pixels a side."""
    return np.asarray(cv2.resize(picture, (side, side), interpolation=cv2.INTER_AREA), np.uint8)
