"""One run of a robot that is not ours, written in each format by its own library."""

import csv
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import rerun as rr
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

ROS = get_typestore(Stores.ROS2_JAZZY)
TYPES = ROS.types
NANO = 10**9


class Run:
    """Half a second of two joints, a gyro and two motors at 100 Hz; in SI units."""

    def __init__(self, seed, begin=1_700_000_000.0, count=50):
        rng = np.random.default_rng(seed)
        self.begin = round(begin * NANO)
        self.ticks = self.begin + 10_000_000 * np.arange(count)  # [ns]
        self.angles = rng.uniform(-2.0, 2.0, (count, 2))
        self.gyro = rng.normal(size=(count, 3))
        self.torques = rng.normal(size=(count, 2))

    @property
    def times(self):
        """Times since the whole second in which the run began [s]."""
        return 1e-9 * (self.ticks - self.begin // NANO * NANO).astype(float)


def mapping(joints, gyro, motors):
    """The mapping of a log in SI units, by the names of its fields."""
    return (
        f"[sensors.joints]\nfields = {joints}\nunit = 'rad'\n"
        f"[sensors.gyro]\nfields = {gyro}\nunit = 'rad/s'\nframe = 'base'\n"
        f"[actuators.motors]\nfields = {motors}\nunit = 'N m'\n"
    )


def write_csv(run, path):
    """Milliseconds, degrees, and one motor turned the other way."""
    with path.open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["clock", "note", "elbow", "wrist", "gx", "gy", "gz", "m1", "m2"])
        for time, angles, gyro, torques in zip(run.times, run.angles, run.gyro, run.torques):
            numbers = [*np.degrees(angles), *np.degrees(gyro), torques[0], -torques[1]]
            rows.writerow([repr(1e3 * float(time)), "ok", *map(repr, map(float, numbers))])
    return path


CSV_MAPPING = """
time = "clock"
time_unit = "ms"
[sensors.joints]
fields = ["elbow", "wrist"]
unit = "deg"
[sensors.gyro]
fields = ["gx", "gy", "gz"]
unit = "deg/s"
frame = "base"
[actuators.motors]
fields = ["m1", "m2"]
unit = "N m"
sign = [1, -1]
"""


def messages(run):
    """Yield topic, ROS type, message and time of each message."""
    header = TYPES["std_msgs/msg/Header"]
    clock = TYPES["builtin_interfaces/msg/Time"]
    vector, turn = TYPES["geometry_msgs/msg/Vector3"], TYPES["geometry_msgs/msg/Quaternion"]
    for tick, angles, gyro, torques in zip(run.ticks.tolist(), run.angles, run.gyro, run.torques):
        stamp = header(clock(tick // NANO, tick % NANO), "base")
        nothing = np.zeros(0)
        joints = (stamp, ["wrist", "elbow"], angles[::-1].copy(), nothing, nothing)
        yield "/joint_states", "sensor_msgs/msg/JointState", joints, tick
        covariance = np.zeros(9)
        imu = (
            stamp, turn(0.0, 0.0, 0.0, 1.0), covariance, vector(*gyro.tolist()), covariance,
            vector(0.0, 0.0, 9.8), covariance,
        )  # fmt: skip
        yield "/imu", "sensor_msgs/msg/Imu", imu, tick
        layout = TYPES["std_msgs/msg/MultiArrayLayout"]([], 0)
        yield "/commands", "std_msgs/msg/Float64MultiArray", (layout, torques), tick


ROS_MAPPING = mapping(
    ["/joint_states.position[elbow]", "/joint_states.position[wrist]"],
    ["/imu.angular_velocity.x", "/imu.angular_velocity.y", "/imu.angular_velocity.z"],
    ["/commands.data[0]", "/commands.data[1]"],
)


def write_bag(run, path, storage="sqlite3", late=0):
    """A rosbag2, each message logged late by so many nanoseconds."""
    plugin = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[storage]
    with BagWriter(path, version=9, storage_plugin=plugin) as bag:
        connections = {}
        for topic, kind, parts, tick in messages(run):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=ROS)
            data = ROS.serialize_cdr(TYPES[kind](*parts), kind)
            bag.write(connections[topic], tick + (0 if topic == "/commands" else late), data)
    return path


def write_json_mcap(run, path):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b'{"type": "object"}')
        topics = {
            name: writer.register_channel(name, "json", schema)
            for name in ("/joint_states", "/imu", "/commands")
        }
        for tick, angles, gyro, torques in zip(
            run.ticks.tolist(), run.angles.tolist(), run.gyro.tolist(), run.torques.tolist()
        ):
            axes = dict(zip("xyz", gyro))
            for name, message in (
                ("/joint_states", {"name": ["wrist", "elbow"], "position": angles[::-1]}),
                ("/imu", {"angular_velocity": axes, "frame_id": "base"}),
                ("/commands", {"data": torques}),
            ):
                writer.add_message(topics[name], tick, json.dumps(message).encode(), tick)
        writer.finish()
    return path


def write_lerobot(run, path, episodes=2):
    """A dataset of two episodes, the second of which is the run."""
    (path / "meta").mkdir(parents=True)
    (path / "data" / "chunk-000").mkdir(parents=True)
    features = {
        "observation.state": {"dtype": "float32", "shape": [5],
                              "names": ["elbow", "wrist", "gx", "gy", "gz"]},
        "action": {"dtype": "float32", "shape": [2], "names": {"motors": ["m1", "m2"]}},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        "frame_index": {"dtype": "int64", "shape": [1], "names": None},
        "episode_index": {"dtype": "int64", "shape": [1], "names": None},
        "index": {"dtype": "int64", "shape": [1], "names": None},
        "task_index": {"dtype": "int64", "shape": [1], "names": None},
    }  # fmt: skip
    info = {"codebase_version": "v3.0", "fps": 100, "features": features}
    info |= {"total_episodes": episodes, "total_frames": episodes * len(run.ticks)}
    (path / "meta" / "info.json").write_text(json.dumps(info))
    state = np.hstack([run.angles, run.gyro]).astype(np.float32)
    count = len(run.ticks)
    for episode in range(episodes):
        fake = 0.0 if episode < episodes - 1 else 1.0
        table = pa.table(
            {
                "observation.state": list(fake * state),
                "action": list(fake * run.torques.astype(np.float32)),
                "timestamp": (np.arange(count) / 100.0).astype(np.float32),
                "frame_index": np.arange(count),
                "episode_index": np.full(count, episode),
                "index": np.arange(count),
                "task_index": np.zeros(count, int),
            }
        )
        pyarrow.parquet.write_table(table, path / "data/chunk-000" / f"file-{episode:03d}.parquet")
    return path


LEROBOT_MAPPING = "episode = 1\n" + mapping(
    ["observation.state[elbow]", "observation.state[wrist]"],
    ["observation.state[gx]", "observation.state[gy]", "observation.state[gz]"],
    ["action[m1]", "action[m2]"],
)


def write_recording(run, path):
    stream = rr.RecordingStream("test")
    stream.save(path)
    for time, angles, gyro, torques in zip(run.times, run.angles, run.gyro, run.torques):
        stream.set_time("sim_time", duration=np.timedelta64(round(1e9 * time), "ns"))
        for name, values in (("joints", angles), ("gyro", gyro), ("motors", torques)):
            stream.log(f"robot/{name}", rr.Scalars(values))
    stream.flush()
    stream.disconnect()
    return path


RECORDING_MAPPING = mapping(
    ["/robot/joints[0]", "/robot/joints[1]"],
    ["/robot/gyro[0]", "/robot/gyro[1]", "/robot/gyro[2]"],
    ["/robot/motors[0]", "/robot/motors[1]"],
)
