"""Options of ``bench``."""

import dataclasses
from typing import Annotated

from experiments.harness import contract
from experiments.harness.contract import OptionError

BENCHMARKS: dict[str, str] = {
    "loop": "experiments.bench.loop:bench_loop",
    "identification": "experiments.bench.identification:bench_identification",
    "mapping": "experiments.bench.mapping:bench_mapping",
    "placement": "experiments.bench.placement:bench_placement",
    "markers": "experiments.bench.markers:bench_markers",
    "compression": "experiments.bench.compression:bench_compression",
    "braid": "experiments.bench.braid:bench_braid",
    "scaling": "experiments.bench.scaling:bench_scaling",
    "mission": "experiments.bench.mission:bench_mission",
    "logs": "experiments.bench.logs:bench_logs",
}
"""Module and function ``(options, output)`` of each benchmark, imported only when it is run."""


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of the benchmarks.

    Attributes:
        only: Names of the benchmarks to run; all by default.
    """

    only: Annotated[tuple[str, ...], contract.some_of(BENCHMARKS)] = ()

    def __post_init__(self) -> None:
        """Refuse unknown benchmarks.

        Raises:
            OptionError: If a name is unknown.
        """
        super().__post_init__()
        for name in self.only:
            if name not in BENCHMARKS:
                raise OptionError(f"--only {name}: unknown; there are {', '.join(BENCHMARKS)}")
