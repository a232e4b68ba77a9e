"""What a rover of ``ch5-insertion`` knows of itself: its slip, by a drive.

The share of a turn that skidding leaves is identified on flat ground, by the heading sensor against
what rolling wheels would turn.
"""

import math

import numpy as np

from controllers.motion.driving import SkidSteer, identify_turn_share
from models import datasheets
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, WheelMode
from twin.simulation import Simulation

ROBOT = "rover1"
DRIVE = 6.0
"""Length of the drive [s]."""
_SPEED, _TURN = 0.06, 0.25  # As in the approach [m/s, rad/s].
_TURN_EVERY = 1.5  # From a turn to the left to one to the right [s].


def rover_steer(turn_share: float = 1.0) -> SkidSteer:
    """Return the rover's wheels with a share of the turn that they keep."""
    rover = datasheets.ROVER
    return SkidSteer(rover.wheel_radius, rover.half_track, turn_share)


def identify_slip(seed: int) -> tuple[float, float]:
    """Return the share of a turn that skidding leaves, and its standard deviation.

    Args:
        seed: Seed of the sensors' noise.
    """
    model = make_model(FieldConfig(texture_pixels=16), [RobotPlacement(ROBOT, stereo=False)])
    simulation = Simulation(model, [ROBOT], seed=seed, data=settle(model))
    robot = simulation.robots[ROBOT]
    steer = rover_steer()
    robot.activate()
    held = np.array(robot.observe().arm_angles.value, dtype=float)
    speeds: list[FloatArray] = []
    headings: list[float] = []
    for tick in range(round(DRIVE / simulation.period)):
        seen = robot.observe()
        speeds.append(np.asarray(seen.wheel_speeds.value, dtype=float))
        headings.append(float(seen.heading.value[0]))
        left = math.floor(tick * simulation.period / _TURN_EVERY) % 2 == 0
        wheels = steer.wheel_speeds(_SPEED, _TURN if left else -_TURN)
        robot.command(Command(wheels, held, WheelMode.SPEED, ArmMode.POSITION))
        simulation.tick()
    simulation.close()
    return identify_turn_share(steer, speeds, headings, simulation.period)
