"""Which field of a log is which actuator or sensor: a mapping that a person writes, in TOML.

``docs/running.md`` has an example. Without a mapping the fields of our own logs are used as they
say of themselves.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard, TypeVar, cast

import numpy as np

from perception.geometry import files
from perception.geometry.arrays import FloatArray
from twin.logs.fields import read_fields
from twin.logs.log import Field, Log, LogError, Role, Signal

UNITS: dict[str, tuple[float, str]] = {
    "": (1.0, ""), "1": (1.0, "1"), "%": (0.01, "1"),
    "s": (1.0, "s"), "ms": (1e-3, "s"), "us": (1e-6, "s"), "ns": (1e-9, "s"),
    "m": (1.0, "m"), "cm": (1e-2, "m"), "mm": (1e-3, "m"), "in": (0.0254, "m"),
    "m/s": (1.0, "m/s"), "mm/s": (1e-3, "m/s"), "km/h": (1.0 / 3.6, "m/s"),
    "m/s^2": (1.0, "m/s^2"), "g": (9.80665, "m/s^2"), "mg": (9.80665e-3, "m/s^2"),
    "rad": (1.0, "rad"), "mrad": (1e-3, "rad"), "deg": (np.pi / 180.0, "rad"),
    "rev": (2.0 * np.pi, "rad"),
    "rad/s": (1.0, "rad/s"), "deg/s": (np.pi / 180.0, "rad/s"), "rpm": (np.pi / 30.0, "rad/s"),
    "N": (1.0, "N"), "kN": (1e3, "N"), "lbf": (4.4482216152605, "N"),
    "N, N m": (1.0, "N, N m"), "N m": (1.0, "N m"), "N mm": (1e-3, "N m"), "N cm": (1e-2, "N m"),
    "V": (1.0, "V"), "mV": (1e-3, "V"), "A": (1.0, "A"), "mA": (1e-3, "A"),
    "Pa": (1.0, "Pa"), "bar": (1e5, "Pa"), "K": (1.0, "K"),
}  # fmt: skip
"""What a unit is in SI units, and the name of that one."""
_ROLES: dict[str, Role] = {"actuators": "actuator", "sensors": "sensor"}
_Item = TypeVar("_Item")
_KEYS = {"field", "fields", "unit", "scale", "sign", "delay", "frame", "noise", "dead_band"}


@dataclasses.dataclass(frozen=True)
class Source:
    """Where the samples of an actuator or sensor stand in a log.

    Attributes:
        role: What they are of.
        fields: Names of the fields, one for each of its numbers.
        unit: Unit of the fields, a key of `UNITS`.
        signs: One factor, 1 or -1, for each field.
        delay: Age of a sample at its stamp [s].
        frame: Frame of a vector.
        noise: Standard deviation of a sensor's noise, in the fields' numbers; NaN if not known.
        scale: What one of the fields' numbers is in their unit, such as that of a count.
        dead_band: Size below which an actuator's command does nothing, in the fields' numbers.
    """

    role: Role
    fields: tuple[str, ...]
    unit: str = ""
    signs: tuple[float, ...] = ()
    delay: float = 0.0
    frame: str = ""
    noise: float = math.nan
    scale: float = 1.0
    dead_band: float = 0.0

    def signal(self, fields: Mapping[str, Field]) -> Signal:
        """Return its samples in SI units.

        Raises:
            LogError: If a field is not there, or the fields have other stamps.
        """
        for name in self.fields:
            if name not in fields:
                raise LogError(f"no field {name}; there are {', '.join(sorted(fields)) or 'none'}")
        chosen = [fields[name] for name in self.fields]
        stamps, columns = _together(self.fields, chosen)
        factor, unit = UNITS[self.unit]
        factor *= self.scale
        signs = np.array(self.signs or [1.0] * len(chosen))
        values = factor * signs * np.where(np.abs(columns) < self.dead_band, 0.0, columns)
        noise = factor * self.noise
        return Signal(self.role, stamps - self.delay, values, unit, self.frame, noise)


def _together(names: Sequence[str], fields: Sequence[Field]) -> tuple[FloatArray, FloatArray]:
    """Return the stamps (n,) of some fields, and their values (n, k), NaN where one has none.

    Raises:
        LogError: If less than half of the stamps are those of all fields.
    """
    stamps = fields[0].stamps
    if all(np.array_equal(each.stamps, stamps) for each in fields):
        return stamps, np.column_stack([each.values for each in fields])
    stamps, counts = np.unique(np.concatenate([each.stamps for each in fields]), return_counts=True)
    if 2 * np.count_nonzero(counts == len(fields)) < len(stamps):
        raise LogError(f"fields {', '.join(names)} were not sampled together")
    values = np.full((len(stamps), len(fields)), np.nan)
    for column, each in enumerate(fields):
        values[np.searchsorted(stamps, each.stamps), column] = each.values
    return stamps, values


@dataclasses.dataclass(frozen=True)
class LogMapping:
    """What the fields of a log are.

    Attributes:
        sources: Where the samples of each actuator and sensor stand, by its name in the model.
        time: Column of a CSV file that holds the stamps; empty for the usual ones.
        time_unit: Unit of that column, a key of `UNITS`.
        episode: Episode of a LeRobot dataset.
    """

    sources: Mapping[str, Source]
    time: str = ""
    time_unit: str = "s"
    episode: int = 0


def read_mapping(path: Path) -> LogMapping:
    """Read a mapping.

    Raises:
        LogError: In one line that names the file, the entry, and what is expected.
    """
    try:
        content = files.read_toml(path, files.SETTINGS)
        return _mapping(content)
    except (OSError, ValueError, TypeError) as error:
        text = error.strerror if isinstance(error, OSError) else error
        raise LogError(f"{path}: {text}") from None


def read_log(path: Path, mapping: LogMapping | None = None) -> Log:
    """Read a log in SI units.

    Args:
        path: File or folder, as `read_fields` takes it.
        mapping: What its fields are; None for a log of our own, which says so itself.

    Raises:
        LogError: If it cannot be read, or the mapping does not fit it.
    """
    if mapping is None:
        fields = read_fields(path)
        sources = own_sources(fields)
        if not sources:
            raise LogError(f"{path}: no log of ours, so a mapping has to say what its fields are")
    else:
        scale = UNITS[mapping.time_unit][0]
        fields = read_fields(path, mapping.time, scale, mapping.episode)
        sources = mapping.sources
    try:
        return Log({name: each.signal(fields) for name, each in sources.items()})
    except LogError as error:
        raise LogError(f"{path}: {error}") from None


def own_sources(fields: Mapping[str, Field]) -> dict[str, Source]:
    """Return what the fields of our own logs say of themselves, in their notes."""
    found: dict[str, tuple[Role, Mapping[str, str], list[str]]] = {}
    for field, each in fields.items():
        role = each.notes.get("role")
        if role == "actuator" or role == "sensor":
            found.setdefault(each.notes["name"], (role, each.notes, []))[2].append(field)
    return {
        name: Source(role, tuple(names), notes["unit"], frame=notes["frame"])
        for name, (role, notes, names) in found.items()
    }


def _mapping(content: Mapping[str, Any]) -> LogMapping:
    known = {"time", "time_unit", "episode", *_ROLES}
    if unknown := sorted(content.keys() - known):
        raise LogError(f"unknown entry {unknown[0]}; there are {', '.join(sorted(known))}")
    sources: dict[str, Source] = {}
    for table, role in _ROLES.items():
        entries = content.get(table, {})
        if not isinstance(entries, dict):
            raise LogError(f"{table}: expected a table [{table}.NAME] for each")
        for name, entry in cast("dict[str, Any]", entries).items():
            if name in sources:
                raise LogError(f"{name} is both an actuator and a sensor")
            sources[name] = _source(f"{table}.{name}", role, entry)
    if not sources:
        raise LogError("no actuator and no sensor; add [actuators.NAME] or [sensors.NAME]")
    time, episode = content.get("time", ""), content.get("episode", 0)
    if not isinstance(time, str) or not isinstance(episode, int):
        raise LogError("time is the name of a column, episode a whole number")
    return LogMapping(
        sources, time, _unit("time_unit", content.get("time_unit", "s"), "s"), episode
    )


def _source(where: str, role: Role, entry: Any) -> Source:
    if not isinstance(entry, dict) or not set(table := cast("dict[str, Any]", entry)) <= _KEYS:
        raise LogError(f"{where}: expected some of {', '.join(sorted(_KEYS))}")
    if ("field" in table) == ("fields" in table):
        raise LogError(f"{where}: expected either field or fields")
    names = table.get("fields", [table.get("field")])
    if not _is_list_of(str, names) or not names:
        raise LogError(f"{where}: fields are names, one or more")
    signs = table.get("sign", 1)
    signs = [signs] * len(names) if isinstance(signs, int) else signs
    if not _is_list_of(int, signs) or len(signs) != len(names) or not set(signs) <= {1, -1}:
        raise LogError(f"{where}: sign is 1 or -1, or a list of {len(names)} of these")
    frame, delay = table.get("frame", ""), table.get("delay", 0.0)
    if not isinstance(frame, str):
        raise LogError(f"{where}: frame is a name")
    noise = table.get("noise", math.nan)
    if not isinstance(noise, int | float) or noise <= 0.0:
        raise LogError(f"{where}: noise is a number above 0, as the fields' own are")
    scale = table.get("scale", 1.0)
    if not isinstance(scale, int | float) or not 0.0 < scale < math.inf:
        raise LogError(f"{where}: scale is a number above 0")
    dead_band = table.get("dead_band", 0.0)
    if not isinstance(dead_band, int | float) or not 0.0 <= dead_band < math.inf:
        raise LogError(f"{where}: dead_band is a number, at least 0, as the fields' own are")
    if dead_band and role == "sensor":
        raise LogError(f"{where}: dead_band is of an actuator's commands")
    unit = _unit(f"{where}: unit", table.get("unit", ""), None)
    late = _seconds(f"{where}: delay", delay)
    return Source(
        role, tuple(names), unit, tuple(signs), late, frame, float(noise), scale, dead_band
    )


def _is_list_of(kind: type[_Item], value: Any) -> TypeGuard[list[_Item]]:
    return isinstance(value, list) and all(isinstance(each, kind) for each in cast(Any, value))


def _unit(where: str, unit: Any, of: str | None) -> str:
    """Return a unit if it is known and, in SI units, the one that is asked for."""
    known = [name for name, (_, si) in UNITS.items() if of is None or si == of]
    if unit not in known:
        raise LogError(
            f"{where} {unit!r}: expected one of {', '.join(known[1:] if of is None else known)}"
        )
    return unit


def _seconds(where: str, delay: Any) -> float:
    """Return a delay, a number [s] or a text with its unit, in seconds."""
    number, _, unit = str(delay).partition(" ")
    factor, _ = UNITS[_unit(where, unit or "s", "s")]
    try:
        return float(number) * factor
    except ValueError:
        raise LogError(f"{where} {delay!r}: expected seconds, or a text such as '4 ms'") from None
