"""The robot contract on top of motor boards, an analogue board and a force/torque sensor."""

import dataclasses
import itertools
import logging
import math
import threading
import time
from collections.abc import Callable

import numpy as np

from perception.geometry.arrays import FloatArray, IntArray
from twin.description import RobotDescription
from twin.hardware.board_samples import BoardSamples, SamplingConfig, SamplingStatistics
from twin.hardware.board_set import BoardSet, StopReport
from twin.hardware.calibration.calibration import Calibration
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import Status
from twin.hardware.serial_link import LinkError, at_rest
from twin.robot import (
    AXES,
    NOTHING,
    ArmMode,
    Command,
    Lifecycle,
    Observation,
    RobotError,
    applied_command,
)
from twin.servo import Servo, ServoConfig

_LOG = logging.getLogger(__name__)
# The boards do not stop on a battery voltage warning; the robot does.
_STOPPING = Status(0xFFFF) | Status.MAIN_VOLTAGE_LOW_WARNING | Status.MAIN_VOLTAGE_HIGH_WARNING
_END_GAIN = 8.0
"""Rate at which a joint may approach the end of its range, per distance [1/s]."""
_STILL = 2
"""Largest change of the counter of an axis at rest between two readings [counts]."""


@dataclasses.dataclass(frozen=True)
class BoardRobotConfig:
    """Timing and fault limits of a robot.

    Attributes:
        sampling: Age limits of the samples.
        period: Servo tick [s].
        lost_cycles: Number of consecutive cycles without an answer from a motor board after which
            the robot stops.
        lost_time: Time without an answer from a motor board after which the robot stops [s]. A
            silent board delays the others, so that a cycle may take many periods.
        watchdog: Longest time between two commands while the robot is ACTIVE [s].
        settling: Longest wait for a sensor's first sample or an arm that still moves, at rest [s].
    """

    sampling: SamplingConfig = SamplingConfig()
    period: float = 0.01
    lost_cycles: int = 3
    lost_time: float = 0.1
    watchdog: float = 0.15
    settling: float = 1.0


class BoardRobot:
    """Supervises the boards of a robot: limits the commands and stops all axes on a fault.

    Attributes:
        name: Name of the robot.
        description: Nominal description of the robot.
        boards: Boards of the robot.
        calibration: Constants of the boards.
        fault: Reason for the state ERROR, and what is known of the stop; empty in the other states.
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
        """Initialize from open boards; nothing is sent before `configure`.

        Args:
            description: Nominal description of the robot, with four wheels and four arm joints.
            boards: Boards of the robot.
            calibration: Constants of the boards.
            clock: Returns the robot time [s].
            config: Timing and fault limits.
        """
        self.name, self.description = description.name, description
        self.boards = boards
        self.calibration = calibration
        self.fault = ""
        self.seconds = 0.0
        self._config = config or BoardRobotConfig()
        self._clock = clock
        self._samples = BoardSamples(boards, calibration, clock, self._config.sampling)
        gains = ServoConfig.of(description)
        self._servo = Servo(gains, self._config.period)
        # What would hold each joint at either end of its range.
        slow = dataclasses.replace(gains, position_gain=_END_GAIN)
        self._ends = [
            (Servo(slow, self._config.period), end, limit)
            for end, limit in zip(calibration.drive.ranges.T, (np.maximum, np.minimum), strict=True)
        ]
        self._lifecycle = Lifecycle.UNCONFIGURED
        self._homed = False
        self._unheard = 0
        # The watchdog runs in another thread.
        self._lock = threading.RLock()
        self._sampled = self._commanded = -math.inf
        self._observation = Observation(clock())

    @property
    def lifecycle(self) -> Lifecycle:
        """Current lifecycle state."""
        return self._lifecycle

    @property
    def statistics(self) -> SamplingStatistics:
        """Counts of cycles, lost samples and silent boards."""
        return self._samples.statistics

    def configure(self) -> None:
        """Stop all axes, set the boards up, take the first sample and go to INACTIVE.

        Raises:
            RobotError: If a motor board does not answer; all boards were sent zero duty.
        """
        with self._lock:
            self._homed = False
            self._lifecycle = Lifecycle.UNCONFIGURED
            try:
                at_rest(self._set_up)
            except LinkError as error:
                raise RobotError(f"robot {self.name!r}: {error}; {self._stop()}") from error
            self._warm()
            self._lifecycle = Lifecycle.INACTIVE

    def home(self, angles: FloatArray) -> None:
        """Set the arm encoders to known joint angles; they count from power-on.

        Args:
            angles: (4,) joint angles of the arm at rest in its jig [rad].

        Raises:
            RobotError: If the robot is unconfigured or ACTIVE, the arm moves, or a board is silent.
        """
        with self._lock:
            if self._lifecycle in (Lifecycle.UNCONFIGURED, Lifecycle.ACTIVE):
                raise RobotError(
                    f"robot {self.name!r} is {self._lifecycle.value}; home it when it is inactive"
                )
            try:
                at_rest(lambda: self._settled(lambda: self._set_counters(angles)))
            except LinkError as error:
                raise RobotError(f"robot {self.name!r}: {error}") from error

    def activate(self) -> None:
        """Go to ACTIVE from INACTIVE or ERROR.

        Raises:
            RobotError: If the robot is not configured or homed, or a board or sensor has a fault.
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
            self._unheard = 0
            self.fault = ""
            self.boards.resume()
            self._commanded = self._clock()
            self._lifecycle = Lifecycle.ACTIVE

    def observe(self) -> Observation:
        """Return the latest observation; the boards are read once per servo tick.

        After a stop that a board did not confirm, no motor board is read: its samples turn stale.

        Raises:
            RobotError: If the robot is not configured.
        """
        with self._lock:
            if self._lifecycle is Lifecycle.UNCONFIGURED:
                raise RobotError(f"robot {self.name!r} is unconfigured; it cannot be read")
            if self._clock() - self._sampled > 0.5 * self._config.period:
                begin = time.perf_counter()
                self._sampled = self._clock()
                self._samples.sample(self._config.lost_time)
                self._observation = self._samples.observation(self._homed)
                self._judge()
                self.seconds += time.perf_counter() - begin
            return self._observation

    def command(self, command: Command) -> Command:
        """Apply a command until the next one, and return the limited duties that were sent.

        Whatever is raised while the robot is ACTIVE, it is stopped first and in ERROR.

        Args:
            command: Requested efforts, speeds or positions.

        Raises:
            RobotError: If the robot is not ACTIVE, the command is too late, a channel that the mode
                needs is not usable, or a board is silent.
            ValueError: If the command has another number of axes than the robot.
        """
        with self._lock:
            self.guard()
            if self._lifecycle is not Lifecycle.ACTIVE:
                reason = f": {self.fault}" if self.fault else ""
                raise RobotError(
                    f"robot {self.name!r} is {self._lifecycle.value}, not active{reason}"
                )
            begin = time.perf_counter()
            # Not the end: a pause of the process amid the call must not go unnoticed.
            self._commanded = self._clock()
            try:
                codes = self._send(command)
            except RobotError as error:
                raise self._fail(str(error)) from error
            except BaseException as error:
                self._fail(f"{type(error).__name__}: {error}")
                raise
            self.seconds += time.perf_counter() - begin
            applied = self.calibration.drive.duties(codes)
            return applied_command(applied[:4], applied[4:])

    def _send(self, command: Command) -> IntArray:
        """Send the duties that a command asks for, and return their codes (8,)."""
        duty = self._within_range(self._servo.duty(command, self._observation))
        codes = self.calibration.drive.duty_codes(duty)
        try:
            self.boards.drive(codes)
            self._unheard = 0
        except LinkError as error:
            # A few cycles without an answer are tolerated; the encoders of this one were read.
            self._unheard += 1
            cycles = max(self._unheard, 1 + max(self._samples.lost.values()))
            if cycles >= self._config.lost_cycles or self._lost_for_long():
                raise RobotError(str(error)) from error
            self.statistics.lost_boards += 1
        return codes

    def deactivate(self) -> None:
        """Stop all axes and go to INACTIVE; ERROR persists until `activate`.

        Raises:
            RobotError: If a board does not confirm; the robot is in ERROR.
        """
        with self._lock:
            if self._lifecycle in (Lifecycle.UNCONFIGURED, Lifecycle.ERROR):
                return
            report = self._stop()
            if not report.complete:
                report = self._stop()  # It is not urgent any more: a slow answer may come.
            if not report.complete:
                raise self._enter_error("not all boards answer", report)
            self._lifecycle = Lifecycle.INACTIVE

    def close(self) -> None:
        """Stop all axes, and close the ports; what no board confirmed is logged as a warning."""
        with self._lock:
            if self._lifecycle in (Lifecycle.INACTIVE, Lifecycle.ACTIVE):
                report = self._stop()
                if not report.complete:
                    _LOG.warning("robot %r is closed; %s", self.name, report)
            self._lifecycle = Lifecycle.UNCONFIGURED
            self.boards.close()

    def guard(self) -> None:
        """Go to ERROR if ACTIVE and the last command is too old; called by the watchdog thread.

        The zeros of a stop that is not confirmed are repeated.
        """
        with self._lock:
            self.boards.keep_stopped()
            late = self._clock() - self._commanded
            if self._lifecycle is Lifecycle.ACTIVE and late > self._config.watchdog:
                self._fail(f"no command for {late:.2f} s")

    def _set_up(self) -> None:
        self._zero()
        self.boards.configure()
        self._count(range(8), np.zeros(8))
        self._begin()

    def _set_counters(self, angles: FloatArray) -> None:
        self._begin()
        before = self._samples.arm_counts()
        self._begin()
        if np.any(np.abs(self._samples.arm_counts() - before) > _STILL):
            raise RobotError(f"robot {self.name!r}: the arm moves; hold it still to home")
        # The counters are angles only once all of them are set.
        self._homed = False
        self._count(range(4, 8), np.concatenate([np.zeros(4), angles]))
        self._homed = True
        self._begin()

    def _count(self, axes: range, angles: FloatArray) -> None:
        """Let the counters of some axes stand for their angles, of all (8,) [rad]."""
        counts = self.calibration.drive.counts(angles)
        for axis in axes:
            self.boards.set_encoder(axis, codec.signed_difference(int(counts[axis]), 0))

    def _wake(self) -> None:
        self._zero()
        self.boards.reset_e_stop()
        self._settled(self._begin_with_sensors)
        # Last: a board that is reset from here on is seen by its counters.
        for address in self.boards.addresses:
            self._check_board(address)

    def _settled(self, step: Callable[[], None]) -> None:
        """Take a step at rest, again while it raises a RobotError and waiting may help."""
        end = self._clock() + self._config.settling
        while True:
            try:
                return step()
            except RobotError:
                before = self._clock()
                time.sleep(self._config.period)
                # A clock that stands still is advanced by who called.
                if not before < self._clock() < end:
                    raise

    def _begin_with_sensors(self) -> None:
        self._begin()
        self._check_sensors()

    def _begin(self) -> None:
        self._samples.begin()
        self._sampled = self._clock()
        self._observation = self._samples.observation(self._homed)

    def _warm(self) -> None:
        """Load the code of all servo modes: half a second, too long for a cycle while driving."""
        for wheels, arm, rates in itertools.product((NOTHING, np.zeros(4)), repeat=3):
            self._servo.duty(Command(wheels, arm, arm_rates=rates), self._observation)
        self._servo.reset()

    def _judge(self) -> None:
        """Check boards, counters and sensors; go to ERROR on a fault."""
        self.guard()
        jumped = self._samples.jumped
        if jumped is not None:
            self._homed = False
        if self._lifecycle is not Lifecycle.ACTIVE:
            return
        most = 1 if self._lost_for_long() else self._config.lost_cycles
        lost = [a for a, n in self._samples.lost.items() if n >= most]
        try:
            if lost:
                raise RobotError(f"motor board {lost[0]:#x} is silent")
            if jumped is not None:
                raise RobotError(
                    f"the counter of {AXES[jumped]} jumped, as after a reset of its board; "
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
        """Raise a RobotError if the channel of a fitted sensor is not usable."""
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
        """Read the status of one board in turn, and once a round the whole state of one board."""
        boards = self.boards.addresses
        turn, place = divmod(self.statistics.cycles, len(boards))
        address = boards[place]
        if place == turn % len(boards) or self.boards.status(address) & _STOPPING:
            self._check_board(address)

    def _check_board(self, address: int) -> None:
        """Raise a RobotError if a board has a fault, a LinkError if it is silent."""
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
        """Limit the duty of each joint to what brakes it before the end of its range."""
        angles, rates = self._observation.arm_angles, self._observation.arm_rates
        if not (angles.usable and rates.usable):
            return duty
        for servo, end, limit in self._ends:
            held = Command(arm=end, arm_mode=ArmMode.POSITION)
            limited = limit(duty, servo.duty(held, self._observation))
            limited[:4] = duty[:4]
            # Only what limits is integrated.
            servo.restore(np.where(limited == duty, 0.0, servo.save()))
            duty = limited
        return duty

    def _fail(self, reason: str) -> RobotError:
        """Stop all axes, go to ERROR, and return the error to raise."""
        return self._enter_error(reason, self._stop())

    def _enter_error(self, reason: str, report: StopReport) -> RobotError:
        self._lifecycle = Lifecycle.ERROR
        self.fault = f"{reason}; {report}"
        return RobotError(f"robot {self.name!r}: {self.fault}")

    def _zero(self) -> None:
        """Stop all axes of a robot at rest, and raise a LinkError unless all boards confirm."""
        self.boards.resume()
        report = self._stop()
        if not report.complete:
            raise LinkError("a motor board does not confirm zero duty")

    def _stop(self) -> StopReport:
        for servo in (self._servo, *(servo for servo, _, _ in self._ends)):
            servo.reset()
        return self.boards.stop()
