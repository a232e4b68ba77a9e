"""Drives to a place that fail: the place is chosen anew, and in the end the stage says why."""

import numpy as np
import pytest

from controllers.mission.behaviours import Driven
from controllers.mission.stage import StageError
from controllers.mission.stages import go_to
from controllers.mission.stages.go_to import GoToPlace
from tests.controllers.mission.hand_made import SLAVE, belief_of
from tests.controllers.motion.seen import seen_at


class GoBy(GoToPlace):
    """Drives by hand: to places on the map's x axis, without looking for the panel."""

    def _goal(self):
        return np.array(self.place[:2]), self.place[2]

    def _stretch(self, near):
        return None

    def _look(self, seen):
        return seen
        yield


def stage_with(monkeypatch, arrives):
    """Return a stage whose drives arrive or not, and the places that they went to."""
    belief = belief_of(SLAVE)
    belief.navigator.observe(seen_at(0.0))
    went, places = [], iter([(2.0, 0.0, 0.0), (3.0, 0.0, 0.0), (4.0, 0.0, 0.0), (5.0, 0.0, 0.0)])

    def drive(seen, navigator, arm, goal):
        went.append(goal[0][0])
        arrived = arrives(len(went))
        if arrived:
            navigator.odometry._pose = type(navigator.odometry.pose()).from_translation(
                [*goal[0], 0.0]
            )
        return Driven(seen, arrived, "" if arrived else "there is no path")
        yield

    monkeypatch.setattr(go_to, "drive", drive)
    return GoBy("place", belief, lambda: next(places), (0.05, 0.1)), went


def test_after_a_drive_that_failed_the_place_is_chosen_anew(monkeypatch):
    stage, went = stage_with(monkeypatch, lambda count: count == 2)
    stage.step(seen_at(0.01))
    assert stage.done and went == [2.0, 3.0] and stage.place == (3.0, 0.0, 0.0)


def test_drives_that_all_fail_end_the_stage_with_the_reason(monkeypatch):
    stage, went = stage_with(monkeypatch, lambda count: False)
    with pytest.raises(StageError, match="4 drives: there is no path"):
        stage.step(seen_at(0.01))
    assert went == [2.0, 3.0, 4.0, 5.0]
