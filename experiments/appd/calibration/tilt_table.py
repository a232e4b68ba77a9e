"""The laboratory of ``appd-calibration``: a table that tilts, and a weight on a thread.

The ground turns as a table does and takes the rover along as a rigid body, so that nothing slides
or falls while it turns; gravity stays as it is. That is the same statics as turning gravity, and
the robot's own inclinometer stays right. What is measured goes through the robot's sensors only.
"""

import dataclasses
from typing import NamedTuple

import mujoco
import numpy as np

from models import datasheets
from models.compose import FieldConfig, RobotPlacement
from models.datasheets import DEGREE
from perception.geometry.arrays import FloatArray
from twin.connect import connect
from twin.hardware.calibration.calibration import (
    AnalogueCalibration,
    AngleSensor,
    calibration_path,
    read_calibration,
)
from twin.hardware.calibration.tilt_fit import Sample, Weighing, sample
from twin.robot import ArmMode, Command, Observation
from twin.sensor_bank import tilt as tilt_of_orientation
from twin.simulation import Simulation

FIELD = FieldConfig(texture_pixels=64)
WEIGHT = 0.5  # [kg]
BITS = (10, 12, 16)
STEPS = (-15.0, -7.5, 0.0, 7.5, 15.0)  # of each axis [deg]
SCATTER = 2.0  # by which wedges and hands miss, in both axes [deg]
TURNING, SETTLING, MEASURING = 1.0, 1.5, 2.0  # [s]
SWINGING = 0.5  # in which the rover comes up again without the weight [s]


class TiltTable:
    """A rover on a table, seen and touched by the person who calibrates it."""

    def __init__(self, simulation: Simulation, name: str) -> None:
        """Take hold of the ground and of a rover's gripper.

        Args:
            simulation: Scene with one rover on flat ground.
            name: Name of the rover.
        """
        self._simulation = simulation
        self._robot = simulation.robots[name]
        model = simulation.model
        root = model.joint(f"{name}/root_joint")
        self._qpos, self._qvel = int(root.qposadr[0]), int(root.dofadr[0])
        self._grip = model.site(f"{name}/gripper").id
        self._wrist = int(model.site_bodyid[self._grip])
        self._imu = model.site(f"{name}/imu").id
        self._ground = model.geom("ground").id
        # Otherwise the ground's own orientation is taken for that of the world's frame.
        model.geom_sameframe[self._ground] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self._tilt = np.zeros(2)
        self._weight = 0.0

    def turn(self, tilt: FloatArray, duration: float) -> None:
        """Tilt the table to pitch and roll (2,) [rad] within ``duration`` [s]."""
        ticks = max(1, round(duration / self._simulation.period))
        start = self._tilt
        for tick in range(1, ticks + 1):
            self._place(start + (tilt - start) * tick / ticks)
            self._step()

    def hang(self, mass: float) -> None:
        """Hang a mass on a thread from the gripper [kg]; zero takes it off."""
        self._weight = mass

    def wait(self, duration: float) -> list[Observation]:
        """Let time pass [s], and return what the robot observed at each tick."""
        seen: list[Observation] = []
        for _ in range(round(duration / self._simulation.period)):
            self._step()
            seen.append(self._robot.observe())
        return seen

    def truth(self) -> FloatArray:
        """Return the body's pitch and roll (2,) [rad], for scoring only."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self._simulation.data.site_xmat[self._imu])
        w, x, y, z = quaternion.tolist()
        return np.array(tilt_of_orientation(w, x, y, z)[:2])

    def _place(self, tilt: FloatArray) -> None:
        """Turn table and rover, as one body, to pitch and roll."""
        data, model = self._simulation.data, self._simulation.model
        old, new = _quaternion(self._tilt), _quaternion(tilt)
        change, turned = np.empty(4), np.empty(4)
        mujoco.mju_negQuat(turned, old)
        mujoco.mju_mulQuat(change, new, turned)
        pose = data.qpos[self._qpos : self._qpos + 7]
        mujoco.mju_mulQuat(turned, change, pose[3:].copy())
        pose[:3], pose[3:] = _rotated(pose[:3], change), turned
        velocity = data.qvel[self._qvel : self._qvel + 3]
        velocity[:] = _rotated(velocity, change)
        model.geom_quat[self._ground] = new
        self._tilt = np.array(tilt)
        # The simulation's tick begins in the middle of a physics step.
        mujoco.mj_step1(model, data)

    def _step(self) -> None:
        data, model = self._simulation.data, self._simulation.model
        force = self._weight * model.opt.gravity
        lever = data.site_xpos[self._grip] - data.xipos[self._wrist]
        data.xfrc_applied[self._wrist, :3] = force
        data.xfrc_applied[self._wrist, 3:] = np.cross(lever, force)
        self._simulation.tick()


@dataclasses.dataclass(frozen=True)
class WeighingJob:
    """One robot to weigh.

    Attributes:
        seed: Random seed of the tilts and of the sensor noise.
        key: Robot of Table D-1.
    """

    seed: int
    key: str


@dataclasses.dataclass(frozen=True)
class WeighedRobot:
    """One robot weighed at all tilts.

    Attributes:
        seed: Random seed of the job.
        key: Robot of Table D-1.
        truth: (n, 2) true pitch and roll with the weight on [rad].
        sag: (n, 2) change of pitch and roll under the weight [rad].
        weighings: Weighings through a converter of so many bits, for each of `BITS`.
        reading_rms: (bits, n, 2) r.m.s. error of single readings through each converter [rad].
    """

    seed: int
    key: str
    truth: FloatArray
    sag: FloatArray
    weighings: tuple[tuple[Weighing, ...], ...]
    reading_rms: FloatArray


def weigh_one(job: WeighingJob) -> WeighedRobot:
    """Weigh one robot at all tilts; a job of the sweep."""
    draws, noise = np.random.SeedSequence([job.seed, _number(job.key)]).spawn(2)
    rng = np.random.default_rng(draws)
    placement = RobotPlacement(robot_name(job.key), stereo=False)
    seed = int(noise.generate_state(1)[0])
    with connect("sim", robots=[placement], field=FIELD, seed=seed) as connection:
        assert connection.simulation is not None
        robot = connection.robots[placement.name]
        robot.activate()
        home = np.array(datasheets.ARM.home)
        robot.command(Command(arm=home, arm_mode=ArmMode.POSITION))
        table = TiltTable(connection.simulation, placement.name)
        tilted = [_weigh(table, tilt, job.key) for tilt in draw_tilts(rng)]
    return WeighedRobot(
        job.seed,
        job.key,
        truth=np.array([each.truth for each in tilted]),
        sag=np.array([each.sag for each in tilted]),
        weighings=tuple(zip(*(each.weighings for each in tilted))),
        reading_rms=np.array([each.reading_rms for each in tilted]).swapaxes(0, 1),
    )


def draw_tilts(rng: np.random.Generator) -> FloatArray:
    """Return the tilts (n, 2) of the table [rad]: first pitch, then roll, neither exact."""
    wanted = np.array([(step, 0.0) for step in STEPS] + [(0.0, step) for step in STEPS])
    return (wanted + rng.uniform(-SCATTER, SCATTER, wanted.shape)) * DEGREE


def robot_name(key: str) -> str:
    """Return the name that a robot of Table D-1 has in this project."""
    return f"rover{_number(key)}"


def true_sensors(key: str) -> tuple[AngleSensor, AngleSensor]:
    """Return pitch and roll axes with Table D-1's constants of a robot."""
    table = datasheets.INCLINOMETER_CALIBRATION[key]
    pitch, roll = (
        AngleSensor(
            pin=pin,
            zero_volts=table[axis].zero_voltage,
            volts_per_radian=table[axis].sensitivity / DEGREE,
        )
        for pin, axis in ((2, "pitch"), (1, "roll"))
    )
    return pitch, roll


class _Tilted(NamedTuple):
    """One tilt: true angles and sag (2,) [rad], and by converter weighing and r.m.s. error."""

    truth: FloatArray
    sag: FloatArray
    weighings: tuple[Weighing, ...]
    reading_rms: tuple[FloatArray, ...]


def _weigh(table: TiltTable, tilt: FloatArray, key: str) -> _Tilted:
    """Weigh at one tilt."""
    table.hang(0.0)
    table.turn(tilt, TURNING)
    table.wait(SETTLING)
    before, empty = table.wait(MEASURING), table.truth()
    table.hang(WEIGHT)
    table.wait(SETTLING)
    after, truth = table.wait(MEASURING), table.truth()
    table.hang(0.0)
    table.wait(SWINGING)
    weighings = tuple(Weighing(_sample(before, key, b), _sample(after, key, b)) for b in BITS)
    angles = (_angles(_outputs(after, key, bits), key) for bits in BITS)
    errors = tuple(np.sqrt(np.mean((each - truth) ** 2, axis=0)) for each in angles)
    return _Tilted(truth, truth - empty, weighings, errors)


def _sample(seen: list[Observation], key: str, bits: int) -> Sample:
    forces = np.array([each.arm_base_wrench.value[:3] for each in seen])
    return sample(_outputs(seen, key, bits), forces)


def _outputs(seen: list[Observation], key: str, bits: int) -> FloatArray:
    """Return the inclinometer's outputs (n, 2) after the converter, one row a fresh sample [V].

    The channel has the sensor's low pass and noise; voltage and converter are added here.
    """
    fresh = {each.inclinometer.stamp: each.inclinometer.value for each in seen}
    angles = np.array(list(fresh.values()), dtype=float)
    board = converter(key, bits)
    columns = [
        board.volts(board.codes(sensor.volts(angles[:, axis])))
        for axis, sensor in enumerate(true_sensors(key))
    ]
    return np.stack(columns, axis=1)


def _angles(outputs: FloatArray, key: str) -> FloatArray:
    """Return what outputs (n, 2) [V] would mean to someone who knew the constants [rad]."""
    sensors = true_sensors(key)
    return np.stack([sensor.angle(outputs[:, axis]) for axis, sensor in enumerate(sensors)], axis=1)


def converter(key: str, bits: int) -> AnalogueCalibration:
    """Return a robot's analogue board with a converter of so many bits."""
    board = read_calibration(calibration_path(robot_name(key))).analogue
    return dataclasses.replace(board, bits=bits)


def _number(key: str) -> int:
    return int(key.removeprefix("robot"))


def _quaternion(tilt: FloatArray) -> FloatArray:
    """Return the orientation (4,) of a body at pitch and roll (2,): Rx(pitch) Ry(roll)."""
    orientation = np.empty(4)
    mujoco.mju_euler2Quat(orientation, np.array([*tilt, 0.0]), "xyz")
    return orientation


def _rotated(vector: FloatArray, quaternion: FloatArray) -> FloatArray:
    result = np.empty(3)
    mujoco.mju_rotVecQuat(result, np.array(vector), quaternion)
    return result
