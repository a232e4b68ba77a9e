"""What a rover's channels read, computed from the states of many models at once."""

import mujoco
import numpy as np

from models.datasheets import INCLINOMETER
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import apparent_tilt
from twin.description import RobotDescription
from twin.robot import Channel, Observation, Validity
from twin.sensors import DATASHEET, channel_widths

CHANNELS = (
    "wheel_speeds", "centre_angle", "arm_angles", "arm_rates", "inclinometer", "arm_base_wrench",
    "accelerometer", "gyro",
)  # fmt: skip
"""Channels that a shadow compares: all but images and the heading, which nothing else tells."""


class Readings:
    """Where a model has what a rover's channels read.

    Args:
        model: A scene without histories of sensors.
        robot: The rover as drawn.

    Attributes:
        size: Count of all numbers.
        channels: Where each channel's numbers are, by its name.
        sigma: (size,) standard deviations of the noise by datasheet, rounding included.
        joints: Addresses of the arm's joints in the positions and in the rates.
        wheels: Addresses of the wheels in the rates.
        springs: Addresses of the springs in the rates.
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotDescription) -> None:
        self.channels: dict[str, slice[int, int, None]] = {}
        widths = channel_widths(robot)
        self.size = 0
        for name in CHANNELS:
            self.channels[name] = slice(self.size, self.size + widths[name])
            self.size += widths[name]
        self.sigma: FloatArray = np.concatenate([_sigma(name, widths[name]) for name in CHANNELS])
        joints = [model.joint(f"{robot.name}/{name}_joint") for name in robot.joint_names]
        self.joints = (
            np.array([joint.qposadr[0] for joint in joints], dtype=np.intp),
            np.array([joint.dofadr[0] for joint in joints], dtype=np.intp),
        )
        self.wheels, self.springs = (
            np.array(
                [model.joint(f"{robot.name}/{wheel}{end}").dofadr[0] for wheel in robot.wheel_names]
            )
            for end in ("_joint", "_suspension_joint")
        )
        centre = model.joint(f"{robot.name}/centre_joint")
        self.centre = int(centre.qposadr[0]), int(centre.dofadr[0])
        self._positions = 1 + model.nq
        #: Columns of the sensors' data with the wrench and the specific force.
        self.forces = np.concatenate(
            [
                model.sensor(f"{robot.name}/{name}").adr[0] + np.arange(3)
                for name in ("arm_base_force", "arm_base_torque", "accelerometer")
            ]
        )
        keep = np.exp(-2.0 * np.pi * INCLINOMETER.bandwidth * model.opt.timestep)
        self._keep = float(keep)

    def expect(self, states: FloatArray, sensed: FloatArray, tilts: FloatArray) -> FloatArray:
        """Return what the channels read (m, size) at the end of a tick.

        Args:
            states: (m, ...) states of the simulations at its end: time, positions, rates.
            sensed: (m, steps, ...) data of the sensors before each of its steps.
            tilts: (m, 2) what the inclinometer's masses show; brought to the end of the tick.
        """
        positions, rates = states[:, 1 : self._positions], states[:, self._positions :]
        felt = sensed[:, :, self.forces]
        for step in range(felt.shape[1]):
            shown = apparent_tilt(felt[:, step, 6:], INCLINOMETER.linear_range)
            tilts += (1.0 - self._keep) * (shown - tilts)
        mean = felt.mean(axis=1)
        parts = {
            "wheel_speeds": rates[:, self.wheels],
            "centre_angle": positions[:, self.centre[:1]],
            "arm_angles": positions[:, self.joints[0]],
            "arm_rates": rates[:, self.joints[1]],
            "inclinometer": tilts,
            "arm_base_wrench": mean[:, :6],
            "accelerometer": mean[:, 6:],
            "gyro": rates[:, 3:6],
        }
        return np.concatenate([parts[name] for name in CHANNELS], axis=1)

    def linear(self, sensed: FloatArray, freedoms: int) -> FloatArray:
        """Return how the readings change (size, 2 freedoms) with places and rates.

        Args:
            sensed: (sensors, 2 freedoms) how the sensors' data change with them.
            freedoms: Count of degrees of freedom.
        """
        found = np.zeros((self.size, 2 * freedoms))
        at = self.channels
        _mark(found[at["wheel_speeds"]], freedoms + self.wheels)
        _mark(found[at["centre_angle"]], np.array(self.centre[1:]))
        _mark(found[at["arm_angles"]], self.joints[1])
        _mark(found[at["arm_rates"]], freedoms + self.joints[1])
        _mark(found[at["inclinometer"]], np.array([3, 4]))
        _mark(found[at["gyro"]], freedoms + np.arange(3, 6))
        found[at["arm_base_wrench"]] = sensed[self.forces[:6]]
        found[at["accelerometer"]] = sensed[self.forces[6:]]
        return found

    def measured(self, seen: Observation, before: Observation | None) -> FloatArray:
        """Return what was measured since the observation before (size,); NaN for all else."""
        found = np.full(self.size, np.nan)
        for name, place in self.channels.items():
            channel: Channel = getattr(seen, name)
            if channel.validity is not Validity.MEASURED:
                continue
            last: Channel | None = getattr(before, name) if before is not None else None
            if last is None or channel.stamp != last.stamp:
                found[place] = channel.value
        return found


def _mark(rows: FloatArray, columns: np.ndarray) -> None:
    rows[np.arange(len(columns)), columns] = 1.0


def _sigma(name: str, width: int) -> FloatArray:
    spec = DATASHEET.channels[name]
    rounding = 0.0
    if spec.bits is not None:
        span = np.asarray(spec.high) - np.asarray(spec.low)
        rounding = span / (2.0**spec.bits - 1.0) / 12.0**0.5
    return np.broadcast_to(np.hypot(spec.noise, rounding), width)
