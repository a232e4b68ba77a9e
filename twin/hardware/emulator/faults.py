"""What goes wrong on an emulated line, by chance or at a given time."""

import collections
import dataclasses
import enum
import json
import math
from collections.abc import Collection
from typing import cast

import numpy as np

from twin.hardware.calibration.section import from_table
from twin.hardware.emulator.roboclaw_board import RoboClawLine


class LineFault(enum.Enum):
    """Damage to one exchange on a serial line."""

    FLIP_REQUEST = "flip_request"
    FLIP_REPLY = "flip_reply"
    LOSE_REQUEST = "lose_request"
    LOSE_REPLY = "lose_reply"
    LOSE_BYTE = "lose_byte"
    LATE = "late"
    MERGED = "merged"
    TRUNCATED = "truncated"
    WRONG_ACKNOWLEDGE = "wrong_acknowledge"


@dataclasses.dataclass(frozen=True)
class LineFaultConfig:
    """How often an exchange is damaged.

    Attributes:
        rate: Share of the exchanges, in [0, 1].
        kinds: Which damage, equally likely.
        latest: Longest delay of a late answer [s].
    """

    rate: float = 0.0
    kinds: tuple[LineFault, ...] = tuple(LineFault)
    latest: float = 0.03

    def __post_init__(self) -> None:
        """Refuse what is no share.

        Raises:
            ValueError: If the rate is not within [0, 1].
        """
        if not 0.0 <= self.rate <= 1.0:
            raise ValueError(f"line fault rate: got {self.rate}, needs 0 to 1")


class BusFault(enum.Enum):
    """Faults that a whole line has for a while."""

    REQUESTS_CUT = "requests_cut"
    REPLIES_CUT = "replies_cut"
    GARBAGE = "bus_garbage"
    LATE = "bus_late"
    REPEATED = "bus_repeated"
    BOARD_DEAD = "board_dead"
    UNPLUGGED = "bus_unplugged"


_LATE = (0.02, 0.06)  # [s]
_NOISE = 16
"""Most bytes of noise that come unasked at once."""


class FaultyLine:
    """A device behind a line that damages what it carries; bytes keep their order.

    Attributes:
        counts: Number of damaged exchanges by kind.
        silent: True while nothing gets through at all.
        present: Faults of the whole line at present.
        once: Damage to the next exchanges, one each.
    """

    def __init__(
        self, device: RoboClawLine, config: LineFaultConfig, rng: np.random.Generator
    ) -> None:
        """Put a device behind a line.

        Args:
            device: Boards behind the line.
            config: Rate and kinds of damage.
            rng: Decides each time.
        """
        self.counts: collections.Counter[LineFault] = collections.Counter()
        self.silent = False
        self.present: Collection[BusFault] = ()
        self.once: list[LineFault] = []
        self._device = device
        self._config = config
        self._rng = rng
        self._waiting: list[tuple[float, bytes]] = []
        self._last_reply = b"\xff"

    def feed(self, data: bytes, now: float) -> bytes:
        """Take what came at `now` [s], and return what gets out by then."""
        noisy = BusFault.GARBAGE in self.present
        if noisy:
            data = self._rng.bytes(len(data))
        if data and not (self.silent or BusFault.REQUESTS_CUT in self.present):
            self._exchange(data, now)
        out = self.due(now)
        if noisy:
            out = self._rng.bytes(len(out) + int(self._rng.integers(_NOISE)))
        return b"" if BusFault.REPLIES_CUT in self.present else out

    def due(self, now: float) -> bytes:
        """Return what is on its way and gets out by `now` [s]."""
        out = b""
        while self._waiting and self._waiting[0][0] <= now:
            out += self._waiting.pop(0)[1]
        return out

    def _exchange(self, request: bytes, now: float) -> None:
        kind, delay = None, 0.0
        if self.once:
            kind = self.once.pop(0)
        elif BusFault.REPEATED in self.present:
            kind = LineFault.MERGED
        elif self._rng.random() < self._config.rate:
            kind = self._config.kinds[self._rng.integers(len(self._config.kinds))]
        sent = request
        if kind is LineFault.FLIP_REQUEST:
            request = self._flip(request)
        if kind is LineFault.LOSE_BYTE:
            place = int(self._rng.integers(len(request)))
            request = request[:place] + request[place + 1 :]
        reply = b""
        if kind is not LineFault.LOSE_REQUEST:
            reply = self._device.feed(request, now)
        clean = reply
        if kind is LineFault.LATE and reply:
            delay = float(self._rng.uniform(0.2, 1.0)) * self._config.latest
        elif reply:
            reply = self._damaged(reply, kind)
        if BusFault.LATE in self.present:
            delay = float(self._rng.uniform(*_LATE))
        # What has no reply cannot lose one: only damage that was done is counted.
        lost = kind is LineFault.LOSE_REQUEST
        if kind is not None and (lost or delay or request != sent or reply != clean):
            self.counts[kind] += 1
        self._last_reply = clean or self._last_reply
        if self._waiting:
            delay = max(delay, self._waiting[-1][0] - now)
        self._waiting.append((now + delay, reply))

    def _damaged(self, reply: bytes, kind: LineFault | None) -> bytes:
        match kind:
            case LineFault.FLIP_REPLY:
                return self._flip(reply)
            case LineFault.LOSE_REPLY:
                return b""
            case LineFault.MERGED:
                return self._last_reply + reply
            case LineFault.TRUNCATED:
                return reply[: int(self._rng.integers(len(reply)))]
            case LineFault.WRONG_ACKNOWLEDGE if len(reply) == 1:
                return bytes((int(self._rng.integers(255)),))
            case _:
                return reply

    def _flip(self, data: bytes) -> bytes:
        """Return `data` with one to three bits flipped."""
        changed = bytearray(data)
        places = self._rng.choice(8 * len(data), size=min(3, 8 * len(data)), replace=False)
        for place in places[: int(self._rng.integers(1, 4))]:
            changed[place // 8] ^= 1 << (int(place) % 8)
        return bytes(changed)


class RobotFault(enum.Enum):
    """Faults of a robot at a given time."""

    BUS_SILENT = "bus_silent"
    BOARD_RESET = "board_reset"
    COUNTER_PRESET = "counter_preset"
    E_STOP = "e_stop"
    OVER_CURRENT = "over_current"
    BROWN_OUT = "brown_out"
    DRIVER_FAULT = "driver_fault"
    NO_WRENCH = "no_wrench"
    NO_ANALOGUE = "no_analogue"


class CameraFault(enum.Enum):
    """Faults of a stereo head at a given time; robots without one have none."""

    FROZEN = "camera_frozen"
    UNPLUGGED = "camera_unplugged"


@dataclasses.dataclass(frozen=True)
class ScheduledFault:
    """One fault.

    Attributes:
        time: When it begins [s]; at 0 the boards power on with it.
        kind: Kind of the fault.
        duration: Duration of a fault that lasts [s].
        address: Address of the motor board that it happens to.
    """

    time: float
    kind: RobotFault | BusFault | LineFault | CameraFault
    duration: float = 1e9
    address: int = 0x80


@dataclasses.dataclass(frozen=True)
class FaultEntry:
    """A fault as an entry of a file, or an order on the control line, describes it.

    Attributes:
        time: When it begins [s].
        kind: Value of a `RobotFault`, a `BusFault`, a `CameraFault` or, for one exchange on the
            motor boards' line, a `LineFault`.
        robot: Name of the robot; empty for every robot.
        duration: Duration [s].
        address: Address of the motor board that it happens to.
    """

    time: float
    kind: str
    robot: str = ""
    duration: float = ScheduledFault.duration
    address: int = ScheduledFault.address

    @classmethod
    def parse(cls, entry: object) -> "FaultEntry":
        """Return a checked entry.

        Args:
            entry: Decoded JSON; its "do" is for the caller.

        Raises:
            ValueError: If a key is missing, unknown or of a wrong type, with those that there are.
        """
        if not isinstance(entry, dict):
            raise ValueError(f"{json.dumps(entry)[:40]} is no table with time and kind")
        table = cast("dict[str, object]", entry)
        found = from_table(cls, {name: value for name, value in table.items() if name != "do"})
        for name in ("time", "duration"):
            if not 0.0 <= getattr(found, name) < math.inf:
                raise ValueError(f"{name} is {getattr(found, name)}, needs seconds, 0 or more")
        if found.kind not in _KINDS:
            raise ValueError(f"kind {found.kind!r}; expected one of {', '.join(_KINDS)}")
        return found

    def fault(self) -> ScheduledFault:
        """Return the fault."""
        return ScheduledFault(self.time, _KINDS[self.kind], self.duration, self.address)


_KINDS = {kind.value: kind for kind in (*RobotFault, *BusFault, *CameraFault, *LineFault)}
