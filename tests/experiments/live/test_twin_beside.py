"""The twin beside a simulated rover that is as drawn, but for what is done to it here."""

import types

import numpy as np
import pytest

from controllers.motion.simple_motions import Work
from controllers.sensing.diagnosis import Finding
from experiments.live import twin_beside
from experiments.live.twin_beside import TwinBeside
from experiments.living.happenings import happen
from models.compose import FieldConfig, RobotPlacement
from twin.connect import connect
from twin.logs.ticks import RoverTick
from twin.loop import LoopRecorder, run
from twin.robot import Command

ROBOT = RobotPlacement("rover1")
STANDING = Command(wheels=np.zeros(4), arm=np.zeros(4))
FIELD = FieldConfig(size=(16.0, 16.0), texture_pixels=16)


class Beside(LoopRecorder):
    def __init__(self, twin):
        self._twin = twin

    def record(self, tick):
        name = ROBOT.name
        applied = tick.applied.get(name, STANDING)
        self._twin.step(RoverTick(name, tick.observations[name], applied))


def beside(learning, work, *spans, what, size):
    """A twin, after a rover worked for one span [s] before something happens and one after."""
    twin = TwinBeside(ROBOT, learning, threads=1)
    with connect("sim", robots=[ROBOT], field=FIELD, seed=3) as connection:
        controllers = [Work(twin.drawn, np.random.default_rng(2))] if work else []
        for number, span in enumerate(spans):
            if number == len(spans) - 1:
                happen(connection.simulation, twin.shadow.model, ROBOT.name, what, size)
            run(connection.robots, controllers, connection.clock, [Beside(twin)], span)
    twin.close()
    return twin


@pytest.mark.slow
def test_the_twin_takes_in_what_it_learns_of_its_rover():
    twin = beside(20.0, True, 16.0, what="supply shoulder", size=0.1)
    known = dict(
        zip((each.name for each in twin.deviations), twin.shadow.known.tolist(), strict=True)
    )
    assert known["supply shoulder"] == pytest.approx(0.1, abs=0.04)
    assert not twin.named
    # What happens wholly or not at all is not learned by halves.
    assert not any(known[name] for name in known if name.startswith(("stuck", "blocked")))


@pytest.mark.slow
def test_a_zero_of_the_inclinometer_is_told_by_the_accelerometer():
    twin = beside(4.0, False, 6.0, 2.0, what="zero roll", size=-0.02)
    (named,) = twin.named
    assert named.finding.name == "zero roll"
    assert abs(named.finding.size + 0.02) < 3.0 * named.finding.sigma
    assert 6.0 < named.time < 7.0  # noqa: PLR2004
    known = twin.shadow.known[[each.name for each in twin.deviations].index("zero roll")]
    assert known == pytest.approx(-0.02, abs=0.005)


@pytest.mark.parametrize(
    ("rough", "told", "named"),
    [
        (False, ["load base"], "load base"),
        (True, ["load base", "load base"], "load base"),
        (True, ["load base", "battery", "battery"], "battery"),
        (True, ["load base", "", "load base"], None),
    ],
)
def test_on_rough_ground_what_is_named_was_told_twice_in_a_row(monkeypatch, rough, told, named):
    """Of trials that each tell at the second tick what they are to, or nothing."""
    left = list(told)

    class Told:
        begin = None

        def __init__(self, changes, learned):
            self.rows, self.over, self.finding = np.zeros((1, count)), False, None
            self._ticks = 0

        def step(self, missed, sigma, sensitivities, kind):
            self._ticks += 1
            if self._ticks == 2:  # noqa: PLR2004
                self.over, name = True, left.pop(0)
                self.finding = Finding(name, 1.0, 0.1, 9.0) if name else None

    monkeypatch.setattr(twin_beside, "Trial", Told)
    twin = TwinBeside(ROBOT, 1.0, threads=1, rough=rough)
    count, suspect = len(twin.deviations), twin._by_name["load base"]
    detector = types.SimpleNamespace(
        step=lambda *_: Finding("load base", 1.0, 0.1, 9.0),
        suspects=[suspect], learned=None, pause=lambda: None,
    )  # fmt: skip
    monkeypatch.setattr(twin, "_detector", detector)
    innovation = types.SimpleNamespace(
        time=1.0, values=None, tried=None, sigma=None, sensitivities=None,
        refuted=np.zeros(count, dtype=bool),
    )  # fmt: skip
    found = []
    while left:
        found.append(twin._look(innovation, 0))
    twin.close()
    assert not any(found[:-1])
    assert (found[-1] and found[-1].name) == named
