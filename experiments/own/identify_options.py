"""Options of ``identify``."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.harness.contract import OptionError

STEP = 1e-3
"""Time step that most robots' models bear and that hardly shows in what is identified [s]."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of an identification.

    Attributes:
        model: The robot as drawn, MJCF or URDF.
        log: Runs of the robot: CSV, MCAP or rerun files, or folders of rosbag2 or LeRobot.
        parameters: What to identify, as joint.elbow.damping or body.hand.*; behind a colon how far
            off it may well be: joint.*.damping:0.5, a share of what is above zero in the model, SI
            units of all else. Without it the parameters of the model are listed.
        hold_out: Further runs, which confirm the result or do not.
        mapping: TOML file that says which field of the logs is which actuator or sensor of the
            model; without it the signals of logs of ours bear its names.
        start: Runs begin at rest under their first commands, or held where joints were measured, or
            moving: then it is sought how.
        step: Time step of the simulations, in seconds; the model's own if that is shorter. One too
            long shows as a delay and as damping.
        anyway: Go on though something is wrong with a log.
        out: Folder of what is written: page.html, model.xml, identified.json, tables, figures.
    """

    model: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    log: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE ...")] = ()
    parameters: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME[:SPREAD] ...")] = ()
    hold_out: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE ...")] = ()
    mapping: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    start: Literal["rest", "held", "moving"] = "rest"
    step: float = STEP
    anyway: bool = False
    out: Path = Path("results/identify")

    def __post_init__(self) -> None:
        """Refuse what nothing can be fitted with.

        Raises:
            OptionError: Naming what is missing.
        """
        if not 0.0 < self.step < 1.0:
            raise OptionError(f"--step: expected above 0 to 1 s, got {self.step:g}")
        if self.parameters and not self.log:
            raise OptionError("--log: needed with --parameters")
