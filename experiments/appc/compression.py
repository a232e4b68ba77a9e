"""``appc-compression``: ten ways to compress pictures, and what a picture's information is worth.

Table C-1 on the pictures bundled with scikit-image, on the photographs among them alone, on views
rendered in the field of chapter 3 and on noise. Then the measure that the thesis takes from it,
the entropy of a picture coded by method 5, chooses views beside the measure of chapter 3.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import wilcoxon

from experiments.appc.compression_options import Options
from experiments.appc.figures import draw_methods, draw_predictors, draw_views
from experiments.appc.pictures import (
    DRAWINGS,
    SIZES,
    Measured,
    NoiseTrial,
    bundled_pictures,
    measure_noise,
    measure_whole,
    ratios,
    resampled,
    smoothed,
)
from experiments.appc.views import (
    MEASURES,
    ViewComparison,
    ViewTrial,
    compare_views,
)
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.compression.image_codec import BEST_PREDICTOR, CODERS, METHODS
from perception.compression.image_predictors import PREDICTORS
from perception.geometry.arrays import FloatArray

TABLE_C_1 = (
    (1.000, 1.000, 1.000, 1.000, 1.000),
    (1.009, 1.142, 1.253, 1.375, 1.531),
    (1.013, 1.142, 1.247, 1.358, 1.488),
    (0.980, 1.060, 1.149, 1.250, 1.348),
    (0.983, 1.143, 1.277, 1.416, 1.723),
    (0.996, 1.156, 1.289, 1.427, 1.646),
    (0.997, 1.157, 1.288, 1.422, 1.619),
    (1.018, 1.159, 1.282, 1.414, 1.564),
    (1.008, 1.126, 1.236, 1.358, 1.480),
    (0.997, 0.996, 0.996, 0.996, 0.996),
)
"""The thesis' mean compression ratios: methods 1 to 10 by `SIZES`."""
TABLE_C_1_SIGMA = (
    (0.000, 0.000, 0.000, 0.000, 0.000),
    (0.038, 0.045, 0.063, 0.089, 0.146),
    (0.033, 0.044, 0.064, 0.091, 0.147),
    (0.025, 0.031, 0.046, 0.066, 0.101),
    (0.041, 0.042, 0.068, 0.111, 0.234),
    (0.041, 0.041, 0.063, 0.098, 0.184),
    (0.039, 0.039, 0.064, 0.101, 0.181),
    (0.035, 0.036, 0.056, 0.086, 0.145),
    (0.031, 0.035, 0.052, 0.077, 0.123),
    (0.001, 0.001, 0.001, 0.001, 0.001),
)
"""Their deviations."""
NOISES, QUICK_NOISES = 100, 20
SMALL_BOUND, NOISE_BOUND = 0.05, 0.005
REAL = ("bundled", "photographs", "rendered")
"""Sets of pictures that Table C-1 is measured on; the first is held against the thesis."""


def run(options: Options, output: Output) -> None:
    """Measure all pictures, and compare the measures of views.

    Args:
        options: ``quick`` renders 6 views of one scene, for 16 of each of 12, and draws 20 pictures
            of noise of each size for 100.
        output: Receives ``ratio/<method>/<size>`` of the bundled pictures, and the same of the
            other sets; ``round_trip_failures``; ``view_gain_share/<measure>``.
    """
    seeds = options.job_seeds(12, 1)
    pictures = bundled_pictures()
    photographs = {name: image for name, image in pictures.items() if name not in DRAWINGS}
    blurred = np.array([ratios(smoothed(resampled(i, SIZES[-1]))) for i in photographs.values()])
    trials = [ViewTrial(seed, options.count(), options.known()) for seed in seeds]
    noises = [NoiseTrial(options.seed, QUICK_NOISES if options.quick else NOISES)]
    compared = sweep(compare_views, trials, options, output, label="scenes")
    noisy = sweep(measure_noise, noises, options, output, label="noise")
    bundled = measure_whole(pictures.values())
    taken = [index for index, name in enumerate(pictures) if name in photographs]
    sets = {
        "bundled": bundled,
        "photographs": bundled.some(taken),
        "rendered": Measured.joined([result.measured for result in compared]),
        "noise": Measured.joined(noisy),
    }
    for name, measured in sets.items():
        _measure_set(name, measured, output)
    for row, method in enumerate(METHODS):
        output.measure(f"ratio_smoothed/{method}/{SIZES[-1]}", distribution(blurred[:, row]))
    output.measure(f"best_method_smoothed/{SIZES[-1]}", _best(blurred))
    _check(sets, output)
    _tables(sets, list(pictures), output)
    _compare(compared, output)
    output.figure("figure_C-2", draw_methods(sets, TABLE_C_1, TABLE_C_1_SIGMA))
    shown = {
        "camera.png": resampled(pictures["camera.png"], SIZES[-1]),
        "cell.png": resampled(pictures["cell.png"], SIZES[-1]),
        "rendered": compared[0].picture,
    }
    output.figure("predictors", draw_predictors(shown))


def _best(found: FloatArray) -> int:
    """Return the method of 1 to 9 with the greatest mean ratio; found is (N, 10)."""
    return PREDICTORS[int(np.argmax(found[:, : len(PREDICTORS)].mean(axis=0)))]


def _measure_set(name: str, measured: Measured, output: Output) -> None:
    """Store one set's ratios; those of the bundled pictures beside the thesis'."""
    held = name == REAL[0]
    ending = "" if held else f"_{name}"
    thesis, deviation = np.array(TABLE_C_1), np.array(TABLE_C_1_SIGMA)
    for column, size in enumerate(SIZES):
        for row, method in enumerate(METHODS):
            found, key = measured.ratios[column, :, row], f"{method}/{size}"
            mean, sigma = float(thesis[row, column]), float(deviation[row, column])
            output.measure(f"ratio{ending}/{key}", distribution(found), mean if held else None)
            output.measure(
                f"ratio_sigma{ending}/{key}", float(found.std(ddof=1)), sigma if held else None
            )
        if name in REAL:
            best = _best(thesis[None, :, column]) if held else None
            output.measure(f"best_method{ending}/{size}", _best(measured.ratios[column]), best)


def _check(sets: Mapping[str, Measured], output: Output) -> None:
    failures, outside = (sum(getattr(m, k) for m in sets.values()) for k in ("failures", "outside"))
    output.measure("round_trip_failures", failures)
    output.measure("round_trips", sum(m.round_trips for m in sets.values()))
    output.check("pictures that did not come back bit for bit", failures, "0", failures == 0)
    output.check("Huffman codes not within [H, H + 1] bit", outside, "0", outside == 0)
    for name in REAL:
        means = sets[name].ratios.mean(axis=1)
        best = _best(sets[name].ratios[-1])
        label = f"best method at {SIZES[-1]} px ({name})"
        output.check(label, best, str(BEST_PREDICTOR), best == BEST_PREDICTOR)
        off = float(np.abs(means[0] - np.array(TABLE_C_1)[:, 0]).max())
        label = f"greatest difference from the thesis at {SIZES[0]} px ({name})"
        output.check(label, off, f"<= {SMALL_BOUND:g}", off <= SMALL_BOUND)
    means = sets["noise"].ratios.mean(axis=1)[:, : len(PREDICTORS)]
    off = float(np.abs(means - 1.0).max())
    label = "greatest difference of a predictor's mean ratio on noise from 1"
    output.check(label, off, f"<= {NOISE_BOUND:g}", off <= NOISE_BOUND)


def _tables(sets: Mapping[str, Measured], names: Sequence[str], output: Output) -> None:
    rows: list[list[Any]] = []
    for name, measured in sets.items():
        mean, sigma = measured.ratios.mean(axis=1), measured.ratios.std(axis=1, ddof=1)
        for row, method in enumerate(METHODS):
            cells = [f"{m[row]:.3f} +- {s[row]:.3f}" for m, s in zip(mean, sigma)]
            rows.append([name, measured.ratios.shape[1], method, *cells])
    for row, method in enumerate(METHODS):
        cells = [f"{m:.3f} +- {s:.3f}" for m, s in zip(TABLE_C_1[row], TABLE_C_1_SIGMA[row])]
        rows.append(["thesis", 500, method, *cells])
    sizes = [f"{size} px" for size in SIZES]
    output.table("table_C-1", ("pictures", "number", "method", *sizes), rows)
    fine = sets["bundled"].ratios[-1]
    columns = ("picture", *(f"method {method}" for method in METHODS))
    output.table("bundled_256", columns, [[n, *r.round(3)] for n, r in zip(names, fine)])
    coded = [
        [name, method, *("" if np.isnan(ratio) else ratio for ratio in files.round(3))]
        for name, measured in sets.items()
        for method, files in zip(METHODS, measured.coded[-1].mean(axis=0))
    ]
    output.table("bytes_over_coded_bytes_256", ("pictures", "method", *CODERS), coded)


def _compare(results: Sequence[ViewComparison], output: Output) -> None:
    """Store how well each measure of a view foretells what the view brings.

    Decisions in one scene are not independent: they are averaged, and scenes are compared.
    """
    used = [result for result in results if len(result.known)]
    output.measure("view_decisions", sum(len(result.known) for result in used))
    if not used:
        return
    correlation = np.array([np.mean(result.correlation, axis=0) for result in used])
    share = np.array([np.mean(result.share, axis=0) for result in used])
    drawn = np.array([float(np.mean(result.mean_share)) for result in used])
    output.measure("view_gain_share/random", distribution(drawn))
    for column, name in enumerate(MEASURES):
        output.measure(f"view_gain_share/{name}", distribution(share[:, column]))
        output.measure(f"view_rank_correlation/{name}", distribution(correlation[:, column]))
        output.measure(f"view_p_over_random/{name}", _p(share[:, column] - drawn))
        if name != MEASURES[0]:
            apart = share[:, column] - share[:, 0]
            output.measure(f"view_share_over_{MEASURES[0]}/{name}", distribution(apart))
            output.measure(f"view_p_over_{MEASURES[0]}/{name}", _p(apart))
    rows = [
        [number, known, drawn_share, *np.ravel(share_row), *np.ravel(ranks)]
        for number, result in enumerate(used)
        for known, drawn_share, share_row, ranks in zip(
            result.known, result.mean_share, result.share, result.correlation
        )
    ]
    columns = ["scene", "known views", "random share"]
    columns += [f"{name} {what}" for what in ("share", "rank") for name in MEASURES]
    output.table("views", columns, rows)
    output.figure("views", draw_views(MEASURES, share, correlation, drawn))


def _p(difference: FloatArray) -> float:
    """Return Wilcoxon's two-sided p of paired differences; 1 where there are none."""
    if not np.any(difference):
        return 1.0
    return float(np.asarray(wilcoxon(difference))[1])
