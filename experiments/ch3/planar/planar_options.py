"""Options of ``ch3-planar``."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from controllers.mapping import METHODS, Method
from experiments.harness import contract
from experiments.harness.contract import OptionError

QUICK_METHODS: tuple[Method, ...] = ("max_new", "information")
WIDE, NARROW = (90.0, 15.0), (75.0, 10.0)
"""Field of view [deg] and depth of field [m] of the thesis' two kinds of vision system."""


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of ch3-planar.

    Attributes:
        world: Map this picture instead (dark is obstacle; one of more than 200 pixels a side is
            shrunk, and its cells are larger); each seed draws a start and candidates.
        pixel: Side of a pixel of --world [m] (unless said, 0.5).
        methods: Methods to compare (by default all; with --quick, max_new and information).
        reading: Reading of new information: histogram (3-14 as mended), premultiplied or entropy.
        utility: Rating by method information: distance at its going rate, or at the fixed price of
            3-15, K = 0.1 and n = 2.
        noise: Standard deviation of a range over its square [1/m] (3-7).
        fov: Field of view for --world [deg] (unless said, 75).
        depth: Depth of field for --world [m] (unless said, 10).
        explain: Also draw how Gaussians are merged and how a view is evaluated (3-6, 3-8).
    """

    world: Annotated[Path | None, tyro.conf.arg(metavar="PICTURE")] = None
    pixel: Annotated[float | None, tyro.conf.arg(metavar="METRES")] = None
    methods: tuple[Method, ...] = ()
    reading: Literal["histogram", "premultiplied", "entropy"] = "entropy"
    utility: Literal["going_rate", "fixed"] = "going_rate"
    noise: float = 0.0
    fov: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None
    depth: Annotated[float | None, tyro.conf.arg(metavar="METRES")] = None
    explain: bool = False

    def __post_init__(self) -> None:
        """Refuse unknown methods and impossible sensors.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        for method in self.methods:
            if method not in METHODS:
                raise OptionError(f"--methods {method}: expected {', '.join(METHODS)}")
        for name in ("pixel", "fov", "depth"):
            if self.world is None and getattr(self, name) is not None:
                raise OptionError(f"--{name}: needs --world; other worlds have their own")
        if not 0.001 <= self.picture_pixel <= 100.0:
            raise OptionError(f"--pixel: expected 0.001 to 100 m, got {self.pixel}")
        fov, depth = self.picture_sensor
        if not 0.0 < fov <= 360.0:
            raise OptionError(f"--fov: expected more than 0 and at most 360 deg, got {self.fov}")
        # Not above: they load a compiler, for which help shall not wait. Not in `run`: there the
        # folder of results is made already.
        from controllers.mapping.planar_planner import PlannerConfig  # noqa: PLC0415
        from perception.planar.raycast import RangeSensor  # noqa: PLC0415

        try:
            sensor = RangeSensor(float(np.radians(fov)), depth, self.noise)
            PlannerConfig(sensor, reading=self.reading, utility=self.utility)
        except ValueError as error:
            raise OptionError(f"--{error}") from None

    @property
    def picture_pixel(self) -> float:
        """Side of a pixel of the picture [m]."""
        return 0.5 if self.pixel is None else self.pixel

    @property
    def picture_sensor(self) -> tuple[float, float]:
        """Field of view [deg] and depth of field [m] in the picture's world."""
        return (
            NARROW[0] if self.fov is None else self.fov,
            NARROW[1] if self.depth is None else self.depth,
        )

    def chosen_methods(self) -> tuple[Method, ...]:
        """Return the methods to run, each once."""
        return tuple(dict.fromkeys(self.methods or (QUICK_METHODS if self.quick else METHODS)))
