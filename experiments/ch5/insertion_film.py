"""The film of an insertion: pictures, a recording for the rerun viewer, a GIF."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import rerun.blueprint as rrb
from PIL import Image

from experiments.ch5.insertion_scene import MASTER, SLAVE
from experiments.ch5.insertion_setting import InsertionTrial, Setting, prepare
from experiments.ch5.insertion_trial import perform
from models.card_and_slot.stand import OVERVIEW
from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.poses import BodyFit
from twin.camera import renderer
from twin.layout import task_blueprint
from twin.loop import LoopRecorder, Tick
from twin.record import Recorder

SIZE = (640, 480)
SMALL = (360, 270)
"""Of a half of the GIF [px]."""
EVERY = 40
"""Ticks from one picture to the next."""
_RED = (230, 60, 40)


@dataclasses.dataclass
class Film:
    """What was filmed.

    Attributes:
        frames: Colour pictures of the scene beside the master's left eye.
        steps: Four times [s] and pictures of the scene.
        pairs: Stereo pairs with the fitted ellipses of each image, by moment.
        course: Rows of `ch5_insertion_trial.COURSE`.
    """

    frames: list[ImageArray]
    steps: list[tuple[float, ImageArray]]
    pairs: dict[str, tuple[ImageArray, Sequence[FloatArray]]]
    course: FloatArray

    def save(self, path: Path) -> None:
        """Write the GIF."""
        middle = Image.fromarray(self.frames[len(self.frames) // 2])
        # Octrees keep the small colours: the card's green, the marks' red.
        palette = middle.quantize(96, method=Image.Quantize.FASTOCTREE)
        images = [
            Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
            for frame in self.frames
        ]
        times = [10 * EVERY // 2] * (len(images) - 1) + [2000]  # twice as fast as it was
        images[0].save(path, save_all=True, append_images=images[1:], duration=times, loop=0)


class _Camera(LoopRecorder):
    """Takes pictures of scene and eyes every few ticks."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self.frames: list[ImageArray] = []
        self.scenes: list[tuple[float, ImageArray]] = []
        self.pairs: dict[str, tuple[ImageArray, Sequence[FloatArray]]] = {}

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        if tick.step % EVERY:
            return
        scene = self._setting.simulation
        picture = renderer().render(scene.model, scene.data, OVERVIEW, *SIZE).copy()
        self.scenes.append((tick.time, picture))
        pair = np.asarray(tick.observations[MASTER].stereo.value, dtype=np.uint8)
        ellipses = seen_ellipses(self._setting.team.master.marker_guide.fits)
        self.frames.append(np.hstack([_small(picture), eye_picture(pair[0], ellipses[0])]))
        stage = self._setting.team.slave.inserter.stage.value
        moment = {"approach": "approach", "align": "almost contact", "insert": "insertion"}
        if stage in moment and any(len(e) for e in ellipses):
            if stage != "approach" or not self.pairs:
                self.pairs[moment[stage]] = (pair, ellipses)


class _Curves(LoopRecorder):
    """Adds errors, contact and stages to a recording."""

    def __init__(self, recorder: Recorder, setting: Setting) -> None:
        self._recorder, self._setting = recorder, setting
        self._told = ""
        self._stamp = math.nan

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        team = self._setting.team
        inserter = team.slave.inserter
        if np.isfinite(inserter.error).all():
            error = [
                1e3 * inserter.error[0],
                1e3 * inserter.error[1],
                np.degrees(inserter.error[2]),
            ]
            names = ("across [mm]", "ahead [mm]", "turn [deg]")
            self._recorder.log_scalars("insertion/error", error, names)
        stamp = tick.observations[MASTER].stereo.stamp
        if stamp != self._stamp:
            self._stamp = stamp
            for side, ellipses in zip(
                ("left", "right"), seen_ellipses(team.master.marker_guide.fits)
            ):
                self._recorder.log_marks(f"{MASTER}/stereo/{side}/markers", ellipses[:, :2])
        names = ("across [N]", "ahead [N]", "moment [N m]")
        self._recorder.log_scalars("insertion/contact", inserter.contact[[0, 1, 5]], names)
        phase = inserter.guide.phase.value if inserter.guide is not None else ""
        failed = " ".join(team.slave.failed)
        told = f"{inserter.stage.value} {phase} {inserter.reason} {failed}".strip()
        if told != self._told:
            self._told = told
            self._recorder.log_text("insertion/stage", told)


def film_trial(trial: InsertionTrial, recording: Path | None) -> Film:
    """Run a trial again and film it.

    Args:
        trial: What is tried.
        recording: File of a recording for the rerun viewer; None for none.
    """
    setting = prepare(trial)
    camera = _Camera(setting)
    recorders: list[LoopRecorder] = [camera]
    recorder = None
    if recording is not None:
        recorder = Recorder(recording, setting.simulation.robots, setting.simulation, _blueprint())
        recorders += [recorder, _Curves(recorder, setting)]
    traced = dataclasses.replace(trial, trace=True)
    done = perform(traced, recorders, setting)
    if recorder is not None:
        recorder.close()
    setting.simulation.close()
    last = len(camera.scenes) - 1
    steps = [camera.scenes[round(share * last)] for share in (0.0, 0.3, 0.6, 1.0)]
    return Film(camera.frames, steps, camera.pairs, np.array(done.scorer.course))


def seen_ellipses(fits: tuple[BodyFit | None, BodyFit | None]) -> tuple[FloatArray, FloatArray]:
    """Return (N, 5) fitted ellipses of the left and of the right image."""
    found = [fit.ellipses for fit in fits if fit is not None]
    both = np.concatenate(found, axis=1) if found else np.zeros((2, 0, 5))
    return both[0], both[1]


def eye_picture(image: ImageArray, ellipses: FloatArray) -> ImageArray:
    """Return what an eye saw, with the markers that were found."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    for u, v, suu, _, svv in ellipses:
        cv2.ellipse(picture, ((u, v), (2.0 * suu**0.5, 2.0 * svv**0.5), 0.0), _RED, 2)
    return _small(np.asarray(picture, dtype=np.uint8))


def _small(picture: ImageArray) -> ImageArray:
    return np.asarray(cv2.resize(picture, SMALL, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _blueprint() -> rrb.Blueprint:
    views = [
        rrb.TimeSeriesView(origin="insertion/error", name="Error as seen"),
        rrb.TimeSeriesView(origin="insertion/contact", name="Contact as felt"),
        rrb.TimeSeriesView(origin=f"{SLAVE}/sensors/arm_base_wrench", name="Wrench"),
        rrb.TextLogView(origin="insertion/stage", name="Stage"),
    ]
    return task_blueprint(MASTER, (1.3, -1.5, 0.9), (0.1, -0.2, 0.25), views)
