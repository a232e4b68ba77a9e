"""``python -m experiments bench``: speed and accuracy beside a named peer, in the same run."""

import dataclasses
from collections.abc import Callable

from experiments.bench.braid import bench_braid
from experiments.bench.compression import bench_compression
from experiments.bench.identification import bench_identification
from experiments.bench.loop import bench_loop
from experiments.bench.mapping import bench_mapping
from experiments.bench.markers import bench_markers
from experiments.bench.mission import bench_mission
from experiments.bench.placement import bench_placement
from experiments.bench.scaling import bench_scaling
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.output import Output

BENCHMARKS: dict[str, Callable[[contract.Options, Output], None]] = {
    "loop": bench_loop,
    "identification": bench_identification,
    "mapping": bench_mapping,
    "placement": bench_placement,
    "markers": bench_markers,
    "compression": bench_compression,
    "braid": bench_braid,
    "scaling": bench_scaling,
    "mission": bench_mission,
}


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of the benchmarks.

    Attributes:
        only: Names of the benchmarks to run; all by default.
    """

    only: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse unknown benchmarks.

        Raises:
            OptionError: If a name is unknown.
        """
        super().__post_init__()
        for name in self.only:
            if name not in BENCHMARKS:
                raise OptionError(f"--only {name}: unknown; there are {', '.join(BENCHMARKS)}")


def run(options: Options, output: Output) -> None:
    """Run the benchmarks one after the other; each measures and checks into the output."""
    for name in options.only or BENCHMARKS:
        BENCHMARKS[name](options, output)
