"""One insertion of ``ch5-insertion``, scored by the truth."""

import bisect
import contextlib
import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import CameraStation
from controllers.insertion.card_inserter import InsertionStage
from controllers.insertion.seating import SeatingGuide
from experiments.ch5.insertion_scene import (
    MASTER,
    SLAVE,
    CardForces,
    card_in_slot,
    contact_force,
    is_seated,
)
from experiments.ch5.insertion_setting import InsertionTrial, Setting, prepare
from perception.geometry.arrays import FloatArray
from twin.loop import LoopRecorder, Tick, run

LIMIT = 190.0
"""Longest trial [s]: the slave gives up before."""
STAGES = tuple(InsertionStage)
COURSE = (
    "time",
    "across",
    "ahead",
    "beside",
    "turn",
    "seen_across",
    "seen_ahead",
    "seen_turn",
    "force_across",
    "force_ahead",
    "moment",
    "true_across",
    "true_ahead",
    "stage",
)
"""Columns of a course: true pose, pose as last seen, measured and true contact, stage. SI units."""


@dataclasses.dataclass(frozen=True)
class InsertionOutcome:
    """How a trial ended, by the truth.

    Attributes:
        success: Whether the slave reports success and the card is truly seated.
        stage: Last stage of the slave.
        reason: Why it failed; empty if it did not.
        seconds: Robot time [s].
        wall: Wall time of the loop [s].
        peak: Largest true contact force [N].
        touch: Largest at one contact, while force guides the card before the connector [N].
        snap: Force at which the card snapped in, as felt [N]; NaN if it did not.
        hand_over: (6,) true error of the card when force takes over, see `card_in_slot`; NaN if
            it never did.
        gap: Distance of the card before the mouth at the end [m].
        station: Camera station of the master.
        seen: Share of stereo pairs in which card and slot were seen.
        moves: Number of times that the camera was placed anew.
        nees: Mean of `Scorer.nees`; NaN if the master sent no pose.
        finite: Whether all states were finite.
        course: (n, k) rows of `COURSE`; empty without `InsertionTrial.trace`.
    """

    success: bool
    stage: InsertionStage
    reason: str
    seconds: float
    wall: float
    peak: float
    touch: float
    snap: float
    hand_over: FloatArray
    gap: float
    station: CameraStation
    seen: float
    moves: int
    nees: float
    finite: bool
    course: FloatArray


class Scorer(LoopRecorder):
    """Measures by the truth, which no controller sees.

    Args:
        setting: Trial that is run.

    Attributes:
        forces: Largest contact forces on the card.
        hand_over: (6,) true error of the card when force takes over; NaN before.
        whole: Whether card and slot were seen, for each stereo pair.
        course: Rows of `COURSE`.
        finite: Whether all states were finite.
        nees: Normalized squared error of each pose that the master sent, per degree of freedom; 1
            on average if the covariance is right.
    """

    def __init__(self, setting: Setting) -> None:
        self.forces, self.finite = CardForces(), True
        self.hand_over = np.full(6, math.nan)
        self.course: list[list[float]] = []
        self.whole: list[bool] = []
        self.nees: list[float] = []
        self._setting, self._stamp = setting, math.nan
        # Time of each tick, and places and quaternions of slot and card then.
        self._truths: list[tuple[float, FloatArray, FloatArray]] = []
        data = setting.simulation.data
        self._bodies = [data.body(name).id for name in ("slot", f"{SLAVE}/card")]

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        team, data = self._setting.team, self._setting.simulation.data
        inserter, sent = team.slave.inserter, team.master.sent
        force = contact_force(data)
        now = tick.observations[MASTER].time  # By the clock that stamps what the master sends.
        self._truths.append((now, data.xpos[self._bodies], data.xquat[self._bodies]))
        self.forces.note(data, inserter.guide is not None)
        self.finite &= bool(np.isfinite(data.qpos).all())
        if inserter.guide is not None and math.isnan(self.hand_over[0]):
            self.hand_over = card_in_slot(data)
        stereo = tick.observations[MASTER].stereo
        if stereo.usable and stereo.stamp != self._stamp:
            self._stamp = stereo.stamp
            self.whole.append(None not in team.master.marker_guide.fits)
        if sent is not None and sent.transform_slot_to_card is not None:
            truth = self._truth_at(sent.time)
            error = np.asarray((truth * sent.transform_slot_to_card.inv()).as_exp_coords())
            self.nees.append(float(error @ np.linalg.solve(sent.covariance, error)) / error.size)
        if self._setting.trial.trace:
            felt, stage = inserter.contact[[0, 1, 5]], STAGES.index(inserter.stage)
            pose = card_in_slot(data)
            row = [tick.time, *pose[:4], *inserter.error[:3], *felt, *force[:2], stage]
            self.course.append([float(value) for value in row])

    def _truth_at(self, time: float) -> RigidTransform:
        """Return the true transform from the slot to the card at the time of a pair."""
        after = bisect.bisect(self._truths, time, key=lambda entry: entry[0])
        near = self._truths[max(after - 1, 0) : after + 1]
        _, places, quaternions = min(near, key=lambda entry: abs(entry[0] - time))
        rotations = Rotation.from_quat(quaternions, scalar_first=True)
        slot, card = RigidTransform.from_components(places, rotations)
        return card.inv() * slot


def perform(setting: Setting, recorders: Sequence[LoopRecorder] = ()) -> InsertionOutcome:
    """Run a trial.

    Args:
        setting: Trial, from `prepare`.
        recorders: Recorders beside the scorer.
    """
    scorer, simulation, team = Scorer(setting), setting.simulation, setting.team
    inserter = team.slave.inserter
    summary = run(
        setting.robots,
        [team],
        simulation,
        [scorer, *recorders],
        LIMIT,
        until=lambda: inserter.over,
    )
    final, guide = card_in_slot(simulation.data), inserter.guide
    if setting.trial.guides:
        seated = is_seated(final, setting.trial.width)
    else:
        seated = final[1] >= inserter.config.guide.depth - 2e-3 and abs(final[2]) < 0.01
    return InsertionOutcome(
        success=bool(inserter.stage is InsertionStage.DONE and seated),
        stage=inserter.stage,
        reason=inserter.reason,
        seconds=simulation.time,
        wall=summary.wall,
        peak=scorer.forces.peak,
        touch=scorer.forces.touch,
        snap=guide.snap_force if isinstance(guide, SeatingGuide) else math.nan,
        hand_over=scorer.hand_over,
        gap=-final[1],
        station=setting.station,
        seen=sum(scorer.whole) / max(len(scorer.whole), 1),
        moves=team.master.marker_guide.moves,
        nees=float(np.mean(scorer.nees)) if scorer.nees else math.nan,
        finite=scorer.finite,
        course=np.array(scorer.course),
    )


def run_trial(trial: InsertionTrial) -> InsertionOutcome:
    """Insert the card once; a job of the sweep.

    Args:
        trial: Settings of the trial.
    """
    setting = prepare(trial)
    with contextlib.closing(setting.simulation):
        return perform(setting)
