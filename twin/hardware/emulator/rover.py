"""What the boards of one emulated rover are wired to: amplifier, motors, encoders, sensors."""

import dataclasses

import mujoco
import numpy as np

from perception.geometry.arrays import FloatArray, IntArray
from perception.geometry.pinhole import Pinhole
from twin.camera import camera_model
from twin.hardware.calibration.calibration import Calibration
from twin.hardware.emulator.amplifier import (
    AmplifierConfig,
    converter_codes,
    current_limit,
    motor_current,
    supplied_volts,
)
from twin.robot import AXES, Channel, Command
from twin.sensors import DATASHEET, IDEAL, ChannelSpec, SensorSuite
from twin.simulation import SimRobot

_TILT = DATASHEET.channels["inclinometer"]
ANALOGUE_SENSORS = SensorSuite(
    "analogue",
    {
        **IDEAL.channels,
        # The converter samples whenever it is asked; range and counts are the board's.
        "inclinometer": dataclasses.replace(
            _TILT, rate=None, low=-np.inf, high=np.inf, stale_after=None
        ),
        "arm_base_wrench": DATASHEET.channels["arm_base_wrench"],
        "accelerometer": ChannelSpec(connected=False),
        "gyro": ChannelSpec(connected=False),
        "heading": ChannelSpec(connected=False),
    },
)
"""Sensors of the boards, before their conversion into counts."""


class EmulatedRover:
    """Counts and voltages of one simulated rover, as its boards measure them.

    Attributes:
        name: Name of the robot.
        description: Robot as drawn.
        calibration: Conversions of its boards.
        codes: Duty codes (8,) of the boards.
        battery: Main battery voltage [V].
        currents: Motor currents (8,) of the present tick [A].
    """

    def __init__(
        self,
        robot: SimRobot,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        calibration: Calibration,
    ) -> None:
        """Wire a rover up, and activate it: its boards have power.

        Args:
            robot: Simulated robot with the sensors `ANALOGUE_SENSORS`.
            model: Model of the scene.
            data: State of the scene.
            calibration: Conversions of its boards.
        """
        self.name, self.description = robot.name, robot.description
        self.calibration = calibration
        self.codes = np.zeros(8, dtype=np.int64)
        self.battery = 12.0
        self._robot = robot
        self._model, self._data = model, data
        self._config = AmplifierConfig()
        joints = [model.joint(f"{robot.name}/{axis}_joint") for axis in AXES]
        self._positions = np.array([int(joint.qposadr[0]) for joint in joints])
        self._velocities = np.array([int(joint.dofadr[0]) for joint in joints])
        for axis in AXES:  # A motor's current flows through two switches of its bridge.
            resistance = model.actuator(f"{robot.name}/{axis}").gainprm
            resistance[0] += 2.0 * self._config.switch_resistance
        self._high_time = np.zeros(8)
        self.currents = np.zeros(8)
        robot.activate()

    def angles(self) -> FloatArray:
        """Return the shafts' true angles (8,) [rad]."""
        return self._data.qpos[self._positions].copy()

    def jig_angles(self) -> FloatArray:
        """Return the arm's joint angles (4,) as the jig gives them for homing, with its error."""
        return np.array(self._robot.observe().arm_angles.value, dtype=float)

    def counts(self) -> IntArray:
        """Return encoder counts (8,) since the model's zero, unwrapped."""
        return self.calibration.drive.counts(self.angles())

    def drive(self, period: float) -> None:
        """Bring the duty codes to the motors for one tick of `period` [s]."""
        config = dataclasses.replace(self._config, battery=self.battery)
        codes = converter_codes(self.calibration.drive.duties(self.codes), config)
        speeds = self._data.qvel[self._velocities]
        limit = current_limit(self._high_time, config)
        self.currents = motor_current(codes, speeds, config, limit)
        high = np.abs(self.currents) >= 0.999 * config.continuous_current
        self._high_time = np.where(high, self._high_time + period, 0.0)
        volts = supplied_volts(codes, speeds, config, limit)
        duty = np.clip(volts / self._config.battery, -1.0, 1.0)
        self._robot.command(Command(duty[:4], duty[4:]))

    def analogue(self, pin: int) -> int:
        """Return what the converter makes of an input; zero where nothing is wired."""
        tilt, board = self.calibration.inclinometer, self.calibration.analogue
        seen = self._robot.observe()
        for sensor, angle in (
            (tilt.pitch, seen.inclinometer.value[0]),
            (tilt.roll, seen.inclinometer.value[1]),
            (board.centre, seen.centre_angle.value[0]),
        ):
            if sensor.pin == pin:
                return int(board.codes(sensor.volts(angle)))
        return 0

    def wrench(self) -> IntArray:
        """Return the counts (6,) of the force/torque sensor."""
        return self.calibration.force_torque.counts(self._robot.observe().arm_base_wrench.value)

    def camera(self) -> Pinhole:
        """Return the intrinsics of the left camera of its head."""
        return camera_model(self._model, f"{self.name}/stereo_left")

    def stereo(self) -> Channel:
        """Return the latest stereo pair of its cameras, which count nothing."""
        return self._robot.observe().stereo

    def stereo_age(self) -> float:
        """Return how long ago that pair was exposed [s]."""
        seen = self._robot.observe()
        return seen.time - seen.stereo.stamp
