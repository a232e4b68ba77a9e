"""The physics behind emulated boards: one scene, its rovers, and a tick."""

import dataclasses
import json

from models.compose import (
    FLAT,
    FieldConfig,
    RobotPlacement,
    make_model,
    settle,
)
from models.datasheets import SensorErrorSheet
from perception.geometry.arrays import FloatArray
from twin.camera import StereoConfig
from twin.describe import describe_placement
from twin.hardware.calibration.calibration import calibration_path, load_calibration
from twin.hardware.calibration.section import from_table
from twin.hardware.emulator.rover import ANALOGUE_SENSORS, EmulatedRover
from twin.realism import sensor_suites, with_cameras
from twin.sensors import SensorSuite
from twin.simulation import Simulation
from twin.taken_load import TakenLoad

SETTLING = 1.0
"""Duration of settling before time zero [s]."""


@dataclasses.dataclass(frozen=True)
class SceneConfig:
    """An emulated scene.

    Attributes:
        robots: Names and initial poses of the robots.
        field: Ground.
        seed: Random seed of all noise.
        stereo: Properties of the stereo heads; None for none.
        sensor_errors: Largest errors of the robots' sensors, drawn from the seed; None for none.
    """

    robots: tuple[RobotPlacement, ...] = (RobotPlacement(),)
    field: FieldConfig = FLAT
    seed: int = 0
    stereo: StereoConfig | None = None
    sensor_errors: SensorErrorSheet | None = None

    def to_json(self) -> str:
        """Return the scene as JSON, for an emulator in another process."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, words: str) -> "SceneConfig":
        """Return the scene that `to_json` wrote.

        Raises:
            ValueError: If it is no JSON, or a key is missing, unknown or of a wrong type.
        """
        return from_table(cls, json.loads(words))


def simulate(config: SceneConfig, suite: SensorSuite) -> Simulation:
    """Return a scene at rest.

    Args:
        config: Robots, ground, stereo heads, errors of the sensors and seed.
        suite: Specification of the robots' sensors without their errors.
    """
    model = make_model(config.field, config.robots)
    loads = [
        TakenLoad(model, robot)
        for robot in config.robots
        if robot.payload is not None and robot.payload.taken > 0.0
    ]
    drawn = [describe_placement(robot) for robot in config.robots]
    if config.stereo is not None:
        drawn = [with_cameras(robot, config.stereo.realism) for robot in drawn]
    return Simulation(
        model,
        drawn,
        suite=sensor_suites(suite, config.sensor_errors, drawn, config.seed),
        stereo=config.stereo,
        seed=config.seed,
        data=settle(model, SETTLING),
        loads=loads,
    )


class EmulatedScene:
    """Physics that advance by a tick, never by a command: a repeated one must not count twice."""

    def __init__(self, config: SceneConfig) -> None:
        """Build the scene and let it come to rest.

        Args:
            config: Robots, ground and cameras.

        Raises:
            CalibrationError: If a robot's calibration cannot be used.
        """
        calibrations = {
            robot.name: load_calibration(calibration_path(robot.name), robot.name, None)
            for robot in config.robots
        }
        self.simulation = simulate(config, ANALOGUE_SENSORS)
        model, data = self.simulation.model, self.simulation.data
        self.rovers = {
            name: EmulatedRover(robot, model, data, calibrations[name])
            for name, robot in self.simulation.robots.items()
        }

    @property
    def time(self) -> float:
        """Time since the scene began [s]."""
        return self.simulation.time

    @property
    def period(self) -> float:
        """Servo tick [s]."""
        return self.simulation.period

    def begin_at(self, state: FloatArray) -> None:
        """Go to a state of the physics, and to its time.

        Args:
            state: `SavedRun.physics` of the same scene.

        Raises:
            ValueError: If it is of another scene.
        """
        saved = self.simulation.save()
        if state.shape != saved.physics.shape:
            raise ValueError(
                f"the state has {state.size} numbers, the scene {saved.physics.size}: "
                "it is of another scene"
            )
        self.simulation.restore(dataclasses.replace(saved, physics=state))

    def tick(self) -> None:
        """Advance by one servo tick, with the motors as the boards drive them.

        Raises:
            RobotError: If the physics diverged.
        """
        for rover in self.rovers.values():
            rover.drive(self.period)
        self.simulation.tick()

    def close(self) -> None:
        """Close the simulation."""
        self.simulation.close()
