"""What a rover of ``ch5-insertion`` identifies beforehand on flat ground: its slip and springs."""

import dataclasses
import functools

import numpy as np

from controllers.identification.rover_identifier import PitchSwing
from controllers.motion.base_tilt import TiltAxis, roll_axis
from controllers.motion.driving import SkidSteer, TurnShareDrive
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from twin.describe import describe_rover
from twin.loop import run
from twin.realism import Realism, sensor_suites
from twin.simulation import Simulation

DRIVE, SWING = 6.0, 60.0
"""Length of the drive, and longest identification of the springs [s]."""


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


def identify_springs(
    robot: RobotPlacement, realism: Realism, seed: int
) -> tuple[TiltAxis, TiltAxis] | None:
    """Return pitch and roll dynamics as a robot identifies them; None where it doubts them.

    Args:
        robot: Robot, as drawn or as made, with its card; its place does not count.
        realism: How far its sensors are from their makers' statements.
        seed: Seed of the sensors' errors and noise, and of the excitation.
    """
    bare = dataclasses.replace(robot, position=(0.0, 0.0), yaw=0.0, stereo=False)
    model = make_model(FieldConfig(texture_pixels=16), [bare])
    drawn = describe_rover(robot.name, card=robot.card)
    suite = sensor_suites(realism.suite, realism.sensor_errors, [drawn], seed)
    simulation = Simulation(model, [drawn], suite=suite, seed=seed, data=settle(model))
    swing = PitchSwing(drawn, np.random.default_rng(seed))
    run(simulation.robots, [swing], simulation, duration=SWING, until=lambda: swing.done)
    simulation.close()
    if swing.estimate is None or swing.doubts:
        return None
    pitch = TiltAxis.of(swing.estimate)
    return pitch, roll_axis(pitch, drawn)
