"""A pair of emulated 9600-baud radio modems: pace, delay and byte errors.

The same lines carry bytes in virtual time within one process (`VirtualModems`), so that an hour of
radio takes seconds, and in real time between two pseudo-terminals (`pty_modems`).
"""

import contextlib
import dataclasses
import math
import select
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence

import numpy as np

from models.datasheets import RadioSheet
from perception.geometry.checks import check_numbers
from twin.hardware.background import repeating
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.radio.channel import BITS_PER_BYTE
from twin.hardware.radio.framed_radio import FramedLink

_MAX_WAIT = 0.05  # [s] After which an idle thread checks whether it shall end.


@dataclasses.dataclass(frozen=True)
class ModemConfig:
    """How a pair of modems carries bytes; alike and at once in both directions.

    Attributes:
        baud: Bits a second, 8N1: a tenth of it is bytes a second.
        delay: Time from a byte's last bit in to the same out at the other end [s].
        error_rate: Probability that a byte is hit.
        flip: Share of hits that change the byte to another.
        loss: Share of hits that lose it.
        insertion: Share of hits that put a random byte before it.
        packet_loss: Probability that all bytes of one `Line.put`, a packet on the air, are lost.
        buffer: Bytes that wait to be sent; what comes beyond them is lost, as without flow control.
    """

    baud: int = 9600
    delay: float = 0.005
    error_rate: float = 0.0
    flip: float = 1.0
    loss: float = 1.0
    insertion: float = 1.0
    packet_loss: float = 0.0
    buffer: int = 1024

    @classmethod
    def of(cls, radio: RadioSheet) -> "ModemConfig":
        """Return modems as a data sheet has them; a bit error changes its byte.

        Args:
            radio: Data sheet of the modems.
        """
        return cls(
            delay=radio.delay,
            error_rate=-math.expm1(8.0 * math.log1p(-radio.bit_error_rate)),
            loss=0.0,
            insertion=0.0,
            packet_loss=radio.packet_loss,
        )

    def __post_init__(self) -> None:
        """Refuse numbers that no modem can have.

        Raises:
            ValueError: Naming the field and its value.
        """
        check_numbers("modem", self, "baud", "buffer")
        check_numbers("modem", self, "delay", "flip", "loss", "insertion", zero=True)
        check_numbers("modem", self, "error_rate", "packet_loss", zero=True)
        for name in ("error_rate", "packet_loss"):
            if getattr(self, name) > 1.0:
                raise ValueError(f"modem {name} must be a probability, got {getattr(self, name)}")
        if self.error_rate > 0.0 and self.flip + self.loss + self.insertion == 0.0:
            raise ValueError("modem error_rate is positive, but flip, loss and insertion are zero")


class Line:
    """One direction of the radio.

    Args:
        config: Properties of the modems.
        rng: Random generator for byte errors and lost packets.
    """

    def __init__(self, config: ModemConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._duration = BITS_PER_BYTE / config.baud
        shares = np.array([config.flip, config.loss, config.insertion])
        self._shares = shares / shares.sum() if config.error_rate > 0.0 else shares
        self._free = -math.inf
        self._coming: deque[tuple[float, bytes]] = deque()
        self._until_hit = self._draw_gap()

    def put(self, data: bytes, now: float) -> None:
        """Take bytes from a computer at `now` [s]."""
        lost = self._config.packet_loss > 0.0 and self._rng.random() < self._config.packet_loss
        for byte in data:
            if (self._free - now) / self._duration > self._config.buffer - 0.5:
                return
            self._free = max(now, self._free) + self._duration
            arrived = self._corrupt(byte)
            if arrived and not lost:
                self._coming.append((self._free + self._config.delay, arrived))

    def take(self, now: float) -> bytes:
        """Return the bytes that have arrived by `now` [s]."""
        arrived: list[bytes] = []
        while self._coming and self._coming[0][0] <= now:
            arrived.append(self._coming.popleft()[1])
        return b"".join(arrived)

    def next_arrival(self) -> float:
        """When the next byte arrives [s]; infinity if none is on the way."""
        return self._coming[0][0] if self._coming else math.inf

    def _corrupt(self, byte: int) -> bytes:
        self._until_hit -= 1
        if self._until_hit > 0:
            return bytes([byte])
        self._until_hit = self._draw_gap()
        kind = int(self._rng.choice(3, p=self._shares))
        if kind == 0:
            return bytes([byte ^ int(self._rng.integers(1, 256))])
        return b"" if kind == 1 else bytes([int(self._rng.integers(256)), byte])

    def _draw_gap(self) -> float:
        """Draw how many bytes on the next hit is."""
        rate = self._config.error_rate
        return float(self._rng.geometric(rate)) if rate > 0.0 else math.inf


class VirtualChannel:
    """One computer's line to its modem, in virtual time."""

    def __init__(self, modems: "VirtualModems", out: Line, into: Line) -> None:
        """Send on `out` and receive from `into`, by the clock of `modems`."""
        self._modems = modems
        self._out = out
        self._into = into

    def now(self) -> float:
        """Virtual time [s]."""
        return self._modems.now()

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._out.put(data, self.now())

    def read(self) -> bytes:
        """Return what has arrived."""
        return self._into.take(self.now())


class VirtualModems:
    """Two modems in virtual time, which never goes back.

    Args:
        config: Properties of both modems.
        rng: Random generator for the byte errors of both directions.
        clock: Returns virtual time [s]; None for the time that their owner sets in `time`.

    Attributes:
        time: Virtual time without a clock [s].
        lines: Lines from the first to the second end, and back.
        ends: The two computers' channels.
    """

    def __init__(
        self,
        config: ModemConfig,
        rng: np.random.Generator,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self.time = 0.0
        self.now = clock or (lambda: self.time)
        first, second = rng.spawn(2)
        self.lines = Line(config, first), Line(config, second)
        there, back = self.lines
        self.ends = VirtualChannel(self, there, back), VirtualChannel(self, back, there)

    def next_arrival(self) -> float:
        """When a byte arrives at either end [s]; infinity if none is on the way."""
        return min(line.next_arrival() for line in self.lines)


def virtual_links(
    robots: Sequence[str],
    clock: Callable[[], float],
    rng: np.random.Generator,
    config: ModemConfig | None = None,
) -> dict[str, FramedLink]:
    """Return both robots' ends of a radio in virtual time; none unless there are two robots.

    Args:
        robots: Names of the robots.
        clock: Returns virtual time [s].
        rng: Random generator for byte errors and session numbers.
        config: Properties of the modems; None for the default.
    """
    if len(robots) != 2:  # noqa: PLR2004
        return {}
    modems = VirtualModems(config or ModemConfig(), rng, clock)
    return {name: FramedLink(end, rng) for name, end in zip(robots, modems.ends)}


@contextlib.contextmanager
def pty_modems(config: ModemConfig, rng: np.random.Generator) -> Generator[tuple[str, str]]:
    """Serve two modems between two pseudo-terminals at the real pace; yield their paths.

    Args:
        config: Properties of both modems.
        rng: Random generator for the byte errors of both directions.
    """
    ends = PseudoTerminal(), PseudoTerminal()
    lines = [Line(config, each) for each in rng.spawn(2)]
    directions = tuple(zip(ends, lines, reversed(ends)))

    def serve() -> None:
        arrival = min(line.next_arrival() for line in lines)
        wait = min(max(0.0, arrival - time.monotonic()), _MAX_WAIT)
        ready, _, _ = select.select(ends, [], [], wait)
        now = time.monotonic()
        for source, line, target in directions:
            if source in ready:
                line.put(source.read(), now)
            target.write(line.take(now))

    with contextlib.closing(ends[0]), contextlib.closing(ends[1]), repeating(serve, "modems"):
        yield ends[0].name, ends[1].name
