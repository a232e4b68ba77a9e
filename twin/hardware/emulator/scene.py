"""The physics behind emulated boards: one scene, its rovers, and a tick."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from models.compose import FLAT, FieldConfig, RobotPlacement, make_model, settle
from twin.camera import StereoConfig
from twin.hardware.calibration import Calibration, calibration_path, load_calibration
from twin.hardware.emulator.rover import ANALOGUE_SENSORS, EmulatedRover
from twin.simulation import Simulation


@dataclasses.dataclass(frozen=True)
class SceneConfig:
    """What is emulated.

    Attributes:
        robots: Names and starting places.
        field: Ground.
        seed: Of all noise.
        settling: Time for which the robots come to rest before time zero [s].
        calibrations: Files by robot name; the repository's own unless given.
    """

    robots: tuple[RobotPlacement, ...] = (RobotPlacement(),)
    field: FieldConfig = FLAT
    seed: int = 0
    settling: float = 1.0
    calibrations: Mapping[str, Path] = dataclasses.field(default_factory=dict[str, Path])

    def calibration(self, robot: str) -> Calibration:
        """Return a robot's calibration, however old.

        Raises:
            CalibrationError: If it is not there, not valid or another robot's.
        """
        path = self.calibrations.get(robot, calibration_path(robot))
        return load_calibration(path, robot, None)


class EmulatedScene:
    """Physics that advance by a tick, never by a command: a repeated one must not count twice."""

    def __init__(self, config: SceneConfig, stereo: StereoConfig | None = None) -> None:
        """Build the scene and let it come to rest.

        Args:
            config: What is emulated.
            stereo: How the stereo heads see; None for without.

        Raises:
            CalibrationError: If a robot's calibration cannot be used.
        """
        calibrations = {robot.name: config.calibration(robot.name) for robot in config.robots}
        model = make_model(config.field, config.robots)
        self.simulation = Simulation(
            model,
            [robot.name for robot in config.robots],
            suite=ANALOGUE_SENSORS,
            stereo=stereo,
            seed=config.seed,
            data=settle(model, config.settling),
        )
        self.rovers = {
            name: EmulatedRover(robot, model, self.simulation.data, calibrations[name])
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

    def tick(self) -> None:
        """Advance by one servo tick, with the motors as the boards drive them.

        Raises:
            RobotError: If the physics diverged.
        """
        for rover in self.rovers.values():
            rover.drive(self.period)
        self.simulation.step()

    def close(self) -> None:
        """Take the scene down."""
        self.simulation.close()
