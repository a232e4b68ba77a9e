"""A damaged serial line to motor boards: how long calls take, and whether a value is wrong."""

import contextlib
import dataclasses
import select
import time
from collections.abc import Generator

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.hardware.background import repeating
from twin.hardware.calibration.motors import ADDRESSES
from twin.hardware.connect_boards import BUS_BAUD
from twin.hardware.emulator.faults import FaultyLine, LineFaultConfig
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.emulator.roboclaw_board import Motors, RoboClawBoard, RoboClawLine
from twin.hardware.roboclaw.client import RoboClawBus
from twin.hardware.roboclaw.codec import FULL_DUTY, BoardCommand
from twin.hardware.serial_link import LinkError, SerialLink


class DamagedLine:
    """Four boards behind a line that damages a share of its exchanges, served by a thread.

    Attributes:
        Args:
        rate: Share of the exchanges that are damaged.
        rng: Random generator for the damage.

    Attributes:
        boards: Boards by address.
        line: Line with the number of damaged exchanges.
        port: Serial port of the host.
    """

    def __init__(self, rate: float, rng: np.random.Generator) -> None:
        self.boards = {address: RoboClawBoard(address, Motors()) for address in ADDRESSES}
        device = RoboClawLine(list(self.boards.values()))
        self.line = FaultyLine(device, LineFaultConfig(rate), rng)
        self._terminal = PseudoTerminal()
        self.port = self._terminal.name

    @contextlib.contextmanager
    def served(self) -> Generator[None]:
        """Serve the line until the block is left, then close it."""
        with contextlib.closing(self._terminal), repeating(self._serve, "damaged line"):
            yield

    def _serve(self) -> None:
        select.select([self._terminal], [], [], 0.001)
        self._terminal.write(self.line.feed(self._terminal.read(), time.monotonic()))


@dataclasses.dataclass(frozen=True)
class DamagedCalls:
    """Calls of a motor board over a line that damages exchanges.

    Attributes:
        rate: Share of exchanges to damage.
        call_ms: (n,) duration of each call [ms].
        wrong: Number of wrong values, without an error.
        failures: Number of calls that reported an error instead of a value.
        damaged: Number of damaged exchanges.
        retries: Number of exchanges that the bus repeated.
    """

    rate: float
    call_ms: FloatArray
    wrong: int
    failures: int
    damaged: int
    retries: int


def call_damaged(rate: float, calls: int, seed: int) -> DamagedCalls:
    """Read encoders and set duties in turn; the truth jumps before each call.

    Args:
        rate: Share of exchanges to damage.
        calls: Number of calls.
        seed: Random seed of damage and values.
    """
    rng = np.random.default_rng(seed)
    durations = np.zeros(calls)
    wrong = failures = 0
    wire = DamagedLine(rate, rng.spawn(1)[0])
    with wire.served():
        bus = RoboClawBus(SerialLink(wire.port, BUS_BAUD))
        for number in range(calls):
            address = int(rng.choice(ADDRESSES))
            begin = time.perf_counter()
            try:
                call = _read if number % 2 else _write
                wrong += call(bus, wire, address, rng)
            except LinkError:
                failures += 1
            durations[number] = time.perf_counter() - begin
        bus.close()
        damaged = sum(wire.line.counts.values())
    return DamagedCalls(
        rate=rate,
        call_ms=1e3 * durations,
        wrong=wrong,
        failures=failures,
        damaged=damaged,
        retries=bus.statistics.retries,
    )


def _read(bus: RoboClawBus, wire: DamagedLine, address: int, rng: np.random.Generator) -> bool:
    """Turn the shafts anywhere, read them, and return whether the reading is wrong."""
    one, two = (int(count) for count in rng.integers(-(2**31), 2**31, 2))
    wire.boards[address].motors.counts = one, two
    return bus.read(address, BoardCommand.GET_ENCODERS) != (one, two)


def _write(bus: RoboClawBus, wire: DamagedLine, address: int, rng: np.random.Generator) -> bool:
    """Set two duties, and return whether the board has others though it acknowledged."""
    one, two = (int(code) for code in rng.integers(-FULL_DUTY, FULL_DUTY + 1, 2))
    bus.write(address, BoardCommand.DUTY_BOTH, one, two)
    return wire.boards[address].duties() != (one, two)
