"""One insertion of ``ch5-insertion``, and what the scorer alone may see."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from controllers.insertion.card_inserter import InsertionStage
from controllers.insertion.guidance import Guidance
from experiments.ch5.insertion_scene import MASTER, SLAVE, card_in_slot, contact_force, transform
from experiments.ch5.insertion_setting import InsertionTrial, Setting, prepare
from twin.loop import LoopRecorder, Tick, run

LIMIT = 90.0
"""Longest trial [s]."""
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


class Scorer(LoopRecorder):
    """Keeps what a trial is scored by: truth, which no controller sees.

    Attributes:
        peak: Largest true contact force [N].
        hand_over: (2,) true error across [m] and turn [rad] when force takes over; NaN before.
        looks: Pairs so far.
        whole: Pairs in which card and slot were seen.
        course: Rows of `COURSE`.
        finite: Whether all commands were finite and all states too.
        nees: Normalized squared error of each pose that the master sent, per degree of freedom; 1
            on average if the covariance is right.
    """

    def __init__(self, setting: Setting, trace: bool) -> None:
        """Begin.

        Args:
            setting: That is run.
            trace: Keep the course.
        """
        self.peak, self.looks, self.whole = 0.0, 0, 0
        self.hand_over = np.full(2, math.nan)
        self.course: list[list[float]] = []
        self.finite = True
        self.nees: list[float] = []
        self._setting, self._trace, self._stamp = setting, trace, math.nan

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        simulation, team = self._setting.simulation, self._setting.team
        inserter, marker_guide = team.slave.inserter, team.master.marker_guide
        force = contact_force(simulation.model, simulation.data)
        self.peak = max(self.peak, float(np.linalg.norm(force)))
        self.finite &= bool(np.isfinite(simulation.data.qpos).all())
        if inserter.guide is not None and math.isnan(self.hand_over[0]):
            self.hand_over = card_in_slot(simulation.data)[[0, 3]]
        stereo = tick.observations[MASTER].stereo
        if stereo.usable and stereo.stamp != self._stamp:
            self._stamp = stereo.stamp
            self.looks += 1
            self.whole += all(fit is not None for fit in marker_guide.fits)
        if team.master.sent is not None and team.master.sent.transform_slot_to_card is not None:
            self.nees.append(_nees(simulation.data, team.master.sent))
        if self._trace:
            felt = inserter.contact[[0, 1, 5]]
            stage = STAGES.index(inserter.stage)
            pose = card_in_slot(simulation.data)
            row = [tick.time, *pose[:4], *inserter.error[:3], *felt, *force[:2], stage]
            self.course.append([float(value) for value in row])


def _nees(data: mujoco.MjData, told: Guidance) -> float:
    """Return the normalised squared error of a pose that the master sends at once."""
    assert told.transform_slot_to_card is not None
    truth = transform(data, f"{SLAVE}/card").inv() * transform(data, "slot")
    error = np.asarray((truth * told.transform_slot_to_card.inv()).as_exp_coords())
    return float(error @ np.linalg.solve(told.covariance, error)) / error.size


@dataclasses.dataclass
class Trial:
    """A finished trial.

    Attributes:
        setting: As it ended.
        scorer: What it was scored by.
        wall: Wall time that the loop took [s].
    """

    setting: Setting
    scorer: Scorer
    wall: float


def perform(
    trial: InsertionTrial, recorders: Sequence[LoopRecorder] = (), setting: Setting | None = None
) -> Trial:
    """Run a trial.

    Args:
        trial: What is tried.
        recorders: Beside the scorer.
        setting: Prepared for the trial, if recorders needed it.
    """
    ready = setting or prepare(trial)
    scorer = Scorer(ready, trial.trace)
    simulation, inserter = ready.simulation, ready.team.slave.inserter
    summary = run(
        ready.robots,
        [ready.team],
        simulation,
        [scorer, *recorders],
        LIMIT,
        until=lambda: inserter.over,
    )
    return Trial(ready, scorer, summary.wall)


def run_trial(trial: InsertionTrial) -> dict[str, Any]:
    """Insert the card once.

    Returns:
        ``success`` (the slave says so and the card is truly seated), ``best``
        placement, ``stage``, ``reason``,
        ``seconds``, ``wall`` time of the loop [s], ``peak`` contact force [N], ``across`` [m] and
        ``turn`` [rad] errors at the hand-over (NaN without), ``gap`` of the card at the end [m],
        ``distance`` [m] and ``slant`` [rad] of the camera, ``seen`` share of pairs with all
        markers, ``moves`` of the camera, ``nees`` mean of `Scorer.nees` (NaN if nothing was sent),
        ``finite`` (no state was not); with ``trace`` ``course``.
    """
    done = perform(trial)
    scorer, setting = done.scorer, done.setting
    inserter, marker_guide = setting.team.slave.inserter, setting.team.master.marker_guide
    final = card_in_slot(setting.simulation.data)
    seated = final[1] >= inserter.config.guide.depth - 2e-3 and abs(final[2]) < 0.01
    result: dict[str, Any] = {
        "success": bool(inserter.stage is InsertionStage.DONE and seated),
        "best": trial.optimal,
        "stage": inserter.stage.value,
        "reason": inserter.reason,
        "seconds": setting.simulation.time,
        "wall": done.wall,
        "peak": scorer.peak,
        "across": scorer.hand_over[0],
        "turn": scorer.hand_over[1],
        "gap": -final[1],
        "distance": setting.station.distance,
        "slant": setting.station.slant,
        "seen": scorer.whole / max(scorer.looks, 1),
        "moves": marker_guide.moves,
        "nees": float(np.mean(scorer.nees)) if scorer.nees else math.nan,
        "finite": scorer.finite,
    }
    setting.simulation.close()
    return result | ({"course": np.array(scorer.course)} if trial.trace else {})
