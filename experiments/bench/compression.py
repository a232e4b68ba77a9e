"""The nine predictors beside one difference of the same picture by NumPy, and tiles of a map."""

import functools
from collections.abc import Callable

import numpy as np

from experiments.appc.pictures import SIZES, bundled_pictures, resampled
from experiments.bench.bench_options import Options
from experiments.bench.elevation_tiles import bench_elevation_tiles
from experiments.harness.output import Output
from experiments.harness.timing import compare
from perception.compression.image_predictors import PREDICTORS, residuals

PICTURE = "camera.png"
CALLS = 100
"""Calls that are timed together, because one is too short."""
ROUNDS, QUICK_ROUNDS = 101, 21
BOUND = 3.0


def bench_compression(options: Options, output: Output) -> None:
    """Time each predictor against ``numpy.diff`` along the rows of a picture of 256 x 256 pixels.

    Args:
        options: ``quick`` times fewer rounds.
        output: Receives ``predictor_ratio/<method>`` and ``predictor_us/<method>``, and what
            `bench_elevation_tiles` measures.
    """
    image = resampled(bundled_pictures()[PICTURE], SIZES[-1])
    rounds = QUICK_ROUNDS if options.quick else ROUNDS
    slowest = 0.0
    for method in PREDICTORS:
        predict = functools.partial(residuals, image, method)
        times = compare(
            functools.partial(_many, predict),
            functools.partial(_many, functools.partial(np.diff, image)),
            rounds,
        )
        output.measure(f"predictor_ratio/{method}", times["ratio"])
        output.measure(f"predictor_us/{method}", 1e6 * float(times["ours_s"]["median"]) / CALLS)
        slowest = max(slowest, float(times["ratio"]["median"]))
    name = f"slowest predictor over numpy.diff, {SIZES[-1]} px, median"
    output.check(name, slowest, f"<= {BOUND:g}", slowest <= BOUND)
    bench_elevation_tiles(options, output)


def _many(work: Callable[[], object]) -> None:
    for _ in range(CALLS):
        work()
