"""Without anything to see the robots stand still: their controllers know no truth."""

import dataclasses

import mujoco
import numpy as np
import pytest

from controllers.insertion.card_inserter import InsertionStage
from experiments.ch5.insertion_scene import MASTER, SLAVE
from experiments.ch5.insertion_setting import InsertionTrial, prepare
from models.compose import ARM_JOINTS
from models.datasheets import CARD_AND_SLOT
from tests.twin.test_truth_barrier import leaks
from twin.camera import StereoRig
from twin.loop import LoopRecorder, run
from twin.robot import ArmMode, Command, WheelMode

HARD = CARD_AND_SLOT.slot_widths[-1]
FIRST = 2.0
"""Time after which the slave gives up in these tests [s]: as 15 s are, but shorter."""


class Notes(LoopRecorder):
    """Takes each tick's commands and true joint angles."""

    def __init__(self, setting):
        model, self._data = setting.simulation.model, setting.simulation.data
        arms = [f"{robot}/{name}_joint" for robot in (MASTER, SLAVE) for name in ARM_JOINTS]
        self._arms = [model.joint(name).qposadr[0] for name in arms]
        chassis = [model.body(f"{robot}/chassis").jntadr[0] for robot in (MASTER, SLAVE)]
        self._places = [model.jnt_qposadr[joint] + k for joint in chassis for k in (0, 1)]
        self.commands, self.arms, self.places, self.reasons = [], [], [], []
        self._inserter = setting.team.slave.inserter

    def record(self, tick):
        self.commands.append(tick.applied)
        self.arms.append(self._data.qpos[self._arms])
        self.places.append(self._data.qpos[self._places])
        self.reasons.append(self._inserter.reason)


class CommandRecorder:
    """Keeps what a team commands, before robots turn it into duty."""

    def __init__(self, team):
        self._team, self.commands = team, []

    def reset(self):
        self.commands.clear()

    def step(self, observations):
        commands = self._team.step(observations)
        self.commands.append(commands)
        return commands


class Hold:
    """Lets all robots hold what they first measure."""

    def __init__(self):
        self._commands = {}

    def reset(self):
        self._commands.clear()

    def step(self, observations):
        for name, seen in observations.items():
            angles = np.array(seen.arm_angles.value)
            held = Command(np.zeros(4), angles, WheelMode.SPEED, ArmMode.POSITION)
            self._commands.setdefault(name, held)
        return self._commands


@pytest.fixture(
    scope="module",
    params=[True, pytest.param(False, marks=pytest.mark.slow)],
    ids=["optimal", "random"],
)
def blind(request):
    """A whole team in the loop: sites hidden, images black, other copies of the state NaN."""
    made, real = [], mujoco.MjData
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mujoco, "MjData", lambda model: made.append(real(model)) or made[-1])
        patch.setattr(StereoRig, "capture", lambda *_: np.zeros((2, 492, 510), np.uint8))
        trial = InsertionTrial(HARD, request.param, 4)
        still = prepare(trial)
        held = Notes(still)
        run(still.simulation.robots, [Hold()], still.simulation, [held], FIRST)
        still.simulation.close()
        setting = prepare(trial)
        simulation, team = setting.simulation, setting.team
        copies = [data for data in made if data is not simulation.data]
        for data in copies:
            data.qpos[:] = np.nan
        simulation.model.key_qpos[:] = np.nan
        simulation.model.site_rgba[:, 3] = 0.0
        team.slave.inserter.config = dataclasses.replace(team.slave.inserter.config, first=FIRST)
        notes, recorder = Notes(setting), CommandRecorder(team)
        run(simulation.robots, [recorder], simulation, [notes], FIRST + 1.0)
    assert copies and simulation.model.nsite > 0
    yield setting, notes, recorder, held
    simulation.close()


def test_controllers_stop_with_target_not_seen(blind):
    setting, notes, _, _ = blind
    assert setting.team.slave.inserter.stage is InsertionStage.FAILED
    assert setting.team.slave.inserter.reason == "target not seen"
    assert notes.reasons.index("target not seen") == pytest.approx(100 * FIRST, abs=2)
    assert setting.team.master.marker_guide.fits == (None, None)


def test_no_axis_is_ever_commanded_to_move(blind):
    recorder = blind[2]
    for robot in (MASTER, SLAVE):
        commands = [each[robot] for each in recorder.commands]
        assert len(commands) == 300
        assert all(c.wheel_mode is WheelMode.SPEED and not c.wheels.any() for c in commands)
        assert all(c.arm_mode is ArmMode.POSITION and not c.arm_rates.any() for c in commands)
        arms = np.array([c.arm for c in commands])
        # The slave once takes its joints where it stops as where they are.
        assert np.ptp(arms, axis=0).max() < (1e-9 if robot == MASTER else 5e-3)


def test_all_axes_stay_still(blind):
    _, notes, _, held = blind
    # Arms sag a little when servos take them over, as those of robots commanded to hold do.
    np.testing.assert_allclose(notes.arms[: len(held.arms)], held.arms, atol=1e-9)
    np.testing.assert_allclose(notes.places[: len(held.places)], held.places, atol=1e-9)
    assert np.ptp(notes.arms, axis=0).max() < 0.05
    assert np.ptp(notes.places, axis=0).max() < 2e-3


def test_team_can_reach_no_truth(blind):
    assert leaks(blind[0].team) == []
