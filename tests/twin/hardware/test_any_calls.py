"""Whatever is called, in whatever order and with whatever on the wires: nothing drives unasked."""

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tests.twin.hardware.board_tables import PERIOD
from tests.twin.hardware.roboclaw.wire import virtual_time
from tests.twin.hardware.test_cut_wires import ADDRESSES, Rig, stops_all
from twin.hardware.board_robot import BoardRobotConfig
from twin.hardware.roboclaw.codec import BoardCommand
from twin.hardware.serial_link import LinkError
from twin.robot import ArmMode, Command, Lifecycle, RobotError, WheelMode, applied_command

pytestmark = pytest.mark.virtual_time

NUMBERS = st.sampled_from([0.0, -0.0, 0.3, -1.0, 1e300, -1e308, np.nan, np.inf, -np.inf])
ROWS = st.one_of(
    st.lists(NUMBERS, min_size=4, max_size=4),
    st.lists(NUMBERS, max_size=9),
    st.sampled_from([None, "1234", [[0.1] * 4], [object()] * 4, np.full(4, 0.5), np.ones(3)]),
)
WHEEL_MODES = st.sampled_from([*WheelMode, "duty", None, ArmMode.DUTY])
ARM_MODES = st.sampled_from([*ArmMode, "position", 3, WheelMode.DUTY])
CUTS = st.sampled_from([(), ("requests",), ("replies",), ("requests", "replies")])
DEAD = st.sampled_from([None, *ADDRESSES])
DUTY = bytes((BoardCommand.DUTY_BOTH,))


def drives(data):
    """Whether these bytes let a motor turn."""
    return data[1:2] == DUTY and not stops_all(data) and any(data[2:6])


class AnyCalls(RuleBasedStateMachine):
    @initialize()
    def power_on(self):
        self.rig = Rig()
        self._time = virtual_time(self.rig.link)
        self._time.__enter__()
        self.robot, self.sent = self.rig.robot, 0
        self.may_drive = False

    def teardown(self):
        self._time.__exit__(None, None, None)

    def call(self, step, *expected):
        """Call the robot, which may refuse in the stated ways only."""
        try:
            step()
        except expected:
            pass
        self.confirmed_is_zero()

    @rule()
    def configure(self):
        self.call(self.robot.configure, RobotError)

    @rule()
    def home(self):
        self.call(lambda: self.robot.home(np.zeros(4)), RobotError, LinkError)

    @rule()
    def activate(self):
        self.call(self.robot.activate, RobotError)

    @rule(cycles=st.integers(1, 30))
    def observe(self, cycles):
        for _ in range(cycles):
            self.rig.link.now += PERIOD
            self.call(self.robot.observe, RobotError)

    @rule()
    def guard(self):
        self.robot.guard()

    @rule(pause=st.sampled_from([0.001, 0.05, 0.14, 0.16, 1.0]))
    def wait(self, pause):
        self.rig.link.now += pause
        if pause > BoardRobotConfig.watchdog:
            self.guard()
            assert self.robot.lifecycle is not Lifecycle.ACTIVE

    @rule(cycles=st.integers(1, 10))
    def drive(self, cycles):
        if self.robot.lifecycle is not Lifecycle.ACTIVE:
            self.fail((), None, b"")
            for start in (self.configure, self.home, self.activate):
                start()
        for _ in range(cycles):
            self.rig.link.now += PERIOD
            self.call(self.robot.observe, RobotError)
            self.may_drive |= self.robot.lifecycle is Lifecycle.ACTIVE
            self.call(
                lambda: self.robot.command(Command(np.full(4, 0.54), np.full(4, -0.2))), RobotError
            )

    @rule(wheels=ROWS, arm=ROWS, wheel_mode=WHEEL_MODES, arm_mode=ARM_MODES)
    def command(self, wheels, arm, wheel_mode, arm_mode):
        self.may_drive = self.robot.lifecycle is Lifecycle.ACTIVE
        self.call(
            lambda: self.robot.command(Command(wheels, arm, wheel_mode, arm_mode)),
            RobotError,
            ValueError,
        )

    @rule(wheels=st.lists(NUMBERS, min_size=3, max_size=5))
    def command_unchecked(self, wheels):
        """As by a command that somebody has made without its constructor."""
        self.may_drive = self.robot.lifecycle is Lifecycle.ACTIVE
        command = applied_command(np.array(wheels), np.zeros(4))
        if self.may_drive:
            self.call(lambda: self.robot.command(command), RobotError, ValueError)
        else:
            with pytest.raises(RobotError, match="not active"):
                self.robot.command(command)

    @rule()
    def deactivate(self):
        self.call(self.robot.deactivate, RobotError)

    @rule(cut=CUTS, dead=DEAD, unchecked=st.booleans())
    def stop_as_wires_are_cut(self, cut, dead, unchecked):
        self.drive(3)
        self.fail(cut, dead, b"")
        if unchecked:
            self.command_unchecked([np.nan] * 4)
        else:
            self.deactivate()

    @rule(cut=CUTS, dead=DEAD, noise=st.sampled_from([b"", b"\x80\x30\x00", None]))
    def fail(self, cut, dead, noise):
        """Let wires be cut or noisy, and a board be dead, until the next time."""
        wires = self.rig.wires
        wires.cut, wires.cut_at = set(cut), 0.0
        wires.disturb = lambda reply: reply[:-1] if noise is None else reply + noise
        for board in self.rig.boards:
            board.dead = board.address == dead

    @invariant()
    def nothing_drives_that_is_not_active(self):
        sent = [data for _, data in self.rig.link.sent[self.sent :]]
        self.sent = len(self.rig.link.sent)
        assert self.may_drive or not any(map(drives, sent))
        self.may_drive = False
        if self.robot.lifecycle in (Lifecycle.ERROR, Lifecycle.INACTIVE):
            with pytest.raises(LinkError, match="halted"):  # Nor do they for another thread.
                self.robot.boards.drive(np.full(8, 9000))
            assert not any(drives(data) for _, data in self.rig.link.sent[self.sent :])

    @invariant()
    def confirmed_is_zero(self):
        if self.robot.lifecycle is Lifecycle.ERROR:
            assert not self.rig.confirmed(self.robot.fault) & self.rig.driven()
        if self.robot.lifecycle is Lifecycle.INACTIVE:
            assert not self.rig.driven()


AnyCalls.TestCase.settings = settings(
    max_examples=40, stateful_step_count=30, deadline=None, derandomize=True
)
TestAnyCalls = AnyCalls.TestCase
TestAnyCalls.pytestmark = [pytest.mark.virtual_time]
