"""The boards of one emulated robot on their lines, with their faults."""

import socket
from collections.abc import Callable, Collection, Hashable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import cast

import numpy as np

from perception.geometry.arrays import ImageArray
from twin.hardware.cameras.frames import SUFFIX, FrameWriter
from twin.hardware.emulator.faults import (
    CameraFault,
    FaultyLine,
    LineFaultConfig,
    RobotFault,
    ScheduledFault,
)
from twin.hardware.emulator.firmata_board import FirmataBoard
from twin.hardware.emulator.net_ft import NetFT
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.emulator.roboclaw_board import RoboClawBoard, RoboClawLine
from twin.hardware.emulator.rover import EmulatedRover
from twin.hardware.roboclaw.codec import Status

LOOPBACK = "127.0.0.1"
_SLACK = 1e-9  # [s]
_LOW_BATTERY = 9.0  # [V]
_PRESET = 2**31 - 50
"""Fifty counts before an encoder wraps."""
_LATCHED = {
    RobotFault.E_STOP: Status.E_STOP,
    RobotFault.OVER_CURRENT: Status.CURRENT_ERROR_1,
    RobotFault.DRIVER_FAULT: Status.DRIVER_FAULT_1,
}


class BoardMotors:
    """The two motors of one board of an emulated rover."""

    def __init__(self, rover: EmulatedRover, address: int) -> None:
        """Find the axes of a board.

        Args:
            rover: What moves.
            address: Address of the board.
        """
        self._rover = rover
        self.axes: list[int | None] = [None, None]
        for axis, place in enumerate(rover.calibration.drive.axes):
            if place.address == address:
                self.axes[place.channel - 1] = axis

    def counts(self) -> tuple[int, int]:
        """Return both encoders since power-on."""
        counts = self._rover.counts()
        one, two = (0 if axis is None else int(counts[axis]) for axis in self.axes)
        return one, two

    def currents(self) -> tuple[float, float]:
        """Return both motor currents [A]."""
        currents = self._rover.currents()
        one, two = (0.0 if axis is None else float(currents[axis]) for axis in self.axes)
        return one, two

    def voltage(self) -> float:
        """Return the main battery voltage [V]."""
        return self._rover.battery


class EmulatedRig:
    """One robot's ports: motor boards and analogue board on ptys, force/torque on loopback UDP.

    Stereo pairs are put in a file.

    Attributes:
        bus: Pseudo-terminal of the motor boards.
        analogue: Pseudo-terminal of the analogue board.
        wrench: UDP socket of the force/torque sensor, bound to loopback only.
        bus_line: What the motor boards' line does to its bytes.
        frames: File of its stereo pairs; None if it has none.
        draw_apart: Returns what lets another process draw the newest pair; None to draw here.
    """

    draw_apart: Callable[[], Callable[[], Future[ImageArray]]] | None = None

    def __init__(
        self,
        rover: EmulatedRover,
        line_faults: LineFaultConfig,
        schedule: Sequence[ScheduledFault],
        rng: np.random.Generator,
        folder: Path | None = None,
    ) -> None:
        """Power everything on.

        Args:
            rover: What the boards are wired to.
            line_faults: Damage on the motor boards' line.
            schedule: Faults of the robot.
            rng: Decides the damage.
            folder: Where its stereo pairs are put, if it has a head; None to keep them.

        Raises:
            ValueError: If a fault is of a motor board that is not there.
        """
        addresses = sorted({axis.address for axis in rover.calibration.drive.axes})
        for fault in schedule:
            _check_address(fault, addresses)
        self.motors = [BoardMotors(rover, address) for address in addresses]
        boards = [RoboClawBoard(a, m) for a, m in zip(addresses, self.motors, strict=True)]
        self.boards = RoboClawLine(boards)
        self.bus_line = FaultyLine(self.boards, line_faults, rng)
        self.firmata = FirmataBoard(rover.analogue)
        self.net_ft = NetFT(lambda: tuple(rover.wrench().tolist()))
        self.bus, self.analogue = PseudoTerminal(), PseudoTerminal()
        self.wrench = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.wrench.bind((LOOPBACK, 0))
        self.wrench.setblocking(False)
        self._rover = rover
        self._schedule = sorted(schedule, key=lambda fault: fault.time)
        self._ends: list[tuple[float, RobotFault | CameraFault]] = []
        self._full_battery = rover.battery
        self._absent: set[RobotFault | CameraFault] = set()
        self._shown = -np.inf
        self.frames = self._open_frames(folder)
        self._pass(0.0)
        self.show()

    @property
    def ports(self) -> dict[str, str | int]:
        """Where a host finds the boards."""
        ports: dict[str, str | int] = {
            "bus": self.bus.name,
            "analogue": self.analogue.name,
            "wrench": int(self.wrench.getsockname()[1]),
        }
        return ports if self.frames is None else {**ports, "stereo": str(self.frames.path)}

    def before_tick(self, time: float, period: float) -> None:
        """Begin and end faults, run the boards to `time` [s], and let them drive the motors."""
        self._pass(time)
        self.boards.tick(time, period)
        for board, motors in zip(self.boards.boards.values(), self.motors, strict=True):
            for axis, code in zip(motors.axes, board.duties(), strict=True):
                if axis is not None:
                    self._rover.codes[axis] = code

    def show(self) -> None:
        """Announce a new stereo pair in its file, if there is one."""
        pair = self._rover.stereo()
        if self.frames is None or not pair.usable or pair.stamp <= self._shown:
            return
        self._shown = pair.stamp
        if not self._absent & set(CameraFault):
            draw = self.draw_apart
            if draw is None:
                self.frames.announce(pair.stamp, lambda: np.asarray(pair.value, dtype=np.uint8))
            else:
                self.frames.announce(pair.stamp, draw())

    def _open_frames(self, folder: Path | None) -> FrameWriter | None:
        if folder is None or not self._rover.stereo().usable:
            return None
        camera = self._rover.camera()
        return FrameWriter(folder / f"{self._rover.name}{SUFFIX}", camera.height, camera.width)

    def _pass(self, time: float) -> None:
        """Begin and end the faults that are due at `time` [s]."""
        while self._schedule and self._schedule[0].time <= time + _SLACK:
            self._begin(self._schedule.pop(0))
        over = [entry for entry in self._ends if entry[0] <= time + _SLACK]
        self._ends = [entry for entry in self._ends if entry not in over]
        for kind in {kind for _, kind in over} - self._present():
            self._end(kind)

    def serve_bus(self, now: float) -> None:
        """Answer what came for the motor boards."""
        reply = self.bus_line.feed(self.bus.read(), now)
        if reply:
            self.bus.write(reply)

    def serve_analogue(self, now: float) -> None:
        """Answer what came for the analogue board."""
        data = self.analogue.read()
        reply = self.firmata.feed(data, now) if data else self.firmata.due(now)
        if reply and RobotFault.NO_ANALOGUE not in self._absent:
            self.analogue.write(reply)

    def serve_wrench(self, now: float) -> None:
        """Answer what came for the force/torque sensor."""
        while True:
            try:
                datagram, address = self.wrench.recvfrom(256)
            except BlockingIOError:
                break
            for record in self.net_ft.answer(datagram, address, now):
                self._send(record, address)

    def serve_late(self, now: float) -> None:
        """Send what damage or sampling intervals held back until `now` [s]."""
        late = self.bus_line.due(now)
        if late:
            self.bus.write(late)
        report = self.firmata.due(now)
        if report and RobotFault.NO_ANALOGUE not in self._absent:
            self.analogue.write(report)
        for record, address in self.net_ft.due(now):
            self._send(record, address)

    def serve_frames(self) -> None:
        """Draw the stereo pair that the host waits for, if it waits."""
        if self.frames is not None:
            self.frames.serve()

    def _send(self, record: bytes, address: Hashable) -> None:
        if RobotFault.NO_WRENCH not in self._absent:
            self.wrench.sendto(record, cast("tuple[str, int]", address))

    def inject(self, fault: ScheduledFault) -> None:
        """Add a fault; one whose time has passed begins at the next tick.

        Raises:
            ValueError: If there is no such board.
        """
        _check_address(fault, self.boards.boards)
        self._schedule = sorted([*self._schedule, fault], key=lambda entry: entry.time)

    def _begin(self, fault: ScheduledFault) -> None:
        board = self.boards.boards[fault.address]
        match fault.kind:
            case CameraFault() as kind:
                self._absent.add(kind)
                self._plug()
            case RobotFault.BUS_SILENT:
                self.bus_line.silent = True
            case RobotFault.BOARD_RESET:
                board.reset()
            case RobotFault.COUNTER_PRESET:
                board.preset(_PRESET)
            case RobotFault.BROWN_OUT:
                if RobotFault.BROWN_OUT not in self._present():
                    self._full_battery = self._rover.battery
                self._rover.battery = _LOW_BATTERY
            case RobotFault.NO_WRENCH | RobotFault.NO_ANALOGUE:
                self._absent.add(fault.kind)
            case kind:
                board.status |= _LATCHED[kind]
        self._ends.append((fault.time + fault.duration, fault.kind))

    def _present(self) -> set[RobotFault | CameraFault]:
        """Return the kinds of which a fault has begun and not ended."""
        return {kind for _, kind in self._ends}

    def _plug(self) -> None:
        if self.frames is not None:
            self.frames.unplug(CameraFault.UNPLUGGED in self._absent)

    def _end(self, kind: RobotFault | CameraFault) -> None:
        if kind is RobotFault.BUS_SILENT:
            self.bus_line.silent = False
        elif kind is RobotFault.BROWN_OUT:
            self._rover.battery = self._full_battery
        self._absent.discard(kind)
        self._plug()

    def close(self) -> None:
        """Take all ports away."""
        if self.frames is not None:
            self.frames.close()
        self.bus.close()
        self.analogue.close()
        self.wrench.close()


def _check_address(fault: ScheduledFault, addresses: Collection[int]) -> None:
    if fault.address not in addresses:
        there = ", ".join(f"{address:#x}" for address in addresses)
        raise ValueError(f"no motor board {fault.address:#x}; there are {there}")
