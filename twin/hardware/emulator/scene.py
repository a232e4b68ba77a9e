"""The physics behind emulated boards: one scene, its rovers, and a tick."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from models.clutter import PanelConfig, PanelMarker
from models.compose import (
    FLAT,
    FieldConfig,
    PayloadConfig,
    RobotPlacement,
    make_model,
    settle,
)
from twin.camera import StereoConfig
from twin.describe import describe_placement
from twin.hardware.calibration.calibration import Calibration, calibration_path, load_calibration
from twin.hardware.emulator.rover import ANALOGUE_SENSORS, EmulatedRover
from twin.simulation import Simulation

SETTLING = 1.0
"""Time for which robots come to rest before time zero [s]."""


@dataclasses.dataclass(frozen=True)
class SceneConfig:
    """What is emulated.

    Attributes:
        robots: Names and starting places.
        field: Ground.
        seed: Random seed of all noise.
        calibrations: Files by robot name; the repository's own unless given.
        stereo: How the stereo heads see; None for without.
    """

    robots: tuple[RobotPlacement, ...] = (RobotPlacement(),)
    field: FieldConfig = FLAT
    seed: int = 0
    calibrations: Mapping[str, Path] = dataclasses.field(default_factory=dict[str, Path])
    stereo: StereoConfig | None = None

    def calibration(self, robot: str) -> Calibration:
        """Return a robot's calibration, however old.

        Raises:
            CalibrationError: If it is not there, not valid or another robot's.
        """
        path = self.calibrations.get(robot, calibration_path(robot))
        return load_calibration(path, robot, None)

    def to_json(self) -> str:
        """Return the scene in words, for an emulator in another process."""
        table = dataclasses.asdict(self)
        table["calibrations"] = {name: str(path) for name, path in self.calibrations.items()}
        return json.dumps(table)

    @classmethod
    def from_json(cls, words: str) -> "SceneConfig":
        """Return the scene that `to_json` gave in words."""
        table = json.loads(words)
        field, stereo = _tuples(table["field"]), table["stereo"]
        if field["panel"] is not None:
            panel = _tuples(field["panel"])
            panel["markers"] = tuple(PanelMarker(**marker) for marker in panel["markers"])
            field["panel"] = PanelConfig(**panel)
        return cls(
            tuple(_placement(_tuples(entry)) for entry in table["robots"]),
            FieldConfig(**field),
            table["seed"],
            {name: Path(path) for name, path in table["calibrations"].items()},
            None if stereo is None else StereoConfig(**_tuples(stereo)),
        )


def _placement(entry: dict[str, Any]) -> RobotPlacement:
    payload = entry.pop("payload")
    box = None if payload is None else PayloadConfig(**_tuples(payload))
    return RobotPlacement(**entry, payload=box)


def _tuples(table: dict[str, Any]) -> dict[str, Any]:
    listed = cast("dict[str, list[Any]]", {k: v for k, v in table.items() if isinstance(v, list)})
    return {**table, **{key: tuple(values) for key, values in listed.items()}}


class EmulatedScene:
    """Physics that advance by a tick, never by a command: a repeated one must not count twice."""

    def __init__(self, config: SceneConfig) -> None:
        """Build the scene and let it come to rest.

        Args:
            config: What is emulated.

        Raises:
            CalibrationError: If a robot's calibration cannot be used.
        """
        calibrations = {robot.name: config.calibration(robot.name) for robot in config.robots}
        model = make_model(config.field, config.robots)
        self.simulation = Simulation(
            model,
            [describe_placement(robot) for robot in config.robots],
            suite=ANALOGUE_SENSORS,
            stereo=config.stereo,
            seed=config.seed,
            data=settle(model, SETTLING),
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
        self.simulation.tick()

    def close(self) -> None:
        """Take the scene down."""
        self.simulation.close()
