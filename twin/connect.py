"""From a word on the command line to robots that can be driven."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import TracebackType

from models.compose import FLAT, FieldConfig, RobotPlacement, make_model, settle
from twin.camera import StereoConfig
from twin.clock import Clock, SimClock
from twin.robot import Robot
from twin.sensors import DATASHEET, SensorSuite
from twin.simulation import Simulation

TARGETS = ("sim",)
"""What `connect` offers."""
_PLANNED = ("emulated", "serial")


@dataclasses.dataclass(frozen=True)
class Connection:
    """Robots, the clock that paces them and, for simulated ones, the scene behind them.

    Attributes:
        robots: By name.
        clock: Paces `twin.loop.run`.
        simulation: The scene with the truth, for measuring and recording only; None when real.
    """

    robots: Mapping[str, Robot]
    clock: Clock
    simulation: Simulation | None

    def close(self) -> None:
        """Deactivate the robots and take the scene down."""
        for robot in self.robots.values():
            robot.deactivate()
        if self.simulation is not None:
            self.simulation.close()

    def __enter__(self) -> Connection:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def connect(
    target: str = "sim",
    *,
    robots: Sequence[RobotPlacement] = (RobotPlacement(),),
    field: FieldConfig = FLAT,
    suite: SensorSuite = DATASHEET,
    stereo: StereoConfig | None = None,
    seed: int = 0,
    settling: float = 1.0,
) -> Connection:
    """Return robots that stand still and wait to be activated.

    Args:
        target: One of `TARGETS`.
        robots: Names and starting places; simulated robots only.
        field: Ground of a simulated scene.
        suite: Sensors of simulated robots.
        stereo: Stereo heads of simulated robots; None leaves the channel missing.
        seed: Of all sensor noise.
        settling: Time for which simulated robots come to rest before time zero [s].

    Raises:
        ValueError: If the target is unknown or not available.
    """
    word = target.split(":", 1)[0]
    if word in _PLANNED:
        raise ValueError(
            f"robot {target!r} is not available in this version; available: {', '.join(TARGETS)}"
        )
    if target not in TARGETS:
        raise ValueError(f"unknown robot {target!r}; available: {', '.join(TARGETS)}")
    model = make_model(field, robots)
    simulation = Simulation(
        model,
        [robot.name for robot in robots],
        suite=suite,
        stereo=stereo,
        seed=seed,
        data=settle(model, settling),
    )
    return Connection(simulation.robots, SimClock(simulation), simulation)
