"""A moving picture of the rover: ``python -m experiments.ch2.rover.movie OUT.gif``."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from experiments.ch2.rover.trial import ROBOT
from experiments.harness.recording import write_gif
from models.compose import FLAT, RobotPlacement, build_scene, compile_scene, settle
from twin.camera import renderer
from twin.describe import describe_rover
from twin.loop import LoopRecorder, Tick, run
from twin.simulation import Simulation

CAMERA = "overview"
SIZE = (400, 280)


class Filming(LoopRecorder):
    """Takes a picture of the scene every few ticks."""

    def __init__(self, simulation: Simulation, first: int, every: int) -> None:
        """Film a scene.

        Args:
            simulation: The scene.
            first: Tick of the first picture.
            every: Ticks from one picture to the next.
        """
        self._simulation, self._first, self._every = simulation, first, every
        self.frames: list[NDArray[np.uint8]] = []

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        if tick.step >= self._first and tick.step % self._every == 0:
            scene = self._simulation
            self.frames.append(renderer().render(scene.model, scene.data, CAMERA, *SIZE))


def film(seconds: float, rate: float, seed: int) -> list[NDArray[np.uint8]]:
    """Return pictures of the information excitation from its start.

    Args:
        seconds: Time of excitation to show [s].
        rate: Pictures a second.
        seed: Random seed of sensors and planner.
    """
    spec = build_scene(FLAT, [RobotPlacement(ROBOT)])
    spec.worldbody.add_camera(
        name=CAMERA, pos=[0.95, -0.15, 0.42], xyaxes=[0.19, 0.98, 0, -0.30, 0.06, 0.95], fovy=48
    )
    model = compile_scene(spec)
    simulation = Simulation(model, [ROBOT], seed=seed, data=settle(model, 1.0))
    config = RoverIdentifierConfig(ROBOT, SwingingArm.of(describe_rover(ROBOT)), duration=seconds)
    controller = RoverIdentifier(config, np.random.default_rng(seed))
    lead = round((config.approach + config.rest) / 0.01)
    filming = Filming(simulation, lead, round(100 / rate))
    run(simulation.robots, [controller], simulation, [filming], config.total)
    simulation.close()
    return filming.frames


def main(
    out: Annotated[Path, tyro.conf.Positional],
    seconds: float = 6.0,
    rate: float = 10.0,
    seed: int = 0,
) -> None:
    """Write a GIF of the rover under the information excitation.

    Args:
        out: File to write.
        seconds: Time of excitation to show [s].
        rate: Pictures a second [1/s].
        seed: Random seed of sensors and planner.
    """
    frames = [Image.fromarray(frame) for frame in film(seconds, rate, seed)]
    write_gif(out, frames, frames[0].quantize(48), 1000 / rate, 1000 / rate)


if __name__ == "__main__":
    tyro.cli(main)
