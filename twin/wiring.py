"""Which of a scene's MuJoCo sensors are wired to which channels of a robot."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numba
import numpy as np

from perception.geometry.arrays import FloatArray, IndexArray
from twin.description import RobotDescription
from twin.sensors import channel_widths

_ORIENTATION = "orientation"
_WRENCH = ("arm_base_force", "arm_base_torque")
# Pitch and roll and the heading feed on the orientation. From the bank's end, where every robot's
# channels are alike: behind the inclinometer come wrench, accelerometer, gyro and heading.
_PITCH, _HEADING = 15, 1
# These are computed with the accelerations, one physics step before the tick.
_ACCELERATION_CHANNELS: tuple[str, ...] = ("arm_base_wrench", "accelerometer")


class SensorWiring(NamedTuple):
    """Where a robot's true values come from.

    Attributes:
        wires: (values, 4) for each value its place in the bank, where it or its first sample
            lies, and of those that MuJoCo keeps a history of, how far apart the samples lie and
            how many they are; 0 samples for a value of the present.
        orientation: Where the quaternion of the front half begins; -1 for none.
        missing: Channels without a sensor.
        lags: Age of the value at a tick by channel name [s].
    """

    wires: IndexArray
    orientation: int
    missing: tuple[str, ...]
    lags: dict[str, float]


def direct(widths: Mapping[str, int]) -> SensorWiring:
    """Return a wiring in which every value comes from where it goes.

    Args:
        widths: How many values each channel has.
    """
    rows = [(i, i, 0, 0) for i in range(sum(widths.values()))]
    return SensorWiring(np.array(rows, dtype=np.intp), -1, (), {})


def wire(model: mujoco.MjModel, prefix: str, robot: RobotDescription) -> SensorWiring:
    """Find a robot's sensors in the scene.

    Args:
        model: The scene.
        prefix: What the names of the robot's elements begin with.
        robot: Its description.
    """
    # MuJoCo sensors behind the channels, with their widths; orientation feeds the inclinometer and
    # the heading.
    sensors: dict[str, list[tuple[str, int]]] = {
        "wheel_speeds": [(f"{wheel}_vel", 1) for wheel in robot.wheel_names],
        "centre_angle": [("centre_pos", 1)],
        "arm_angles": [(f"{joint}_pos", 1) for joint in robot.joint_names],
        "arm_rates": [(f"{joint}_vel", 1) for joint in robot.joint_names],
        "inclinometer": [],
        "arm_base_wrench": [(name, 3) for name in _WRENCH],
        "accelerometer": [("accelerometer", 3)],
        "gyro": [("gyro", 3)],
        "heading": [],
    }
    wires: list[tuple[int, int, int, int]] = []
    missing: list[str] = []
    place = wrench = 0
    for channel, width in channel_widths(robot).items():
        starts = [_sensor(model, prefix + sensor) for sensor, _ in sensors[channel]]
        if min(starts, default=0) < 0 or width == 0:
            missing.append(channel)
        else:
            first = place
            for start, (_, part) in zip(starts, sensors[channel]):
                wires.extend((first + i, start + i, 0, 0) for i in range(part))
                first += part
        wrench = place if channel == "arm_base_wrench" else wrench
        place += width
    averaged, samples = _averaged_wrench(model, prefix, wrench)
    replaced = {row[0] for row in averaged}
    wires = [row for row in wires if row[0] not in replaced] + averaged
    orientation = _sensor(model, prefix + _ORIENTATION)
    if orientation < 0:
        missing.extend(("inclinometer", "heading"))
    step = float(model.opt.timestep)
    lags = dict.fromkeys(_ACCELERATION_CHANNELS, step)
    # A mean of n samples, the last of them a step old, stands for its middle.
    lags["arm_base_wrench"] = step * (1 + samples) / 2
    rows = np.array(wires, dtype=np.intp).reshape(-1, 4)
    return SensorWiring(rows, orientation, tuple(missing), lags)


def _sensor(model: mujoco.MjModel, name: str) -> int:
    """Return where a sensor's data begins, or -1 if the scene lacks it."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    return int(model.sensor_adr[index]) if index >= 0 else -1


def _averaged_wrench(
    model: mujoco.MjModel, prefix: str, place: int
) -> tuple[list[tuple[int, int, int, int]], int]:
    """Return the wires of the wrench into MuJoCo's history, and how many samples that has.

    A force/torque transducer averages; one sample of a hundred a second would alias the steps of
    the motors' duty into the wrench. Without a history there are no wires, and one sample.
    """
    averaged: list[tuple[int, int, int, int]] = []
    count = 1
    width = 3
    for offset, sensor in zip((0, width), _WRENCH):
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, prefix + sensor)
        if index < 0 or model.sensor_history[index, 0] < 1:
            continue
        count = int(model.sensor_history[index, 0])
        # The buffer holds two words of book-keeping, the times, then the samples.
        first = int(model.sensor_historyadr[index]) + 2 + count
        averaged.extend((place + offset + i, first + i, width, count) for i in range(width))
    return averaged, count


@numba.njit(cache=True)
def tilt(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return pitch, roll and yaw [rad] of a body with orientation quaternion (w, x, y, z).

    Pitch is the elevation of the body's y axis (forward), roll the elevation of its x axis turned
    about y, yaw the azimuth of y: R = Rz(yaw) Rx(pitch) Ry(roll).
    """
    forward_up = 2.0 * (y * z + w * x)
    right_up = 2.0 * (x * z - w * y)
    up_up = w * w - x * x - y * y + z * z
    pitch = math.asin(max(-1.0, min(1.0, forward_up)))
    roll = math.atan2(-right_up, up_up)
    yaw = math.atan2(-2.0 * (x * y - w * z), w * w - x * x + y * y - z * z)
    return pitch, roll, yaw


@numba.njit(cache=True)
def gather(
    present: FloatArray,
    history: FloatArray,
    wires: IndexArray,
    orientation: int,
    raw: FloatArray,
) -> None:
    """Bring true values to their places, those with a history as its mean.

    Args:
        present: MuJoCo's sensordata.
        history: Its history.
        wires: Rows of wires, see `SensorWiring`.
        orientation: Place of the orientation, see `SensorWiring`.
        raw: (values,) receives them; what has no wire stays as it is.
    """
    for i in range(wires.shape[0]):
        place, first, stride, samples = wires[i, 0], wires[i, 1], wires[i, 2], wires[i, 3]
        if samples == 0:
            raw[place] = present[first]
            continue
        total = 0.0
        for sample in range(samples):
            total += history[first + sample * stride]
        raw[place] = total / samples
    if orientation >= 0:
        w, x, y, z = present[orientation : orientation + 4]
        pitch, heading = raw.size - _PITCH, raw.size - _HEADING
        raw[pitch], raw[pitch + 1], raw[heading] = tilt(w, x, y, z)
