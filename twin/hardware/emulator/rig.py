"""The boards of one emulated robot on their lines, with their faults."""

import contextlib
import socket
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import cast

import numpy as np

from perception.geometry.arrays import ImageArray
from twin.hardware.cameras.frames import SUFFIX, FrameWriter
from twin.hardware.emulator.faults import (
    BusFault,
    CameraFault,
    FaultyLine,
    LineFault,
    LineFaultConfig,
    RobotFault,
    ScheduledFault,
)
from twin.hardware.emulator.firmata_board import FirmataBoard
from twin.hardware.emulator.messages import Ports
from twin.hardware.emulator.net_ft import NetFT
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.emulator.roboclaw_board import Motors, RoboClawBoard, RoboClawLine
from twin.hardware.emulator.rover import EmulatedRover
from twin.hardware.roboclaw.codec import Status

LOOPBACK = "127.0.0.1"
_SLACK = 1e-9  # [s]
_LOW_BATTERY = 9.0  # [V]
_PRESET = 2**31 - 50
"""Fifty counts before an encoder wraps."""
_LATCHED: Mapping[RobotFault | BusFault | CameraFault, Status] = {
    RobotFault.E_STOP: Status.E_STOP,
    RobotFault.OVER_CURRENT: Status.CURRENT_ERROR_1,
    RobotFault.DRIVER_FAULT: Status.DRIVER_FAULT_1,
}


class EmulatedRig:
    """One robot's boards on their ports.

    Motor boards and analogue board are on pseudo-terminals, the force/torque sensor on a UDP port
    of the loopback interface; stereo pairs are announced in a file.

    Args:
        rover: Rover that the boards are wired to.
        line_faults: Damage on the motor boards' line.
        schedule: Faults of the robot.
        rng: Random generator for the damage.
        folder: Folder for its stereo pairs, if it has a head; None for none.

    Attributes:
        bus: Pseudo-terminal of the motor boards.
        analogue: Pseudo-terminal of the analogue board.
        wrench: UDP socket of the force/torque sensor, bound to loopback only.
        boards: Motor boards on their line.
        bus_line: Line of the motor boards with its injected damage.
        frames: File of its stereo pairs; None if it has none.
        driven: Latest time at which each motor board drove a motor, by address [s].
        newest: Returns a function that draws the newest pair, at once or in another process.

    Raises:
        ValueError: If a fault names a motor board that does not exist.
    """

    def __init__(
        self,
        rover: EmulatedRover,
        line_faults: LineFaultConfig,
        schedule: Sequence[ScheduledFault],
        rng: np.random.Generator,
        folder: Path | None = None,
    ) -> None:
        self._rover = rover
        self._motors = {address: Motors() for address in rover.calibration.drive.boards}
        self._read_motors()
        self.boards = RoboClawLine([RoboClawBoard(a, m) for a, m in self._motors.items()])
        self._schedule: list[ScheduledFault] = []
        for fault in schedule:
            self.inject(fault)
        self.bus_line = FaultyLine(self.boards, line_faults, rng)
        self._firmata = FirmataBoard(rover.analogue)
        self._net_ft = NetFT(lambda: tuple(rover.wrench().tolist()))
        self.bus, self.analogue = PseudoTerminal(), PseudoTerminal()
        self.wrench = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.wrench.bind((LOOPBACK, 0))
        self.wrench.setblocking(False)
        self.driven = dict.fromkeys(self._motors, -1.0)
        self._active: list[ScheduledFault] = []
        self._full_battery = rover.battery
        self._shown = -np.inf
        self.newest: Callable[[], Callable[[], ImageArray | Future[ImageArray]]] = self._newest_here
        self.frames = None
        if folder is not None and rover.stereo().usable:
            camera, path = rover.camera(), folder / f"{rover.name}{SUFFIX}"
            self.frames = FrameWriter(path, camera.height, camera.width)
        self._pass(0.0)
        self.after_tick()

    @property
    def ports(self) -> Ports:
        """Ports at which a host finds the boards."""
        ports: Ports = {
            "bus": self.bus.name,
            "analogue": self.analogue.name,
            "wrench": int(self.wrench.getsockname()[1]),
        }
        if self.frames is not None:
            ports["stereo"] = str(self.frames.path)
        return ports

    def before_tick(self, time: float, period: float) -> None:
        """Begin and end faults, run the boards to `time` [s], and let them drive the motors."""
        self._pass(time)
        self.boards.tick(time, period)
        for address, board in self.boards.boards.items():
            axes = self._rover.calibration.drive.boards[address]
            for axis, code in zip(axes, board.duties(), strict=True):
                if axis >= 0:
                    self._rover.codes[axis] = code
                if code:
                    self.driven[address] = time

    def after_tick(self) -> None:
        """Read the motors, and announce a new stereo pair in its file, if there is one."""
        self._read_motors()
        pair = self._rover.stereo()
        if self.frames is None or not pair.usable or pair.stamp <= self._shown:
            return
        self._shown = pair.stamp
        if not self._present & set(CameraFault):
            self.frames.announce(pair.stamp, self.newest(), self._rover.stereo_age())

    def _read_motors(self) -> None:
        drive = self._rover.calibration.drive
        counts = self._rover.counts()
        for address, motors in self._motors.items():
            motors.counts = drive.at_board(address, counts).tolist()
            motors.currents = drive.at_board(address, self._rover.currents).tolist()
            motors.voltage = self._rover.battery

    def _newest_here(self) -> Callable[[], ImageArray]:
        pair = self._rover.stereo()
        return lambda: np.asarray(pair.value, dtype=np.uint8)

    def serve(self, ready: Collection[object], now: float) -> None:
        """Answer what has come by `now` [s], and send what damage or sampling held back.

        Args:
            ready: Ports with something to read.
            now: Time on the wall clock [s].
        """
        request = self.bus.read() if self.bus in ready else b""
        self.bus.write(self.bus_line.feed(request, now))
        request = self.analogue.read() if self.analogue in ready else b""
        report = self._firmata.feed(request, now)
        if RobotFault.NO_ANALOGUE not in self._present:
            self.analogue.write(report)
        records: list[tuple[bytes, Hashable]] = []
        with contextlib.suppress(BlockingIOError):
            while self.wrench in ready:
                datagram, host = self.wrench.recvfrom(256)
                records += [(record, host) for record in self._net_ft.answer(datagram, host, now)]
        for record, host in records + self._net_ft.due(now):
            if RobotFault.NO_WRENCH not in self._present:
                self.wrench.sendto(record, cast("tuple[str, int]", host))
        if self.frames is not None:
            self.frames.serve()

    def inject(self, fault: ScheduledFault) -> None:
        """Add a fault; one whose time has passed begins at the next tick.

        Raises:
            ValueError: If there is no such board.
        """
        if fault.address not in self._motors:
            there = ", ".join(f"{address:#x}" for address in self._motors)
            raise ValueError(f"no motor board {fault.address:#x}; there are {there}")
        self._schedule.append(fault)

    def _pass(self, time: float) -> None:
        """Begin and end the faults that are due at `time` [s]."""
        due = [fault for fault in self._schedule if fault.time <= time + _SLACK]
        self._schedule = [fault for fault in self._schedule if fault.time > time + _SLACK]
        for fault in sorted(due, key=lambda each: each.time):
            self._strike(fault)
        lasting = (*self._active, *due)
        self._active = [each for each in lasting if each.time + each.duration > time + _SLACK]
        self._present = {fault.kind for fault in self._active}
        self.bus_line.present = {kind for kind in self._present if isinstance(kind, BusFault)}
        if BusFault.UNPLUGGED in {fault.kind for fault in due}:
            self.bus.unplug()
        dead = {each.address for each in self._active if each.kind is BusFault.BOARD_DEAD}
        for address, board in self.boards.boards.items():
            board.dead = address in dead
        self.bus_line.silent = RobotFault.BUS_SILENT in self._present
        browned_out = RobotFault.BROWN_OUT in self._present
        self._rover.battery = _LOW_BATTERY if browned_out else self._full_battery
        self._read_motors()
        if self.frames is not None:
            self.frames.unplug(CameraFault.UNPLUGGED in self._present)

    def _strike(self, fault: ScheduledFault) -> None:
        """Do to a motor board, or to its line, what a fault does at once."""
        if isinstance(fault.kind, LineFault):
            self.bus_line.once.append(fault.kind)
            return
        board = self.boards.boards[fault.address]
        match fault.kind:
            case RobotFault.BOARD_RESET:
                board.reset()
            case RobotFault.COUNTER_PRESET:
                board.preset(_PRESET)
            case kind:
                board.status |= _LATCHED.get(kind, Status.NORMAL)

    def close(self) -> None:
        """Take all ports away."""
        if self.frames is not None:
            self.frames.close()
        self.bus.close()
        self.analogue.close()
        self.wrench.close()
