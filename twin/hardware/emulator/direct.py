"""Boards without wires: the same counts as the emulated ones, with nothing that could fail."""

from collections.abc import Mapping, Sequence

import numpy as np

from perception.geometry.arrays import IntArray
from twin.hardware.board_set import BoardState, StopReport
from twin.hardware.emulator.rover import EmulatedRover
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import Status
from twin.robot import Channel


class DirectBoards:
    """A `BoardSet` that reaches into the emulated rover: the simulation, quantised."""

    has_analogue = True
    has_wrench = True
    stereo_fault = ""

    def __init__(self, rover: EmulatedRover) -> None:
        """Power on: the encoders count from zero."""
        self._rover = rover
        self.has_stereo = rover.stereo().usable
        self._drive = rover.calibration.drive
        self.addresses = tuple(self._drive.boards)
        self._offset = -rover.counts()
        self._timeout = 0.0

    def configure(self) -> None:
        """Set the timeout, which nothing enforces here."""
        self._timeout = self._rover.calibration.limits.serial_timeout

    def encoders(self, address: int) -> tuple[int, int]:
        """Return both counters of a board."""
        counts = self._drive.at_board(address, self._rover.counts() + self._offset)
        one, two = (codec.signed_difference(count, 0) for count in counts.tolist())
        return one, two

    def set_encoder(self, axis: int, count: int) -> None:
        """Set the counter of an axis."""
        self._offset[axis] = count - self._rover.counts()[axis]

    def drive(self, codes: IntArray) -> None:
        """Set the duty codes of all axes."""
        self._rover.codes = codes.copy()

    def stop(self) -> StopReport:
        """Zero all axes."""
        self._rover.codes = np.zeros(8, dtype=np.int64)
        return StopReport(self.addresses)

    def keep_stopped(self) -> None:
        """Do nothing: a stop is always confirmed."""

    def resume(self) -> None:
        """Do nothing: there is no line that a stop would silence."""

    def analogue(self, pins: Sequence[int]) -> Mapping[int, int | None]:
        """Return the converter codes of analogue inputs."""
        return {pin: self._rover.analogue(pin) for pin in pins}

    def wrench(self) -> IntArray | None:
        """Return the force/torque sensor's counts (6,)."""
        return self._rover.wrench()

    def stereo(self, now: float) -> Channel | None:
        """Return the latest stereo pair, if there is one."""
        pair = self._rover.stereo()
        return pair if pair.usable else None

    def status(self, address: int) -> Status:
        """Return that all is well."""
        return Status.NORMAL

    def state(self, address: int) -> BoardState:
        """Return the state that a board would report."""
        one, two = self._drive.at_board(address, self._rover.currents).tolist()
        return BoardState(address, Status.NORMAL, self._rover.battery, (one, two), self._timeout)

    def reset_e_stop(self) -> None:
        """Do nothing: there is no e-stop."""

    def close(self) -> None:
        """Stop the motors."""
        self.stop()
