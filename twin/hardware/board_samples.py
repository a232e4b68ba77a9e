"""Counts of the boards, sampled in turn and kept with their age."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray
from twin.hardware.board_set import BoardSet
from twin.hardware.calibration.calibration import AngleSensor, Calibration
from twin.hardware.calibration.motors import START
from twin.hardware.roboclaw import codec
from twin.hardware.serial_link import LinkError
from twin.robot import MISSING, Channel, Observation, Validity

ARM = slice(4, 8)


@dataclasses.dataclass(frozen=True)
class SamplingConfig:
    """What makes a sample stale, or impossible.

    Attributes:
        encoder_age: Age limit of encoder values [s].
        tilt_age: Age limit of inclinometer and potentiometer, read every fourth cycle [s].
        wrench_age: Age limit of the wrench [s].
        stereo_age: Age limit of a stereo pair [s].
        most_speed: Largest speed of an output shaft [rad/s]; a higher counting rate is a jump.
    """

    encoder_age: float = 0.1
    tilt_age: float = 0.2
    wrench_age: float = 0.1
    stereo_age: float = 1.0
    most_speed: float = 30.0


@dataclasses.dataclass
class SamplingStatistics:
    """What was not there when it was asked for.

    Attributes:
        cycles: Times that the boards were sampled.
        lost_boards: Motor boards that did not answer.
        lost_analogue: Analogue inputs that were not read.
        lost_wrenches: Cycles without a new wrench.
    """

    cycles: int = 0
    lost_boards: int = 0
    lost_analogue: int = 0
    lost_wrenches: int = 0


class BoardSamples:
    """The latest sample of everything; one that is missed or impossible leaves the one before.

    Attributes:
        statistics: Counts of what was missed.
        lost: Number of consecutive cycles without an answer, by the motor boards' addresses.
        jumped: Axis whose counter jumped since `begin`; None if none did.
    """

    def __init__(
        self,
        boards: BoardSet,
        calibration: Calibration,
        clock: Callable[[], float],
        config: SamplingConfig,
    ) -> None:
        """Start without a sample.

        Args:
            boards: Boards that are sampled.
            calibration: Calibration of the robot.
            clock: Robot time [s].
            config: Ages.
        """
        self.statistics = SamplingStatistics()
        self.lost = dict.fromkeys(boards.addresses, 0)
        self.jumped: int | None = None
        self._boards = boards
        self._calibration = calibration
        self._clock = clock
        self._config = config
        tilt = calibration.inclinometer
        pair = [tilt.pitch.pin, tilt.roll.pin]
        centre = [calibration.analogue.centre.pin]
        # Pins by cycle: each is read every fourth time.
        self._turns: tuple[list[int], ...] = (pair, [], centre, [])
        self._raw: NDArray[np.int64] = np.zeros(8, dtype=np.int64)
        self._counts: NDArray[np.int64] = np.zeros(8, dtype=np.int64)
        self._count_rates = np.zeros(8)
        self._most_rates = config.most_speed * np.abs(calibration.drive.counts_per_radian)
        self._stamps = np.full(8, math.nan)
        self._codes: dict[int, tuple[int, float]] = {}
        self._wrench: tuple[FloatArray, float] | None = None
        self._stereo = MISSING

    @property
    def silence(self) -> float:
        """For how long the boards that do not answer have been silent, at most [s]."""
        now, axes = self._clock(), self._calibration.drive.axes
        stamps = [self._stamps[axis] for axis, place in enumerate(axes) if self.lost[place.address]]
        return max((now - float(stamp) for stamp in stamps), default=0.0)

    def begin(self) -> None:
        """Read everything, and count from here.

        Raises:
            LinkError: If a motor board does not answer.
        """
        self.lost = dict.fromkeys(self.lost, 0)
        self.jumped = None
        for address in self._boards.addresses:
            self._start(address, self._boards.encoders(address))
        self._read_analogue([pin for turn in self._turns for pin in turn])
        self._read_wrench()
        self._stereo = self._boards.stereo(self._clock()) or self._stereo

    def sample(self, patience: float) -> None:
        """Read what is due in this cycle; what does not answer is counted.

        Args:
            patience: Silence of a board after which no other board is asked in this cycle [s].
        """
        for address in self._boards.addresses:
            try:
                pair = self._boards.encoders(address)
            except LinkError:
                self.lost[address] += 1
                self.statistics.lost_boards += 1
                if self.silence > patience:
                    break
            else:
                self.lost[address] = 0
                self._take(address, pair)
        self._read_analogue(self._turns[self.statistics.cycles % len(self._turns)])
        self._read_wrench()
        self._stereo = self._boards.stereo(self._clock()) or self._stereo
        self.statistics.cycles += 1

    def arm_counts(self) -> NDArray[np.int64]:
        """Return the arm's counters (4,) as they were read last."""
        return self._raw[ARM].copy()

    def observation(self, homed: bool) -> Observation:
        """Return the latest samples, each with what it is worth now.

        Args:
            homed: Whether the arm's counters mean angles.
        """
        config, tilt = self._config, self._calibration.inclinometer
        drive = self._calibration.drive
        angles, rates = drive.angles(self._counts), drive.rates(self._count_rates)
        wheels, arm = float(self._stamps[:4].min()), float(self._stamps[ARM].min())
        wrench = MISSING
        if self._wrench is not None:
            wrench = self._aged(*self._wrench, config.wrench_age)
        stereo = self._stereo
        if stereo is not MISSING:
            stereo = stereo._replace(validity=self._validity(stereo.stamp, config.stereo_age))
        return Observation(
            time=self._clock(),
            wheel_speeds=self._aged(rates[:4], wheels, config.encoder_age),
            centre_angle=self._angles(self._calibration.analogue.centre),
            arm_angles=self._aged(angles[ARM], arm, config.encoder_age) if homed else MISSING,
            arm_rates=self._aged(rates[ARM], arm, config.encoder_age),
            inclinometer=self._angles(tilt.pitch, tilt.roll),
            arm_base_wrench=wrench,
            stereo=stereo,
        )

    def _start(self, address: int, pair: tuple[int, int]) -> None:
        """Count from a board's counters on."""
        for axis, raw in zip(self._calibration.drive.boards[address], pair, strict=True):
            if axis >= 0:
                # As near to the start as it can be: the counter may stand just beyond a wrap.
                self._counts[axis] = START + codec.signed_difference(raw, START)
                self._count_rates[axis] = 0.0
                self._raw[axis], self._stamps[axis] = raw, self._clock()

    def _take(self, address: int, pair: tuple[int, int]) -> None:
        """Take a board's counters, of which only the change counts: they wrap.

        A pair of which one jumps, as after a reset of the board, is not believed.
        """
        now = self._clock()
        places = zip(self._calibration.drive.boards[address], pair, strict=True)
        found = [(axis, raw) for axis, raw in places if axis >= 0]
        steps = [codec.signed_difference(raw, int(self._raw[axis])) for axis, raw in found]
        for (axis, _), step in zip(found, steps, strict=True):
            if abs(step) > self._most_rates[axis] * (now - self._stamps[axis]):
                self.jumped = axis
                return
        for (axis, raw), step in zip(found, steps, strict=True):
            if now > self._stamps[axis]:
                self._counts[axis] += step
                self._count_rates[axis] = step / (now - self._stamps[axis])
            self._raw[axis], self._stamps[axis] = raw, now

    def _read_analogue(self, pins: list[int]) -> None:
        if not (pins and self._boards.has_analogue):
            return
        for pin, code in self._boards.analogue(pins).items():
            if code is None:
                self.statistics.lost_analogue += 1
            else:
                self._codes[pin] = code, self._clock()

    def _read_wrench(self) -> None:
        if not self._boards.has_wrench:
            return
        counts = self._boards.wrench()
        if counts is None:
            self.statistics.lost_wrenches += 1
        else:
            self._wrench = self._calibration.force_torque.wrench(counts), self._clock()

    def _angles(self, *sensors: AngleSensor) -> Channel:
        """Return the angles of analogue sensors, as old as the oldest; missing if one is."""
        found = [self._codes.get(sensor.pin) for sensor in sensors]
        known = [sample for sample in found if sample is not None]
        if len(known) < len(sensors):
            return MISSING
        board = self._calibration.analogue
        pairs = zip(sensors, known, strict=True)
        angles = [float(sensor.angle(board.volts(code))) for sensor, (code, _) in pairs]
        return self._aged(np.array(angles), min(stamp for _, stamp in known), self._config.tilt_age)

    def _aged(self, values: NDArray[np.generic], stamp: float, age: float) -> Channel:
        if math.isnan(stamp):
            return MISSING
        values.flags.writeable = False
        return Channel(values, stamp, self._validity(stamp, age))

    def _validity(self, stamp: float, age: float) -> Validity:
        stale = self._clock() - stamp > age + 1e-9
        return Validity.STALE if stale else Validity.MEASURED
