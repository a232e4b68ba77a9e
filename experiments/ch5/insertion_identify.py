"""Drive on flat ground in which a rover of ``ch5-insertion`` identifies its slip by its heading."""

from controllers.motion.driving import SkidSteer, TurnShareDrive
from models.compose import FieldConfig, RobotPlacement, make_model, settle
from twin.describe import describe_rover
from twin.loop import run
from twin.simulation import Simulation

ROBOT = "rover1"
DRIVE = 6.0
"""Length of the drive [s]."""


def identify_slip(seed: int) -> tuple[float, float]:
    """Return the share of a turn that skidding leaves, and its standard deviation.

    Args:
        seed: Seed of the sensors' noise.
    """
    model = make_model(FieldConfig(texture_pixels=16), [RobotPlacement(ROBOT, stereo=False)])
    simulation = Simulation(model, [ROBOT], seed=seed, data=settle(model))
    drive = TurnShareDrive(ROBOT, SkidSteer.of(describe_rover(ROBOT)), simulation.period)
    run(simulation.robots, [drive], simulation, duration=DRIVE)
    simulation.close()
    return drive.finish()
