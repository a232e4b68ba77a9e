"""Reading an hour of a log in each format, beside the format's library, and the memory it takes.

The robot logs ten joints and ten commands a thousand times a second. Each format is read in a
process of its own: by `twin.logs`, and by its library alone, which decodes rows or messages and
leaves them.
"""

# pyarrow has no types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false

import dataclasses
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from mcap.reader import NonSeekingReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from experiments.bench.bench_options import Options
from experiments.harness.output import Output
from twin.logs.fields import read_fields
from twin.logs.lerobot import write_lerobot
from twin.logs.log import Log, Signal
from twin.logs.writing import write_mcap

RATE, WIDTH = 1000, 10
"""Samples a second [Hz], and numbers of each of the two signals."""
DURATION, QUICK_DURATION = 3600.0, 2.0
"""[s]."""
TABLE, MESSAGES = 20.0, 120.0
"""Most seconds in which an hour is read from a table, or from messages."""
MEMORY = 2e9
"""Most memory of a process that reads an hour [B]."""


@dataclasses.dataclass(frozen=True)
class Format:
    """A format of logs.

    Attributes:
        write: Function that writes a log to a path.
        read_alone: Function that reads a path with the format's library, and keeps nothing.
        file: Name of the file or folder.
        most: Most seconds in which an hour is read.
    """

    write: Callable[[Log, Path], None]
    read_alone: Callable[[Path], None]
    file: str
    most: float


def bench_logs(options: Options, output: Output) -> None:
    """Write a log in each format, and read it.

    Args:
        options: ``quick`` takes 2 s in place of an hour; ``seed`` draws the numbers.
        output: Receives ``log_read_s/<format>``, ``log_read_ratio/<format>`` over its library, and
            ``log_memory_mb/<format>``.
    """
    duration = QUICK_DURATION if options.quick else DURATION
    log = _log(duration, np.random.default_rng(options.seed))
    with tempfile.TemporaryDirectory() as folder:
        for name, each in FORMATS.items():
            path = Path(folder) / each.file
            each.write(log, path)
            seconds, memory = _in_own_process(partial(_read, duration), path)
            alone, _ = _in_own_process(each.read_alone, path)
            output.measure(f"log_read_s/{name}", seconds)
            output.measure(f"log_read_ratio/{name}", seconds / alone)
            output.measure(f"log_memory_mb/{name}", 1e-6 * memory)
            if not options.quick:
                subject = f"an hour of {name}"
                output.check(f"{subject} [s]", seconds, f"<= {each.most:g}", seconds <= each.most)
                text, least = f"<= {MEMORY:g}", memory <= MEMORY
                output.check(f"{subject} [bytes of memory]", memory, text, least)


def _log(duration: float, rng: np.random.Generator) -> Log:
    stamps = np.arange(round(RATE * duration)) / RATE
    shape = len(stamps), WIDTH
    return Log(
        {
            "arm": Signal("actuator", stamps, rng.normal(size=shape), "N m"),
            "joints": Signal("sensor", stamps, rng.normal(size=shape), "rad"),
        }
    )


def _in_own_process(read: Callable[[Path], None], path: Path) -> tuple[float, float]:
    """Return the time [s] that reading takes, and the most memory of the process [B]."""
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, fresh) as pool:
        return pool.submit(_timed, read, path).result()


def _timed(read: Callable[[Path], None], path: Path) -> tuple[float, float]:
    begin = time.perf_counter()
    read(path)
    return time.perf_counter() - begin, _most_memory()


def _most_memory() -> float:
    """Return the most memory that this process has taken [B]."""
    told = Path("/proc/self/status")
    if told.exists():
        # What `getrusage` says holds for the process from which this one was started, too.
        lines = dict(line.split(":", 1) for line in told.read_text().splitlines())
        return 1024.0 * float(lines["VmHWM"].split()[0])
    unit = 1 if sys.platform == "darwin" else 1024
    return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def _read(duration: float, path: Path) -> None:
    fields = read_fields(path)
    count = round(RATE * duration)
    sizes = {each.values.size for name, each in fields.items() if "effort" not in name}
    assert sizes == {count} and len(fields) >= 2 * WIDTH, f"{path}: {len(fields)} fields of {sizes}"


def _columns(log: Log) -> dict[str, np.ndarray]:
    return {
        f"{name}{index}": column
        for name, signal in log.signals.items()
        for index, column in enumerate(signal.values.T)
    }


def _write_csv(log: Log, path: Path) -> None:
    stamps = next(iter(log.signals.values())).stamps
    pyarrow.csv.write_csv(pa.table({"t": stamps, **_columns(log)}), path)


def _write_bag(storage: StoragePlugin, log: Log, path: Path) -> None:
    """Write states of joints and arrays of commands, as ROS 2 has them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = store.types
    clock, header = kinds["builtin_interfaces/msg/Time"], kinds["std_msgs/msg/Header"]
    state, array = kinds["sensor_msgs/msg/JointState"], kinds["std_msgs/msg/Float64MultiArray"]
    layout = kinds["std_msgs/msg/MultiArrayLayout"]([], 0)
    names, none = [f"joint{index}" for index in range(WIDTH)], np.zeros(0)
    joints, arm = log.signals["joints"], log.signals["arm"]
    with Writer(path, version=9, storage_plugin=storage) as bag:
        states = bag.add_connection("/joint_states", state.__msgtype__, typestore=store)
        commands = bag.add_connection("/commands", array.__msgtype__, typestore=store)
        for stamp, angles, efforts in zip(joints.stamps, joints.values, arm.values):
            tick = round(1e9 * float(stamp))
            when = header(clock(*divmod(tick, 10**9)), "")
            message = state(when, names, angles, none, none)
            bag.write(states, tick, store.serialize_cdr(message, state.__msgtype__))
            message = array(layout, efforts)
            bag.write(commands, tick, store.serialize_cdr(message, array.__msgtype__))


def _decode_mcap(path: Path) -> None:
    with path.open("rb") as stream:
        for _, _, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
            json.loads(message.data)


def _decode_bag(path: Path) -> None:
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)


def _read_parquet(path: Path) -> None:
    for each in sorted(path.rglob("data/**/*.parquet")):
        pyarrow.parquet.read_table(each)


def _read_csv(path: Path) -> None:
    pyarrow.csv.read_csv(path)


FORMATS: Mapping[str, Format] = {
    "csv": Format(_write_csv, _read_csv, "run.csv", TABLE),
    "lerobot": Format(partial(write_lerobot, rate=RATE), _read_parquet, "dataset", TABLE),
    "mcap": Format(write_mcap, _decode_mcap, "run.mcap", MESSAGES),
    "bag": Format(partial(_write_bag, StoragePlugin.SQLITE3), _decode_bag, "bag", MESSAGES),
    "mcap_bag": Format(partial(_write_bag, StoragePlugin.MCAP), _decode_bag, "mcap", MESSAGES),
}
"""Formats by name."""
