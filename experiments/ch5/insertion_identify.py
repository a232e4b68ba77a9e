"""Drive on flat ground by which the slip of a rover of ``ch5-insertion`` is measured."""

import dataclasses
import functools

from controllers.motion.driving import SkidSteer, TurnShareDrive
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from twin.describe import describe_rover
from twin.loop import run
from twin.simulation import Simulation

DRIVE = 6.0
"""Length of the drive [s]."""


@functools.cache
def identify_slip(robot: RobotPlacement, seed: int) -> float:
    """Return the share of a turn that skidding leaves of a robot's turns.

    Args:
        robot: Robot, as drawn or as made; its place does not count.
        seed: Seed of the sensors' noise.
    """
    bare = dataclasses.replace(robot, position=(0.0, 0.0), yaw=0.0, stereo=False, card=False)
    model = make_model(FieldConfig(texture_pixels=16), [bare])
    simulation = Simulation(model, [robot.name], seed=seed, data=settle(model))
    drive = TurnShareDrive(robot.name, SkidSteer.of(describe_rover(robot.name)), simulation.period)
    run(simulation.robots, [drive], simulation, duration=DRIVE)
    simulation.close()
    return drive.finish()
