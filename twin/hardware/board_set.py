"""All boards of one robot as one device, and the implementation on real hardware links."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from perception.geometry.arrays import IntArray
from twin.hardware.analogue.firmata import AnalogueBoard
from twin.hardware.calibration.calibration import Calibration
from twin.hardware.cameras.camera import StereoCapture
from twin.hardware.force_torque.net_ft import NetForceTorque
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.client import RoboClawBus
from twin.hardware.roboclaw.codec import BoardCommand, Status
from twin.hardware.serial_link import LinkError
from twin.robot import Channel

_CURRENT_UNIT = 0.01  # [A]
_VOLTAGE_UNIT = 0.1  # [V]
_TIMEOUT_UNIT = 0.1  # [s]
_SET_ENCODER = {1: BoardCommand.SET_ENCODER_1, 2: BoardCommand.SET_ENCODER_2}  # Keys: channels.
_SET_LIMIT = {1: BoardCommand.SET_CURRENT_LIMIT_1, 2: BoardCommand.SET_CURRENT_LIMIT_2}
_GET_LIMIT = {1: BoardCommand.GET_CURRENT_LIMIT_1, 2: BoardCommand.GET_CURRENT_LIMIT_2}


@dataclasses.dataclass(frozen=True)
class BoardState:
    """State that one motor board reports.

    Attributes:
        address: Address on the bus.
        status: Errors and warnings.
        battery: Main voltage [V].
        currents: Currents of both motors [A].
        timeout: Serial timeout [s]; 0 after a reset.
    """

    address: int
    status: Status
    battery: float
    currents: tuple[float, float]
    timeout: float


@dataclasses.dataclass(frozen=True)
class StopReport:
    """What is known of the motor boards after a stop.

    Attributes:
        confirmed: Addresses of the boards that answered with zero duty.
        sent: Addresses of the boards to which zero duty was sent without an answer.
        unreached: Addresses of the boards whose port took nothing.
        timeout: Serial timeout that stops boards by themselves [s]; 0 if it is not known to be set.
    """

    confirmed: tuple[int, ...]
    sent: tuple[int, ...] = ()
    unreached: tuple[int, ...] = ()
    timeout: float = 0.0

    @property
    def complete(self) -> bool:
        """True when all boards confirmed zero duty."""
        return not (self.sent or self.unreached)

    def __str__(self) -> str:
        """Say it in words, for people."""
        groups = (
            (self.confirmed, "zero confirmed"),
            (self.sent, "sent, not answered"),
            (self.unreached, "not reached"),
        )
        parts = [f"{', '.join(map(hex, group))}: {words}" for group, words in groups if group]
        if not self.complete:
            several = len(self.sent + self.unreached) > 1
            own = "stop by their own" if several else "stops by its own"
            own += f" timeout of {1e3 * self.timeout:.0f} ms"
            parts.append(own if self.timeout else "no timeout is set; cut the motors' power")
        return f"boards {'; '.join(parts)}"


class BoardSet(Protocol):
    """Interface of the boards to `BoardRobot`; axes are in the order of `twin.robot.AXES`.

    Attributes:
        addresses: Addresses of the motor boards.
        has_analogue: Whether the robot has an inclinometer and a potentiometer.
        has_wrench: Whether the robot has a force/torque sensor.
        has_stereo: Whether the robot has a stereo head.
        stereo_fault: Error of the last call of `stereo`; empty if there merely was no new pair.
    """

    addresses: tuple[int, ...]
    has_analogue: bool
    has_wrench: bool
    has_stereo: bool
    stereo_fault: str

    def configure(self) -> None:
        """Set timeouts and current limits.

        Raises:
            LinkError: If a board does not answer.
        """

    def encoders(self, address: int) -> tuple[int, int]:
        """Return both counters of a board, signed 32 bits.

        Raises:
            LinkError: If the board does not answer.
        """
        ...

    def set_encoder(self, axis: int, count: int) -> None:
        """Set the counter of an axis at rest.

        Raises:
            LinkError: If the board does not confirm it.
        """

    def drive(self, codes: IntArray) -> None:
        """Set the duty codes (8,) of all axes.

        Raises:
            LinkError: If a board does not acknowledge, or after a stop; the other boards are
                commanded nevertheless.
        """

    def stop(self) -> StopReport:
        """Zero all axes, whether or not a board answers; then nothing drives before `resume`.

        Unless all boards confirm, nothing but zeros by `keep_stopped` is sent to them.
        """
        ...

    def keep_stopped(self) -> None:
        """Repeat the zeros of a stop that is not confirmed, for longer than the boards' timeout."""

    def resume(self) -> None:
        """Allow to drive after a stop, once boards that did not confirm it have stopped."""

    def analogue(self, pins: Sequence[int]) -> Mapping[int, int | None]:
        """Return the converter codes of analogue inputs; None for an input without a reading."""
        ...

    def wrench(self) -> IntArray | None:
        """Return the counts (6,) of the force/torque sensor; None if there is no new sample."""

    def stereo(self, now: float) -> Channel | None:
        """Return the latest stereo pair at time `now` [s]; None if there is no new one."""

    def status(self, address: int) -> Status:
        """Return a board's status.

        Raises:
            LinkError: If the board does not answer.
        """
        ...

    def state(self, address: int) -> BoardState:
        """Return the state that a board reports.

        Raises:
            LinkError: If the board does not answer.
        """
        ...

    def reset_e_stop(self) -> None:
        """Release a latched e-stop on every board.

        Raises:
            LinkError: If a board does not answer.
        """

    def close(self) -> None:
        """Close all ports."""


class WiredBoards:
    """Motor boards on a serial bus, and the optional sensors on their own links."""

    def __init__(
        self,
        bus: RoboClawBus,
        calibration: Calibration,
        analogue: AnalogueBoard | None = None,
        force_torque: NetForceTorque | None = None,
        camera: StereoCapture | None = None,
        slow_down: float = 1.0,
    ) -> None:
        """Initialize from open clients, which `close` closes.

        Args:
            bus: Bus of the motor boards.
            calibration: Assignment of the axes to the boards, and limits of the robot.
            analogue: Board of potentiometer and inclinometer; None if not fitted.
            force_torque: Force/torque sensor under the arm; None if not fitted.
            camera: Stereo head; None if not fitted.
            slow_down: Wall-clock time over the boards' time.
        """
        self.bus = bus
        self.analogue_board = analogue
        self.force_torque = force_torque
        self.camera = camera
        self.has_analogue = analogue is not None
        self.has_wrench = force_torque is not None
        self.has_stereo = camera is not None
        self.stereo_fault = ""
        self._limits = calibration.limits
        self._drive = calibration.drive
        self.addresses = tuple(self._drive.boards)
        self._silent: set[int] = set()
        self._slow_down = slow_down
        self._timed: set[int] = set()  # Boards whose timeout is set.

    def configure(self) -> None:
        """Set timeouts and current limits, and read the limits back."""
        steps = round(self._limits.serial_timeout / _TIMEOUT_UNIT)
        for address in self.addresses:
            self.bus.write(address, BoardCommand.SET_TIMEOUT, steps)
            self._timed.add(address)
        for axis in self._drive.axes:
            units = round(axis.current_limit / _CURRENT_UNIT)
            self.bus.write(axis.address, _SET_LIMIT[axis.channel], units, 0)
            found = self.bus.read(axis.address, _GET_LIMIT[axis.channel])[0]
            if found != units:
                raise LinkError(
                    f"board {axis.address:#x} keeps a current limit of {found * _CURRENT_UNIT} A "
                    f"where {axis.current_limit} A was set"
                )

    def encoders(self, address: int) -> tuple[int, int]:
        """Return both counters of a board."""
        self._silent.add(address)  # Unless it answers.
        one, two = self.bus.read(address, BoardCommand.GET_ENCODERS)
        self._silent.discard(address)
        return one, two

    def set_encoder(self, axis: int, count: int) -> None:
        """Set the counter of an axis at rest."""
        place = self._drive.axes[axis]
        for _ in range(3):
            try:
                self.bus.write(place.address, _SET_ENCODER[place.channel], count)
                return
            except LinkError:
                # Perhaps only the acknowledgement was lost: read the counter back.
                if self.encoders(place.address)[place.channel - 1] == count:
                    return
        raise LinkError(f"board {place.address:#x} does not take an encoder count")

    def drive(self, codes: IntArray) -> None:
        """Set the duty codes of all axes."""
        failed: LinkError | None = None
        codes = np.clip(codes, -codec.FULL_DUTY, codec.FULL_DUTY)
        for address in self._silent_last():
            duties = self._drive.at_board(address, codes).tolist()
            if failed is not None:  # To wait for each board of a dead line would delay a stop.
                self.bus.send(address, BoardCommand.DUTY_BOTH, *duties)
                continue
            self._silent.add(address)  # Unless it answers.
            try:
                self.bus.write(address, BoardCommand.DUTY_BOTH, *duties)
                self._silent.discard(address)
            except LinkError as error:
                failed = error
        if failed is not None:
            raise failed

    def stop(self) -> StopReport:
        """Zero all axes, whether or not a board answers."""
        timeout = self._limits.serial_timeout
        halt = self.bus.halt(self._silent_last(), timeout * self._slow_down)
        confirmed = tuple(each for each in self.addresses if each in halt.confirmed)
        others = tuple(each for each in self.addresses if each not in halt.confirmed)
        known = timeout if self._timed.issuperset(others) else 0.0
        if halt.sent:
            return StopReport(confirmed, sent=others, timeout=known)
        return StopReport(confirmed, unreached=others, timeout=known)

    def keep_stopped(self) -> None:
        """Repeat the zeros of a stop that is not confirmed."""
        self.bus.keep_halted()

    def _silent_last(self) -> list[int]:
        """Return the boards' addresses, those last that were silent the last time.

        So they do not delay the others.
        """
        return sorted(self.addresses, key=self._silent.__contains__)

    def resume(self) -> None:
        """Allow to drive after a stop."""
        self.bus.resume()

    def analogue(self, pins: Sequence[int]) -> Mapping[int, int | None]:
        """Return the converter codes of analogue inputs."""
        if self.analogue_board is None:
            return dict.fromkeys(pins)
        try:
            return self.analogue_board.poll(pins)
        except LinkError:
            return dict.fromkeys(pins)

    def wrench(self) -> IntArray | None:
        """Return the counts (6,) of the force/torque sensor."""
        if self.force_torque is None:
            return None
        try:
            record = self.force_torque.read()
        except LinkError:
            return None
        return None if record is None else np.array(record.counts, dtype=np.int64)

    def stereo(self, now: float) -> Channel | None:
        """Return the latest stereo pair."""
        if self.camera is None:
            return None
        try:
            pair = self.camera.read(now)
        except LinkError as error:
            self.stereo_fault = str(error)
            return None
        self.stereo_fault = ""
        return pair

    def status(self, address: int) -> Status:
        """Return a board's status."""
        return self.bus.status(address)

    def state(self, address: int) -> BoardState:
        """Return the state that a board reports."""
        one, two = self.bus.read(address, BoardCommand.GET_CURRENTS)
        return BoardState(
            address,
            self.bus.status(address),
            self.bus.read(address, BoardCommand.GET_MAIN_VOLTAGE)[0] * _VOLTAGE_UNIT,
            (one * _CURRENT_UNIT, two * _CURRENT_UNIT),
            self.bus.read(address, BoardCommand.GET_TIMEOUT)[0] * _TIMEOUT_UNIT,
        )

    def reset_e_stop(self) -> None:
        """Release a latched e-stop on every board."""
        for address in self.addresses:
            if self.bus.status(address) & Status.E_STOP:
                self.bus.write(address, BoardCommand.RESET_E_STOP)

    def close(self) -> None:
        """Close all ports."""
        self.bus.close()
        for device in (self.analogue_board, self.force_torque, self.camera):
            if device is not None:
                device.close()
