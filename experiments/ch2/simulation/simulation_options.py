"""Options of ``ch2-simulation``."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from controllers.identification import EXCITATIONS
from experiments.harness import contract
from experiments.harness.contract import OptionError

QUICK_EXCITATIONS = ("constant", "information")
NOISES = ("fixed", "relative")


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of ch2-simulation.

    Attributes:
        truth: JSON or TOML file with the 22 true parameters in SI units (unless given, Table
            2-1's); truth-template prints one.
        random_truth: Run on this many random plausible parameter sets instead, each with
            --seeds repetitions (1 unless said).
        excitations: Which to compare (unless said, all; with --quick, constant and information).
        noise: Range that the 10 % are taken of: "fixed", the run under the constant excitation;
            "relative", each run's own maximum so far; or "both" (with --quick, fixed).
        starts: Seek each final fit again from the truth and this many draws from the prior, and
            count the fits that missed a better one. Each takes a few seconds.
    """

    truth: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    random_truth: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    excitations: Annotated[tuple[str, ...], contract.some_of(EXCITATIONS)] = ()
    noise: Literal["fixed", "relative", "both"] | None = None
    starts: Annotated[int, tyro.conf.arg(metavar="N")] = 0

    def __post_init__(self) -> None:
        """Refuse unknown excitations and contradictions.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        for name in self.excitations:
            if name not in EXCITATIONS:
                raise OptionError(f"--excitations {name}: expected {', '.join(EXCITATIONS)}")
        contract.check_count("random-truth", self.random_truth)
        if self.starts < 0:
            raise OptionError(f"--starts: expected at least 0, got {self.starts}")
        if self.random_truth is not None and self.truth is not None:
            raise OptionError("--truth, --random-truth: give one of them")

    def chosen_excitations(self) -> tuple[str, ...]:
        """Return the excitations to run, each once."""
        default = QUICK_EXCITATIONS if self.quick else EXCITATIONS
        return tuple(dict.fromkeys(self.excitations or default))

    def chosen_noises(self) -> tuple[str, ...]:
        """Return the noises to run."""
        noise = self.noise or ("fixed" if self.quick else "both")
        return NOISES if noise == "both" else (noise,)
