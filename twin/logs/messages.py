"""Fields of messages: MCAP files with JSON or ROS 2 messages, and rosbag2 folders.

Messages are decoded by `rosbags` and `json`; nothing in a file is executed. A message is stamped by
its header, by ``stamp`` in seconds, or else by the time at which it was logged.
"""

import array
import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from mcap.reader import NonSeekingReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from perception.geometry.arrays import FloatArray
from twin.logs.log import Field

DEEPEST = 8
"""Most levels of a message that are looked at."""
LONGEST = 1024
"""Most items of a list that is looked at; those of an image or a cloud are left out."""
STAMPS = (".stamp", ".header.stamp.sec", ".header.stamp.nanosec")
"""Paths of what stamps a message, which are no fields of it."""
_NUMBERS = {float, int, bool}
SINCE_1970 = 10**17
"""Stamps from here on are of a calendar, not of a robot's own clock [ns]."""


class _Topic:
    """The messages of one topic as columns; those of one layout are kept together."""

    def __init__(self) -> None:
        self.stamps = array.array("q")  # [ns]
        self._parts: dict[tuple[object, ...], _Part] = {}

    def add(self, message: Any, logged: int) -> None:
        """Take one message.

        Args:
            message: Mapping, or a message of `rosbags`.
            logged: Time at which it was logged [ns].
        """
        values: list[float] = []
        layout: list[object] = []
        _flatten(message, values, layout, DEEPEST)
        key = tuple(layout)
        part = self._parts.get(key)
        if part is None:
            part = self._parts[key] = _Part(list(_paths(message, "", DEEPEST)))
        part.numbers.extend(values)
        part.places.append(len(self.stamps))
        self.stamps.append(part.stamp(values, logged))

    def fields(self, topic: str, notes: Mapping[str, str], origin: int) -> dict[str, Field]:
        """Return its columns by name, with stamps from an origin [ns] on."""
        stamps = 1e-9 * (np.array(self.stamps, dtype=np.int64) - origin).astype(float)
        columns: dict[str, FloatArray] = {}
        for part in self._parts.values():
            # No copy: an hour at 1 kHz takes hundreds of megabytes.
            rows = np.frombuffer(part.numbers).reshape(len(part.places), len(part.paths))
            for path, values in zip(part.paths, rows.T):
                if path in STAMPS:
                    continue
                if len(self._parts) == 1:
                    columns[path] = values
                    continue
                column = columns.setdefault(path, np.full(len(stamps), np.nan))
                column[np.array(part.places)] = values
        return {topic + path: Field(stamps, column, notes) for path, column in columns.items()}


class _Part:
    """Messages of one layout.

    Args:
        paths: Path of each of their numbers.
    """

    def __init__(self, paths: list[str]) -> None:
        self.paths = paths
        self.numbers, self.places = array.array("d"), array.array("q")
        self._stamp = [paths.index(path) for path in STAMPS if path in paths]

    def stamp(self, values: list[float], logged: int) -> int:
        """Return the stamp that a message bears, else the time at which it was logged [ns]."""
        match [values[index] for index in self._stamp]:
            case [seconds, nanoseconds]:
                return 10**9 * int(seconds) + int(nanoseconds)
            case [seconds]:
                return round(1e9 * seconds)
            case _:
                return logged


def read_mcap(path: Path) -> dict[str, Field]:
    """Read an MCAP file of JSON or ROS 2 messages; topics in other encodings are left out."""
    topics: dict[str, _Topic] = {}
    notes: dict[str, Mapping[str, str]] = {}
    decoders: dict[int, Callable[[bytes], Any] | None] = {}
    with path.open("rb") as stream:
        # The other reader holds all messages of a file at once, whatever their order.
        messages = NonSeekingReader(stream).iter_messages(log_time_order=False)
        for schema, channel, message in messages:
            if channel.id not in decoders:
                kind = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
                decoders[channel.id] = _decoder(channel.message_encoding, *kind)
            if (decode := decoders[channel.id]) is not None:
                topic = topics.setdefault(channel.topic, _Topic())
                notes[channel.topic] = channel.metadata
                topic.add(decode(message.data), message.log_time)
    return _joined(topics, notes)


def read_bag(path: Path) -> dict[str, Field]:
    """Read the folder of a rosbag2, stored in sqlite or MCAP; its types need not be installed."""
    topics: dict[str, _Topic] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, logged, data in reader.messages():
            topic = topics.setdefault(connection.topic, _Topic())
            topic.add(reader.deserialize(data, connection.msgtype), logged)
    return _joined(topics, {})


def _joined(
    topics: Mapping[str, _Topic], notes: Mapping[str, Mapping[str, str]]
) -> dict[str, Field]:
    # A double holds the seconds of a calendar to 240 ns only.
    first = min((min(topic.stamps) for topic in topics.values() if topic.stamps), default=0)
    origin = first - first % 10**9 if first > SINCE_1970 else 0
    fields: dict[str, Field] = {}
    for name, topic in topics.items():
        fields |= topic.fields(name, notes.get(name, {}), origin)
    return fields


def _decoder(
    encoding: str, name: str, schema_encoding: str, schema: bytes
) -> Callable[[bytes], Any] | None:
    """Return what decodes a channel's messages; None if nothing here does."""
    if encoding == "json":
        return json.loads
    if encoding != "cdr" or schema_encoding != "ros2msg":
        return None
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.decode(), name))
    return lambda data: store.deserialize_cdr(data, name)


def _flatten(value: Any, values: list[float], layout: list[object], depth: int) -> None:
    """Append the numbers of a message, and what tells its layout from another one."""
    if value is None or type(value) in _NUMBERS:
        layout.append(float)
        values.append(math.nan if value is None else value)
    elif depth == 0 or isinstance(value, str | bytes):
        return
    elif isinstance(value, np.ndarray):
        items = _items(value)
        layout.append(len(items))
        values.extend(items)
    elif isinstance(value, list):
        items = _items(value)
        layout.append(len(items))
        kinds = set(map(type, items))
        if kinds <= _NUMBERS:
            values.extend(items)
        elif kinds <= _NUMBERS | {type(None)}:
            values.extend(math.nan if item is None else item for item in items)
        elif kinds == {str}:
            layout.extend(items)  # names of joints
        else:
            for item in items:
                _flatten(item, values, layout, depth - 1)
    else:
        for member, below in _members(value).items():
            layout.append(member)
            _flatten(below, values, layout, depth - 1)


def _paths(value: Any, path: str, depth: int, joints: object = None) -> Iterator[str]:
    """Yield the paths of a message's numbers, in the order of `_flatten`.

    Args:
        value: The message, or a part of it.
        path: Path of that part.
        depth: Levels that are looked at.
        joints: What stands beside the part as ``name``: names for the items of a list as long.
    """
    if value is None or type(value) in _NUMBERS:
        yield path
    elif depth == 0 or isinstance(value, str | bytes):
        return
    elif isinstance(value, list | np.ndarray):
        items = _items(value)
        named = isinstance(joints, list) and len(cast("list[object]", joints)) == len(items)
        labels = cast("list[object]", joints) if named else range(len(items))
        for label, item in zip(labels, items):
            yield from _paths(item, f"{path}[{label}]", depth - 1)
    else:
        members = _members(value)
        for member, below in members.items():
            yield from _paths(below, f"{path}.{member}", depth - 1, members.get("name"))


def _items(value: Any) -> list[Any]:
    """Return a list, or an array as one; none of one that is too long."""
    if len(value) > LONGEST:
        return []
    return cast("list[Any]", value if isinstance(value, list) else value.tolist())


def _members(message: Any) -> dict[str, Any]:
    return cast("dict[str, Any]", message if isinstance(message, dict) else vars(message))
