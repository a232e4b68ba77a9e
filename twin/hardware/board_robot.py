"""A robot of the contract over motor boards, an analogue board and a force/torque sensor."""

import dataclasses
import itertools
import math
import threading
import time
from collections.abc import Callable

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription
from twin.hardware.board_samples import BoardSamples, SamplingConfig, SamplingStatistics
from twin.hardware.board_set import BoardSet
from twin.hardware.calibration.calibration import Calibration
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import Status
from twin.hardware.serial_link import LinkError, at_rest
from twin.robot import AXES, NOTHING, Command, Lifecycle, Observation, RobotError
from twin.servo import Servo, ServoConfig

# The boards themselves do not stop for a battery that is low or high; the robot does.
_STOPPING = Status(0xFFFF) | Status.MAIN_VOLTAGE_LOW_WARNING | Status.MAIN_VOLTAGE_HIGH_WARNING
_STILL = 2
"""Counts by which an axis at rest may differ from one reading to the next."""


@dataclasses.dataclass(frozen=True)
class BoardRobotConfig:
    """How patient the robot is.

    Attributes:
        sampling: Ages of the samples.
        period: Servo tick [s].
        lost_cycles: Consecutive cycles without a motor board after which the robot stops.
        lost_time: Time without a motor board after which it stops [s]: one that is silent holds
            the others up, until a cycle takes many periods.
        watchdog: Longest time between two commands while it drives [s].
        most_speed: Fastest that an output shaft can turn [rad/s]; a faster count is a jump.
    """

    sampling: SamplingConfig = SamplingConfig()
    period: float = 0.01
    lost_cycles: int = 3
    lost_time: float = 0.1
    watchdog: float = 0.15
    most_speed: float = 30.0


class BoardRobot:
    """Watches, limits and stops; boards, samples and servo do the rest.

    Attributes:
        name: Name of the robot, as controllers see it.
        description: The robot as drawn.
        boards: Boards of the robot.
        calibration: Constants of the boards.
        fault: Why it is in ERROR; empty otherwise.
        seconds: Wall time spent in `observe` and `command` so far [s].
    """

    def __init__(
        self,
        description: RobotDescription,
        boards: BoardSet,
        calibration: Calibration,
        clock: Callable[[], float],
        config: BoardRobotConfig | None = None,
    ) -> None:
        """Take over open boards; nothing is sent before `configure`.

        Args:
            description: The robot as drawn, with four wheels and four arm joints, as the boards.
            boards: Boards of the robot.
            calibration: Constants of the boards.
            clock: Robot time [s].
            config: Time limits and age limits of the robot.
        """
        self.name, self.description = description.name, description
        self.boards = boards
        self.calibration = calibration
        self.fault = ""
        self.seconds = 0.0
        self._config = config or BoardRobotConfig()
        self._clock = clock
        self._samples = BoardSamples(boards, calibration, clock, self._config.sampling)
        self._servo = Servo(ServoConfig.of(description), self._config.period)
        self._lifecycle = Lifecycle.UNCONFIGURED
        self._homed = False
        # Whether the boards acknowledged the zeros they were last sent.
        self._zeroed = True
        self._unheard = 0
        # The watchdog calls from another thread.
        self._lock = threading.RLock()
        self._sampled = self._commanded = -math.inf
        self._observation = Observation(clock())

    @property
    def lifecycle(self) -> Lifecycle:
        """Current state."""
        return self._lifecycle

    @property
    def statistics(self) -> SamplingStatistics:
        """What was not there when it was asked for."""
        return self._samples.statistics

    def configure(self) -> None:
        """Set the boards up, stop all axes, take the first sample and go to INACTIVE.

        Raises:
            RobotError: If a motor board does not answer.
        """
        with self._lock:
            self._homed = False
            self._lifecycle = Lifecycle.UNCONFIGURED
            try:
                at_rest(self._set_up)
            except LinkError as error:
                raise RobotError(f"robot {self.name!r}: {error}") from error
            self._warm()
            self._lifecycle = Lifecycle.INACTIVE

    def home(self, angles: FloatArray) -> None:
        """Tell the robot where its arm is: its encoders count from power-on.

        Args:
            angles: (4,) joint angles of the arm at rest in its jig [rad].

        Raises:
            RobotError: If the robot drives, the arm moves, or a board does not answer.
        """
        with self._lock:
            if self._lifecycle in (Lifecycle.UNCONFIGURED, Lifecycle.ACTIVE):
                raise RobotError(
                    f"robot {self.name!r} is {self._lifecycle.value}; home it when it is inactive"
                )
            try:
                at_rest(lambda: self._set_counters(angles))
            except LinkError as error:
                raise RobotError(f"robot {self.name!r}: {error}") from error

    def activate(self) -> None:
        """Go to ACTIVE, from INACTIVE or, explicitly, from ERROR.

        Raises:
            RobotError: If the robot is not configured or homed, or a board or sensor is not well.
        """
        with self._lock:
            if self._lifecycle is Lifecycle.ACTIVE:
                return
            if self._lifecycle is Lifecycle.UNCONFIGURED:
                raise RobotError(f"robot {self.name!r} is unconfigured; it cannot be activated")
            if not self._homed:
                raise RobotError(
                    f"robot {self.name!r} does not know where its arm is: put it in its jig and "
                    "home it (home=YAW:SHOULDER:ELBOW:WRIST [rad] after serial:PORT)"
                )
            try:
                at_rest(self._wake)
            except (LinkError, RobotError) as error:
                raise self._fail(str(error)) from error
            self._servo.reset()
            self._unheard = 0
            self.fault = ""
            self._commanded = self._clock()
            self._lifecycle = Lifecycle.ACTIVE

    def observe(self) -> Observation:
        """Return what the boards say; they are asked once a servo tick.

        Raises:
            RobotError: If the robot is not configured.
        """
        with self._lock:
            if self._lifecycle is Lifecycle.UNCONFIGURED:
                raise RobotError(f"robot {self.name!r} is unconfigured; it cannot be read")
            if self._clock() - self._sampled > 0.5 * self._config.period:
                begin = time.perf_counter()
                self._sampled = self._clock()
                self._samples.sample()
                self._observation = self._samples.observation(self._homed)
                self._judge()
                self.seconds += time.perf_counter() - begin
            return self._observation

    def command(self, command: Command) -> Command:
        """Drive until the next command, and return what is applied, as duty, after limits.

        Args:
            command: Requested efforts, speeds or positions.

        Raises:
            RobotError: If the robot is not ACTIVE, a channel that the mode needs is not usable, or
                a board is silent; then it is in ERROR and all axes are zeroed.
            ValueError: If a duty comes to no number; all axes are zeroed.
        """
        with self._lock:
            if self._lifecycle is not Lifecycle.ACTIVE:
                reason = f": {self.fault}" if self.fault else ""
                raise RobotError(
                    f"robot {self.name!r} is {self._lifecycle.value}, not active{reason}"
                )
            begin = time.perf_counter()
            try:
                duty = self._within_range(self._servo.duty(command, self._observation))
            except RobotError as error:
                raise self._fail(str(error)) from error
            except ValueError:
                self._stop()
                raise
            codes = self.calibration.drive.duty_codes(duty)
            try:
                self.boards.drive(codes)
                self._unheard = 0
            except LinkError as error:
                # Few cycles without an answer are borne; this one's encoders were read before.
                self._unheard += 1
                cycles = max(self._unheard, 1 + max(self._samples.lost.values()))
                if cycles >= self._config.lost_cycles or self._lost_for_long():
                    raise self._fail(str(error)) from error
                self.statistics.lost_boards += 1
            self._commanded = self._clock()
            self.seconds += time.perf_counter() - begin
            applied = self.calibration.drive.duties(codes)
            return Command(applied[:4], applied[4:])

    def deactivate(self) -> None:
        """Zero all axes and go to INACTIVE; an ERROR stays until `activate` ends it.

        Raises:
            RobotError: If a board does not acknowledge; its own timeout stops it then.
        """
        with self._lock:
            if self._lifecycle is Lifecycle.UNCONFIGURED:
                return
            self._servo.reset()
            try:
                self._zero()
            except LinkError as error:
                raise self._fail(str(error)) from error
            if self._lifecycle is Lifecycle.ACTIVE:
                self._lifecycle = Lifecycle.INACTIVE

    def close(self) -> None:
        """Zero all axes as far as they can be reached, and close the ports."""
        with self._lock:
            if self._lifecycle is not Lifecycle.UNCONFIGURED:
                self._stop()
            self._lifecycle = Lifecycle.UNCONFIGURED
            self.boards.close()

    def guard(self) -> None:
        """Stop a robot that drives and has not been commanded in time; a watchdog calls it."""
        with self._lock:
            late = self._clock() - self._commanded
            if self._lifecycle is Lifecycle.ACTIVE and late > self._config.watchdog:
                self._fail(f"no command for {late:.2f} s")

    def _set_up(self) -> None:
        self.boards.configure()
        self._zero()
        self._begin()

    def _set_counters(self, angles: FloatArray) -> None:
        self._begin()
        before = self._samples.arm_counts()
        self._begin()
        if np.any(np.abs(self._samples.arm_counts() - before) > _STILL):
            raise RobotError(f"robot {self.name!r}: the arm moves; hold it still to home")
        counts = self.calibration.drive.counts(np.concatenate([np.zeros(4), angles]))
        # Until all counters are set, none of them means an angle.
        self._homed = False
        for axis in range(4, 8):
            self.boards.set_encoder(axis, codec.signed_difference(int(counts[axis]), 0))
        self._homed = True
        self._begin()

    def _wake(self) -> None:
        self.boards.reset_e_stop()
        self._zero()
        for address in self.boards.addresses:
            self._check_board(address)
        self._begin()
        self._check_sensors()

    def _begin(self) -> None:
        self._samples.begin()
        self._sampled = self._clock()
        self._observation = self._samples.observation(self._homed)

    def _warm(self) -> None:
        """Load the servo's code for all kinds of arrays: half a second, too long while driving."""
        for wheels, arm, rates in itertools.product((NOTHING, np.zeros(4)), repeat=3):
            self._servo.duty(Command(wheels, arm, arm_rates=rates), self._observation)
        self._servo.reset()

    def _judge(self) -> None:
        """Stop for what must not go on."""
        self.guard()
        if self._lifecycle is Lifecycle.ERROR and not self._zeroed:
            # A board that hears questions again does not time out any more.
            self._stop()
        if self._lifecycle is not Lifecycle.ACTIVE:
            return
        most = 1 if self._lost_for_long() else self._config.lost_cycles
        lost = [a for a, n in self._samples.lost.items() if n >= most]
        jumped = np.flatnonzero(np.abs(self._samples.rates) > self._config.most_speed)
        try:
            if lost:
                raise RobotError(f"motor board {lost[0]:#x} is silent")
            if jumped.size:
                self._homed = False
                raise RobotError(
                    f"the counter of {AXES[jumped[0]]} jumped, as after a reset of its board; "
                    "home the robot"
                )
            self._check_sensors()
            self._check_in_turn()
        except LinkError:
            self.statistics.lost_boards += 1
        except RobotError as error:
            self._fail(str(error))

    def _lost_for_long(self) -> bool:
        return self._samples.silence > self._config.lost_time

    def _check_sensors(self) -> None:
        """Raise a RobotError if a sensor that the robot has cannot be believed."""
        needed = {
            "inclinometer": self.boards.has_analogue,
            "arm_base_wrench": self.boards.has_wrench,
            "stereo": self.boards.has_stereo,
        }
        for name, present in needed.items():
            channel = getattr(self._observation, name)
            if present and not channel.usable:
                why = self.boards.stereo_fault if name == "stereo" else ""
                raise RobotError(f"{name} is {channel.validity.value}" + (why and f" ({why})"))

    def _check_in_turn(self) -> None:
        """Ask one board for its status; once a round, another one, for all it says of itself."""
        boards = self.boards.addresses
        turn, place = divmod(self.statistics.cycles, len(boards))
        address = boards[place]
        if place == turn % len(boards) or self.boards.status(address) & _STOPPING:
            self._check_board(address)

    def _check_board(self, address: int) -> None:
        """Raise a RobotError if a board must not drive, a LinkError if it is silent."""
        state, limits = self.boards.state(address), self.calibration.limits
        if not math.isclose(state.timeout, limits.serial_timeout, abs_tol=1e-6):
            self._homed = False
            raise RobotError(f"motor board {address:#x} was reset; configure and home the robot")
        if state.status & _STOPPING:
            named = (state.status & _STOPPING).name or hex(state.status)
            raise RobotError(f"motor board {address:#x} reports {named.lower()}")
        if not limits.least_battery <= state.battery <= limits.most_battery:
            raise RobotError(f"motor board {address:#x} has a battery of {state.battery:.1f} V")

    def _within_range(self, duty: FloatArray) -> FloatArray:
        """Take away the duty that drives a joint on beyond its range."""
        angles = self._observation.arm_angles
        if not angles.usable:
            return duty
        lower, upper = self.calibration.drive.ranges.T
        arm = np.where(angles.value <= lower, np.maximum(duty[4:], 0.0), duty[4:])
        arm = np.where(angles.value >= upper, np.minimum(arm, 0.0), arm)
        return np.concatenate([duty[:4], arm])

    def _fail(self, reason: str) -> RobotError:
        """Zero all axes, go to ERROR, and return the error to raise."""
        self._stop()
        self._lifecycle = Lifecycle.ERROR
        self.fault = reason
        return RobotError(f"robot {self.name!r}: {reason}; all axes are zeroed")

    def _zero(self) -> None:
        self._zeroed = False
        self.boards.drive(np.zeros(8, dtype=np.int64))
        self._zeroed = True

    def _stop(self) -> None:
        self._servo.reset()
        try:
            self._zero()
        except LinkError:
            # What cannot be reached stops by its own timeout.
            self.statistics.lost_boards += 1
