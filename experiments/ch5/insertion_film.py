"""The film of an insertion: pictures, a recording for the rerun viewer, a GIF."""

import contextlib
import dataclasses
import math
from pathlib import Path

import cv2
import numpy as np
import rerun.blueprint as rrb
from PIL import Image

from experiments.ch5.insertion_scene import MASTER
from experiments.ch5.insertion_setting import InsertionTrial, Setting, prepare
from experiments.ch5.insertion_trial import perform
from experiments.ch5.task_film import InsertionLog, insertion_views, scene_picture
from experiments.harness.recording import RunFiles, write_gif
from models.card_and_slot.stand import OVERVIEW
from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.poses import BodyFit
from twin.loop import LoopRecorder, Tick
from twin.recording.layout import task_blueprint
from twin.recording.record import Recorder

SMALL = (360, 270)
"""Size of a half of the GIF [px]."""
EVERY = 40
"""Ticks from one picture to the next."""
_RED = (230, 60, 40)
_MOMENTS = {"approach": "approach", "align": "almost contact", "insert": "insertion"}
Ellipses = tuple[FloatArray, FloatArray]


class Film(LoopRecorder):
    """Takes pictures of the scene and of the master's stereo pairs every few ticks.

    Args:
        setting: Trial that is run.

    Attributes:
        frames: Colour pictures of the scene beside the master's left image.
        scenes: Times [s] and pictures of the scene.
        pairs: Stereo pairs with the fitted ellipses of each image, by moment.
        course: (n, k) rows of `insertion_trial.COURSE`.
    """

    def __init__(self, setting: Setting) -> None:
        self.frames: list[ImageArray] = []
        self.scenes: list[tuple[float, ImageArray]] = []
        self.pairs: dict[str, tuple[ImageArray, Ellipses]] = {}
        self.course = np.empty((0, 0))
        self._setting = setting

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        if tick.step % EVERY:
            return
        team = self._setting.team
        picture = scene_picture(self._setting.simulation, OVERVIEW)
        self.scenes.append((tick.time, picture))
        pair = np.asarray(tick.observations[MASTER].stereo.value, dtype=np.uint8)
        ellipses = seen_ellipses(team.master.marker_guide.fits)
        self.frames.append(np.hstack([_small(picture), eye_picture(pair[0], ellipses[0])]))
        stage = team.slave.inserter.stage.value
        shown = stage in _MOMENTS and any(len(e) for e in ellipses)
        if shown and (stage != "approach" or not self.pairs):
            self.pairs[_MOMENTS[stage]] = (pair, ellipses)

    def steps(self) -> list[tuple[float, ImageArray]]:
        """Return four times [s] and pictures of the scene."""
        last = len(self.scenes) - 1
        return [self.scenes[round(share * last)] for share in (0.0, 0.3, 0.6, 1.0)]

    def save(self, path: Path) -> None:
        """Write the GIF, at twice the speed of the robots."""
        frames = [Image.fromarray(frame) for frame in self.frames]
        # Octrees keep the small colours: the card's green, the marks' red.
        palette = frames[len(frames) // 2].quantize(96, method=Image.Quantize.FASTOCTREE)
        write_gif(path, frames, palette, 10 * EVERY / 2, 2000.0)


class _Curves(LoopRecorder):
    """Adds errors, markers, contact and stages to a recording."""

    def __init__(self, recorder: Recorder, setting: Setting) -> None:
        self._recorder, self._team = recorder, setting.team
        self._log = InsertionLog(recorder, "insertion")
        self._stamp = math.nan

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        inserter, stamp = self._team.slave.inserter, tick.observations[MASTER].stereo.stamp
        if np.isfinite(inserter.error).all():
            error = inserter.error[:3] * [1e3, 1e3, 180.0 / math.pi]
            names = ("across [mm]", "ahead [mm]", "turn [deg]")
            self._recorder.log_scalars("insertion/error", error, names)
        if stamp != self._stamp:
            self._stamp = stamp
            both = seen_ellipses(self._team.master.marker_guide.fits)
            for side, ellipses in zip(("left", "right"), both):
                self._recorder.log_marks(f"{MASTER}/stereo/{side}/markers", ellipses[:, :2])
        phase = inserter.guide.phase.value if inserter.guide is not None else ""
        self._log.add(inserter, phase, *self._team.slave.failed)


def film_trial(trial: InsertionTrial, files: RunFiles) -> Film:
    """Run a trial again and film it.

    Args:
        trial: Settings of the trial.
        files: What else of it is written.
    """
    setting = prepare(dataclasses.replace(trial, trace=True))
    film = Film(setting)
    recorders: list[LoopRecorder] = [film]
    with contextlib.ExitStack() as stack:
        stack.callback(setting.simulation.close)
        recorders += stack.enter_context(files.logged(None))
        if files.recording:
            errors = rrb.TimeSeriesView(origin="insertion/error", name="Error as seen")
            views = [errors, *insertion_views("insertion")]
            layout = task_blueprint(MASTER, (1.3, -1.5, 0.9), (0.1, -0.2, 0.25), views)
            recorder = Recorder(
                files.recording, setting.simulation.robots, setting.simulation, layout
            )
            recorders += [stack.enter_context(recorder), _Curves(recorder, setting)]
        film.course = perform(setting, recorders).course
    return film


def seen_ellipses(fits: tuple[BodyFit | None, BodyFit | None]) -> Ellipses:
    """Return (N, 5) fitted ellipses of the left and of the right image."""
    found = [fit.ellipses for fit in fits if fit is not None]
    both = np.concatenate(found, axis=1) if found else np.zeros((2, 0, 5))
    return both[0], both[1]


def eye_picture(image: ImageArray, ellipses: FloatArray) -> ImageArray:
    """Return a picture of an image with the markers that were found."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    for u, v, suu, _, svv in ellipses:
        cv2.ellipse(picture, ((u, v), (2.0 * suu**0.5, 2.0 * svv**0.5), 0.0), _RED, 2)
    return _small(np.asarray(picture, dtype=np.uint8))


def _small(picture: ImageArray) -> ImageArray:
    return np.asarray(cv2.resize(picture, SMALL, interpolation=cv2.INTER_AREA), dtype=np.uint8)
