"""``python -m experiments bench``: speed and accuracy beside a named peer, in the same run."""

import pkgutil
from collections.abc import Callable

from experiments.bench.bench_options import BENCHMARKS, Options
from experiments.harness.contract import ExperimentError
from experiments.harness.output import Output


def run(options: Options, output: Output) -> None:
    """Run the benchmarks one after the other; each measures and checks into the output.

    Raises:
        ExperimentError: If a peer is not installed.
    """
    # All are imported before the first one runs: what is missing shows at once.
    for benchmark in [_benchmark(name) for name in options.only or BENCHMARKS]:
        benchmark(options, output)


def _benchmark(name: str) -> Callable[[Options, Output], None]:
    try:
        return pkgutil.resolve_name(BENCHMARKS[name])
    except ImportError as error:
        raise ExperimentError(
            f"--only {name}: the peer {error.name} is missing (pip install 'fieldtwin[peers]')"
        ) from error
