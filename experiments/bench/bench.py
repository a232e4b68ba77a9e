"""``python -m experiments bench``: speed and accuracy beside a named peer, in the same run."""

import pkgutil

from experiments.bench.bench_options import BENCHMARKS, Options
from experiments.harness.output import Output


def run(options: Options, output: Output) -> None:
    """Run the benchmarks one after the other; each measures and checks into the output."""
    # All are imported before the first one runs: what is missing shows at once.
    chosen = [pkgutil.resolve_name(BENCHMARKS[name]) for name in options.only or BENCHMARKS]
    for benchmark in chosen:
        benchmark(options, output)
