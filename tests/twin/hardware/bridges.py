"""A simulation that gets the voltages of the boards' bridges: their switches are in its motors."""

from models.datasheets import POWER_STAGE
from twin.connect import Connection
from twin.robot import AXES


def add_bridges(connection: Connection, robot: str) -> None:
    """Let the motors of a simulated robot have the resistance of two switches as well."""
    assert connection.simulation is not None
    for axis in AXES:
        motor = connection.simulation.model.actuator(f"{robot}/{axis}")
        motor.gainprm[0] += 2.0 * POWER_STAGE.switch_resistance
