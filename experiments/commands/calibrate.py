"""``python -m experiments calibrate``: a person calibrates a real robot's inclinometer (D-1)."""

import contextlib
import datetime
import math
import time
from collections.abc import Generator, Sequence

import numpy as np
from rich.progress import track

from experiments.commands.calibrate_options import Options
from experiments.harness.contract import ExperimentError, OptionError
from experiments.harness.robot_option import wiring_of
from twin.clock import Clock, WallClock
from twin.describe import describe_rover
from twin.hardware.background import repeating
from twin.hardware.board_robot import BoardRobot
from twin.hardware.calibration.calibration import (
    CalibrationError,
    calibration_path,
    calibration_text,
    load_calibration,
    own_calibration_path,
    write_calibration,
)
from twin.hardware.calibration.procedure import (
    ProcedureConfig,
    ProcedureError,
    run_procedure,
    tilt_procedure,
)
from twin.hardware.calibration.tilt_fit import Sample, sample
from twin.hardware.connect_boards import open_boards
from twin.hardware.serial_link import LinkError
from twin.robot import ArmMode, Command, RobotError
from twin.servo import SERVO_PERIOD

MEASURING = 2.0
"""Time over which a reading is averaged [s]."""


def run(options: Options) -> int:
    """Lead a person through the weighings, write the file and return 0.

    Raises:
        OptionError: If the calibration is damaged or another robot's.
        ExperimentError: If robot or readings do not allow it; the file is as it was.
    """
    wiring = wiring_of(options.robot)
    path = wiring.calibration or calibration_path(wiring.robot)
    try:
        # Its age does not matter: it is made new.
        calibration = load_calibration(path, wiring.robot, datetime.date.today(), math.inf)
    except CalibrationError as error:
        raise OptionError(f"--robot: {error}") from None
    try:
        with contextlib.closing(open_boards(wiring, calibration)) as boards:
            robot = BoardRobot(describe_rover(wiring.robot), boards, calibration, time.monotonic)
            robot.configure()
            config = ProcedureConfig(weight=options.weight)
            steps = tilt_procedure(calibration, config, datetime.date.today())
            with held(robot, wiring.home, WallClock(SERVO_PERIOD)):
                result = run_procedure(
                    steps, lambda: measure(robot, WallClock(SERVO_PERIOD), MEASURING), input, print
                )
    except (CalibrationError, LinkError, RobotError, ProcedureError) as error:
        raise ExperimentError(str(error)) from error
    except EOFError:
        raise ExperimentError("nobody answers; the calibration is as it was") from None
    target = options.output or wiring.calibration or own_calibration_path(wiring.robot)
    try:
        target.parent.mkdir(exist_ok=True)
        write_calibration(target, result.calibration)
    except OSError as error:
        # An hour of a person's work must not be lost.
        print(calibration_text(result.calibration))
        raise ExperimentError(f"{target}: {error.strerror}; the file is printed above") from None
    print(f"written: {target}")
    return 0


@contextlib.contextmanager
def held(robot: BoardRobot, home: Sequence[float], clock: Clock) -> Generator[None]:
    """Let the motors hold the arm while a person works at the robot.

    Args:
        robot: Robot at rest.
        home: Joint angles (4,) of the arm [rad]; empty to leave the motors off.
        clock: Clock of the servo.

    Raises:
        RobotError: If the robot reports a fault.
    """
    if not home:
        yield
        return
    command = Command(arm=np.array(home), arm_mode=ArmMode.POSITION)
    robot.home(command.arm)
    robot.activate()

    def hold() -> None:
        clock.tick()
        # A robot that stopped reports why at the next reading.
        with contextlib.suppress(RobotError):
            robot.observe()
            robot.command(command)

    try:
        with repeating(hold, f"holds the arm of {robot.name}"):
            yield
    finally:
        robot.deactivate()


def measure(robot: BoardRobot, clock: Clock, duration: float) -> Sample:
    """Return the means of the inclinometer's voltages and the arm's force at rest.

    Args:
        robot: Robot at rest.
        clock: Clock of the readings.
        duration: Time over which is averaged [s].

    Raises:
        RobotError: If the robot has stopped, or inclinometer or force/torque sensor give nothing
            for half of that time.
    """
    tilts = robot.calibration.inclinometer
    sensors = (tilts.pitch, tilts.roll)
    volts: dict[float, list[float]] = {}
    force: dict[float, list[float]] = {}
    ticks = round(duration / clock.period)
    for _ in track(range(ticks), "measuring", transient=True):
        clock.tick()
        seen = robot.observe()
        if robot.fault:
            raise RobotError(f"robot {robot.name!r}: {robot.fault}")
        tilt, wrench = seen.inclinometer, seen.arm_base_wrench
        # A sample that is held is the same reading, not another one.
        if tilt.usable:
            angles = np.asarray(tilt.value)
            volts[tilt.stamp] = [float(s.volts(a)) for s, a in zip(sensors, angles, strict=True)]
        if wrench.usable:
            force[wrench.stamp] = np.asarray(wrench.value)[:3].tolist()
    for name, found, per_tick in (("inclinometer", volts, 0.25), ("arm base wrench", force, 1.0)):
        if len(found) < max(2.0, 0.5 * per_tick * ticks):
            raise RobotError(f"robot {robot.name!r}: {name} gave {len(found)} readings in {ticks}")
    return sample(list(volts.values()), list(force.values()))
