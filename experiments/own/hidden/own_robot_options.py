"""Options of ``own-robot``."""

import dataclasses
from typing import Annotated, Literal

import tyro

from experiments.harness import contract
from experiments.harness.contract import OptionError, check_count

KindName = Literal["arm", "leg", "cart"]


@dataclasses.dataclass(frozen=True)
class Options(contract.SweepOptions):
    """Options of the identification of foreign robots.

    Attributes:
        robots: Kinds of robots: an arm of six axes, a quadruped's leg, a cart with a flexible pole.
        count: Robots of each kind, each as made by a seed of its own (unless said, 34 of each).
        compared: How many of each kind also move as others would: by a chirp, and at random.
        peer: How many of these mujoco.sysid identifies as well.
        duration: Duration of a motion, in seconds.
        generations: Generations of the search of each kind's motion.
        rovers: Rovers of ours on emulated boards as well, as made with default realism.
        rover_duration: Duration of their motions, in seconds.
        rover_generations: Generations of the search of their motion.
    """

    robots: Annotated[tuple[KindName, ...], tyro.conf.arg(metavar="NAME ...")] = (
        "arm",
        "leg",
        "cart",
    )
    count: int = 34
    compared: int = 10
    peer: int = 5
    duration: float = 30.0
    generations: int = 16
    rovers: int = 10
    rover_duration: float = 5.0
    rover_generations: int = 4

    def __post_init__(self) -> None:
        """Refuse what cannot be run.

        Raises:
            OptionError: Naming the option and what is expected.
        """
        super().__post_init__()
        check_count("count", self.count)
        check_count("generations", self.generations)
        if not self.robots:
            raise OptionError("--robots: expected at least one of arm, leg, cart")
        if not 0 <= self.peer <= self.compared <= self.count:
            raise OptionError(
                f"--peer {self.peer} --compared {self.compared} --count {self.count}: "
                "expected 0 <= peer <= compared <= count"
            )
        if self.rovers < 0:
            raise OptionError(f"--rovers: expected 0 or more, got {self.rovers}")
        check_count("rover-generations", self.rover_generations)
        for name in ("duration", "rover_duration"):
            if not getattr(self, name) >= 3.0:
                option = f"--{name.replace('_', '-')}"
                raise OptionError(f"{option}: expected at least 3 s, got {getattr(self, name):g}")
