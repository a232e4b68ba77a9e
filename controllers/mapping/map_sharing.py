"""Elevation maps of two robots, shared over a slow radio tile by tile.

Each robot keeps the other's map apart from its own, in the other's frame: the caller moves and
merges it. A tile's delta is cut into fragments that fit in messages of the radio. The receiver
states from time to time which deltas were complete; what was not is sent again, with what has
changed since. A delta needs no earlier one, so that nothing waits for what was lost.

A fragment is its type, the sending robot, the number of the delta modulo 256, which fragment of how
many it is, and its bytes. A receipt is its type, the robot whose deltas it is about, the number of
the newest one, and a bit for each of the 32 before; the last two bytes are a CRC-16.
"""

import dataclasses
import math
import struct

import fastcrc
import numpy as np

from perception.compression.byte_codes import CodingError
from perception.elevation.alignment import aligned
from perception.elevation.deltas import (
    LARGEST,
    STEP,
    TILE,
    TileDelta,
    decode_delta,
    encode_delta,
    rounded,
    tile_counts,
    tile_parts,
)
from perception.elevation.ground import rises
from perception.elevation.map import ElevationMap
from perception.elevation.submaps import Submaps
from perception.geometry.arrays import BoolArray, FloatArray, IndexArray
from perception.geometry.checks import check_numbers
from twin.link import MESSAGE_LIMIT, RadioError

FRAGMENT, RECEIPT = 0x17, 0x18
"""First bytes: format version 1, types 7 and 8."""
_FRAGMENT = struct.Struct(">BBBB")  # Type, robot, number, index << 4 | fragments less one.
_RECEIPT = struct.Struct(">BBBI")
_CRC = struct.Struct(">H")
_PAYLOAD = MESSAGE_LIMIT - _FRAGMENT.size
_BITS = 32
_NUMBERS = 256
_NONE = -(2**31)
"""Number of no delta, before all others."""
_MOST_PATIENCE = 60.0
"""Longest time after which a delta without a receipt is taken for lost [s]."""
_APART = np.diag(np.square([0.03, 0.03, 0.0, 0.0, 0.0, 0.3]))
"""Covariance of one robot's levelled map in the other's, as a twist [rad, m]."""
_NO_CELLS = np.zeros(0, np.intp)


@dataclasses.dataclass(frozen=True)
class MapSharingConfig:
    """How much is sent, and what first.

    Attributes:
        budget_bytes: Most bytes that are sent in all, receipts included.
        rate_bytes_per_s: Bytes sent a second [byte/s]; a third of a line of 9600 baud leaves room
            for poses, guidance and the radio's own frames.
        reserve: Share of the budget that is kept for receipts.
        quiet: Time without changes after which a tile's few changes are sent [s].
        many_cells: Number of changed cells that are sent without waiting for that.
        climb: Height above the ground from which on a cell is an obstacle [m].
        obstacle_value: How many new cells an obstacle's cell is worth.
        change_value: How many new cells a changed one is worth.
        receipt_deltas: Number of deltas after which they are receipted.
        receipt_delay: Time after which fewer are [s].
        unreceipted: Most deltas that wait for a receipt.
        late: Number of newer deltas that may overtake one that is not lost.
        patience: Time after which a delta without a receipt is taken for lost [s]; doubled each
            time until a receipt arrives.
    """

    budget_bytes: int = 10_000
    rate_bytes_per_s: float = 300.0
    reserve: float = 0.05
    quiet: float = 3.0
    many_cells: int = 64
    climb: float = 0.025
    obstacle_value: float = 50.0
    change_value: float = 0.25
    receipt_deltas: int = 4
    receipt_delay: float = 1.5
    unreceipted: int = 12
    late: int = 3
    patience: float = 6.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: Naming the wrong one.
        """
        check_numbers("map sharing", self)
        if self.unreceipted + self.late >= _BITS:
            most = _BITS - self.late - 1
            raise ValueError(f"map sharing unreceipted = {self.unreceipted}: expected up to {most}")


@dataclasses.dataclass
class _Sent:
    """A delta that was sent and has no receipt yet.

    Attributes:
        tile: Index of its tile.
        cells: (K,) flat indices of its cells in the map.
        time: When its newest fragment was handed out [s].
    """

    tile: int
    cells: IndexArray
    time: float


@dataclasses.dataclass
class _Arriving:
    """Fragments of one delta that have arrived.

    Attributes:
        parts: Bytes of each fragment by its index.
        count: Number of fragments.
        done: Whether the delta was complete and read.
        dropped: Whether it was counted as dropped.
    """

    parts: dict[int, bytes] = dataclasses.field(default_factory=dict)
    count: int = 0
    done: bool = False
    dropped: bool = False


class MapSharing:
    """One robot's end of the exchange of elevation maps between two robots.

    It holds no radio: the caller sends what `next_message` returns and hands what arrives to
    `receive`.

    Args:
        elevation: The robot's own map; the other robot's has as many cells, of the same side.
        robot: Number of the robot, 0 to 255.
        config: Budget, rate and order; the default if not given.

    Attributes:
        received: What the other robot has sent of its map, in that robot's frame.
        bytes_sent: Bytes handed out by `next_message`.
        tiles_dropped: Number of the other robot's deltas that were damaged, or not complete when
            newer ones came.
    """

    def __init__(
        self, elevation: ElevationMap, robot: int, config: MapSharingConfig | None = None
    ) -> None:
        self._config = config or MapSharingConfig()
        self._incoming = _Incoming(elevation, self._config.late)
        self._outgoing = _Outgoing(elevation, robot, self._config)
        self.received, self.bytes_sent = self._incoming.map, 0
        self._robot, self._free_at, self._receipt_due = robot, -math.inf, math.inf

    @property
    def tiles_dropped(self) -> int:
        """See the class."""
        return self._incoming.dropped

    def take(self, cells: IndexArray) -> None:
        """Note cells (K,) of the own map, by flat index, whose height may have changed."""
        self._outgoing.note(cells)

    def next_message(self, now: float) -> bytes | None:
        """Return the next message to send; None if there is none within rate and budget.

        Args:
            now: Time of the robot's own clock [s].
        """
        if now < self._free_at:
            return None
        config, left = self._config, self._config.budget_bytes - self.bytes_sent
        message = None
        if left >= _RECEIPT.size + _CRC.size:
            message = self._due_receipt(now)
        if message is None:
            kept = math.ceil(config.reserve * config.budget_bytes)
            message = self._outgoing.next_fragment(now, left - kept)
        if message is not None:
            self.bytes_sent += len(message)
            self._free_at = now + len(message) / config.rate_bytes_per_s
        return message

    def receive(self, message: bytes) -> IndexArray:
        """Take a message of the other robot; a damaged one is ignored.

        Args:
            message: Bytes that begin with `FRAGMENT` or `RECEIPT`.

        Returns:
            (K,) flat indices of the cells of `received` that were set, ascending.

        Raises:
            RadioError: If it is a message of another type.
        """
        if not message or message[0] not in (FRAGMENT, RECEIPT):
            raise RadioError(
                f"map message begins {message[:1]!r}: expected 0x{FRAGMENT:02x} or 0x{RECEIPT:02x}"
            )
        if message[0] == RECEIPT:
            self._take_receipt(message)
        elif len(message) > _FRAGMENT.size and message[1] != self._robot:
            return self._incoming.take(message)
        return _NO_CELLS

    def _due_receipt(self, now: float) -> bytes | None:
        """Return a receipt of the other robot's deltas if one is due."""
        incoming, config = self._incoming, self._config
        if not incoming.unreceipted:
            return None
        self._receipt_due = min(self._receipt_due, now + config.receipt_delay)
        if len(incoming.unreceipted) < config.receipt_deltas and now < self._receipt_due:
            return None
        self._receipt_due = math.inf
        return incoming.receipt()

    def _take_receipt(self, message: bytes) -> None:
        """Take what the other robot states of the own deltas."""
        if len(message) != _RECEIPT.size + _CRC.size:
            return
        content, crc = message[: -_CRC.size], message[-_CRC.size :]
        if _CRC.pack(fastcrc.crc16.genibus(content)) != crc:
            return
        _, robot, number, bits = _RECEIPT.unpack(content)
        if robot == self._robot:
            self._outgoing.confirm(number, bits)


def completed(own: ElevationMap | Submaps, received: ElevationMap) -> FloatArray:
    """Return the heights of a robot's map, and received ones where it knows nothing itself.

    Both robots have levelled their maps by themselves: the received heights are moved by the tilt
    and the height that fit the own map best, so that no step stands where one map ends.

    Args:
        own: The robot's own map, which stays as it is.
        received: What it has received, in the same frame and cells.

    Returns:
        (rows, columns) heights [m]; NaN where both know nothing.
    """
    there, whole = received.known, own.heights.copy()
    if there.any():
        points = np.column_stack([own.grid.centres[there], received.heights[there]])
        fitted = aligned(own, points, points.mean(axis=0), _APART).points[:, 2]
        whole[there] = np.where(own.known[there], whole[there], fitted)
    return whole


class _Outgoing:
    """The own map's changes, and the deltas of them that were sent.

    Args:
        elevation: The robot's own map.
        robot: Number of the robot.
        config: Budget, rate and order.
    """

    def __init__(self, elevation: ElevationMap, robot: int, config: MapSharingConfig) -> None:
        self._map, self._robot, self._config = elevation, robot, config
        shape = elevation.grid.shape
        tiles = int(np.prod(tile_counts(elevation.grid)))
        self._noted: BoolArray = np.zeros(shape, dtype=bool)
        self._sent: FloatArray = np.full(shape, np.nan)
        self._carrier = np.full(shape, _NONE)  # Number of the newest delta with each cell.
        self._waiting: BoolArray = np.zeros(shape, dtype=bool)
        self._rises: FloatArray | None = None
        self._stale = True  # Whether what waits has to be found anew.
        self._many, self._urgent, self._values = np.zeros((3, tiles))
        self._changed_at, self._sent_at = np.full((2, tiles), -math.inf)
        self._revisions = np.zeros(tiles, np.int64)
        self._next_number, self._fragments = 0, list[bytes]()
        self._unreceipted = dict[int, _Sent]()
        self._patience = config.patience

    def note(self, cells: IndexArray) -> None:
        """Note cells (K,), by flat index, whose height may have changed."""
        self._noted.flat[cells] = True
        self._rises, self._stale = None, True

    def next_fragment(self, now: float, most: int) -> bytes | None:
        """Return the next fragment, of a new delta if the last one has been handed out.

        Args:
            now: Time of the robot's own clock [s].
            most: Bytes that all fragments of a new delta may take.
        """
        if not self._fragments:
            self._give_up(now)
            if len(self._unreceipted) < self._config.unreceipted:
                self._fragments = self._next_delta(now, most)
        if not self._fragments:
            return None
        if (delta := self._unreceipted.get(self._next_number - 1)) is not None:
            delta.time = now
        return self._fragments.pop(0)

    def confirm(self, number: int, bits: int) -> None:
        """Take a receipt.

        Args:
            number: Number of the newest delta of which something has arrived, modulo 256.
            bits: Bit i is 1 if the i-th delta before that one, or itself, was complete.
        """
        newest = self._next_number - 1
        newest -= (newest - number) % _NUMBERS
        for own in list(self._unreceipted):
            before = newest - own
            if 0 <= before < _BITS and bits >> before & 1:
                del self._unreceipted[own]
            elif before >= self._config.late:
                self._send_again(own)
        self._patience = self._config.patience

    def _give_up(self, now: float) -> None:
        """Send again what has no receipt for too long, each time with more patience."""
        late = [n for n, sent in self._unreceipted.items() if now - sent.time > self._patience]
        for number in late:
            self._send_again(number)
        if late:
            self._patience = min(2.0 * self._patience, _MOST_PATIENCE)

    def _send_again(self, number: int) -> None:
        """Forget that the cells of a delta were sent, unless a newer one has them."""
        lost = self._unreceipted.pop(number)
        cells = lost.cells[self._carrier.flat[lost.cells] == number]
        self._sent.flat[cells] = np.nan
        self._noted.flat[cells] = True
        self._sent_at[lost.tile] = self._changed_at[lost.tile] = -math.inf
        self._waiting.flat[cells] = True  # So that the tile does not count as changed just now.
        self._stale = True

    def _find_waiting(self, now: float) -> None:
        """Find which cells wait to be sent, and what each tile is worth."""
        self._stale, config = False, self._config
        heights = self._map.heights
        known = self._noted & (np.abs(heights) <= LARGEST)
        fresh = known & np.isnan(self._sent)
        moved = known & (np.abs(heights - self._sent) >= STEP)
        waiting = fresh | moved
        changed = self._sums(waiting ^ self._waiting) > 0
        self._changed_at[changed] = now
        self._waiting = waiting
        if waiting.any() and self._rises is None:
            self._rises = rises(self._map)
        above = np.zeros(heights.shape) if self._rises is None else self._rises
        urgent = fresh & (above > config.climb)
        urgent |= moved & (np.abs(heights - self._sent) > config.climb)
        self._many, self._urgent = self._sums(waiting), self._sums(urgent)
        self._values = self._sums(fresh) + config.change_value * self._sums(moved)
        self._values += config.obstacle_value * self._urgent

    def _sums(self, cells: BoolArray) -> FloatArray:
        """Return (tiles,) the number of cells of each tile."""
        rows, columns = tile_counts(self._map.grid)
        whole = np.zeros((rows * TILE, columns * TILE))
        whole[: cells.shape[0], : cells.shape[1]] = cells
        return whole.reshape(rows, TILE, columns, TILE).sum(axis=(1, 3)).ravel()

    def _next_delta(self, now: float, most: int) -> list[bytes]:
        """Return the fragments of the delta that is worth most; none if no tile is ready.

        A tile is ready if it has an obstacle or many cells to send, or has been quiet, and was not
        sent just now.
        """
        if self._stale:
            self._find_waiting(now)
        quiet = now - self._config.quiet
        ready = (self._urgent > 0) | (self._many >= self._config.many_cells)
        ready |= self._changed_at <= quiet
        ready &= (self._many > 0) & (self._sent_at <= quiet)
        if not ready.any():
            return []
        tile = int(np.argmax(np.where(ready, self._values, -1.0)))
        part = tile_parts(self._map.grid, tile)
        rows, columns = np.nonzero(self._waiting[part])
        heights = rounded(self._map.heights[part][rows, columns])
        message = encode_delta(
            TileDelta(
                self._robot,
                tile,
                int(self._revisions[tile]) % _NUMBERS,
                rows * TILE + columns,
                heights,
                float(np.sqrt(self._map.variances[part][rows, columns].mean())),
            )
        )
        pieces = [message[at : at + _PAYLOAD] for at in range(0, len(message), _PAYLOAD)]
        if len(message) + _FRAGMENT.size * len(pieces) > most:
            return []
        number = self._next_number
        flat = (part[0].start + rows) * self._map.grid.shape[1] + part[1].start + columns
        self._sent.flat[flat], self._carrier.flat[flat] = heights, number
        self._noted.flat[flat] = self._waiting.flat[flat] = False
        self._many[tile] = self._urgent[tile] = 0.0
        self._sent_at[tile] = now
        self._revisions[tile] += 1
        self._next_number += 1
        self._unreceipted[number] = _Sent(tile, flat, now)
        head = FRAGMENT, self._robot, number % _NUMBERS
        return [
            _FRAGMENT.pack(*head, index << 4 | len(pieces) - 1) + piece
            for index, piece in enumerate(pieces)
        ]


class _Incoming:
    """The other robot's deltas, and the map that they make.

    Args:
        elevation: Map with as many cells as the other robot's.
        late: Number of newer deltas that may overtake one that is not lost.

    Attributes:
        map: What was received.
        dropped: Number of deltas that were damaged, or not complete when newer ones came.
        unreceipted: Numbers of deltas of which something came since the last receipt.
    """

    def __init__(self, elevation: ElevationMap, late: int) -> None:
        self.map = ElevationMap(elevation.grid, elevation.config)
        self.dropped, self.unreceipted = 0, set[int]()
        self._late, self._robot = late, 0
        tiles = int(np.prod(tile_counts(elevation.grid)))
        self._cell_revisions = np.full(elevation.grid.shape, _NONE)
        self._tile_revisions = np.full(tiles, _NONE)
        self._deltas, self._newest = dict[int, _Arriving](), _NONE

    def receipt(self) -> bytes:
        """Return a receipt of the newest deltas."""
        bits = sum(
            1 << before
            for before in range(_BITS)
            if (delta := self._deltas.get(self._newest - before)) is not None and delta.done
        )
        self.unreceipted.clear()
        content = _RECEIPT.pack(RECEIPT, self._robot, self._newest % _NUMBERS, bits)
        return content + _CRC.pack(fastcrc.crc16.genibus(content))

    def take(self, message: bytes) -> IndexArray:
        """Take a fragment, and return the cells (K,) that were set if its delta is complete."""
        _, robot, wrapped, part = _FRAGMENT.unpack_from(message)
        number = self._number_of(robot, wrapped)
        index, count = part >> 4, (part & 0xF) + 1
        delta = self._deltas.setdefault(number, _Arriving())
        self.unreceipted.add(number)
        if delta.done or index >= count:
            return _NO_CELLS
        if delta.count != count:
            delta.parts.clear()
        delta.count = count
        delta.parts[index] = message[_FRAGMENT.size :]
        if len(delta.parts) < count:
            return _NO_CELLS
        try:
            found = decode_delta(b"".join(delta.parts[i] for i in range(count)))
        except CodingError:
            found = None
        if found is None or found.robot != robot or not self._has(found):
            delta.parts.clear()
            self._drop(delta)
            return _NO_CELLS
        delta.done = True
        return self._set(found)

    def _number_of(self, robot: int, wrapped: int) -> int:
        """Return the number of a delta, not wrapped, and count those that it leaves behind."""
        apart = (wrapped - self._newest + _NUMBERS // 2) % _NUMBERS - _NUMBERS // 2
        if robot != self._robot or self._newest == _NONE or abs(apart) >= _BITS:
            # Much was lost, or the number is damaged: then the next one leads back.
            self._robot, self._newest = robot, wrapped
            self._deltas.clear()
            self.unreceipted.clear()
            return wrapped
        number = self._newest + apart
        for passed in range(self._newest - self._late + 1, number - self._late + 1):
            delta = self._deltas.get(passed)
            if delta is not None and not delta.done:
                self._drop(delta)
        for skipped in range(self._newest + 1, number):
            self._deltas.setdefault(skipped, _Arriving())
        self._newest = max(self._newest, number)
        if len(self._deltas) > _NUMBERS:
            oldest = self._newest - _BITS
            self._deltas = {n: delta for n, delta in self._deltas.items() if n >= oldest}
        return number

    def _drop(self, delta: _Arriving) -> None:
        """Count a delta as dropped, once."""
        self.dropped += not delta.dropped
        delta.dropped = True

    def _has(self, delta: TileDelta) -> bool:
        """Return whether the map has the cells of a delta."""
        if delta.tile >= len(self._tile_revisions):
            return False
        part = tile_parts(self.map.grid, delta.tile)
        rows, columns = np.divmod(delta.cells, TILE)
        height, width = self.map.heights[part].shape
        return bool(rows.max() < height and columns.max() < width)

    def _set(self, delta: TileDelta) -> IndexArray:
        """Set the cells of a delta that no newer one has set, and return them."""
        part, newest = tile_parts(self.map.grid, delta.tile), int(self._tile_revisions[delta.tile])
        revision = delta.revision
        if newest != _NONE:
            half = _NUMBERS // 2
            revision = newest + (revision - newest + half) % _NUMBERS - half
        self._tile_revisions[delta.tile] = max(revision, newest)
        rows, columns = np.divmod(delta.cells, TILE)
        newer = self._cell_revisions[part][rows, columns] < revision
        rows, columns = rows[newer], columns[newer]
        self._cell_revisions[part][rows, columns] = revision
        self.map.heights[part][rows, columns] = delta.heights[newer]
        self.map.variances[part][rows, columns] = delta.deviation**2 + STEP**2 / 12.0
        flat = (part[0].start + rows) * self.map.grid.shape[1] + part[1].start + columns
        return np.asarray(flat, np.intp)
