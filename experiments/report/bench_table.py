"""``python -m experiments bench-table``: the table of docs/benchmarks.md, from metrics.json."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments.harness.contract import ExperimentError, OptionError
from experiments.harness.summary import format_metric
from experiments.report.bench_table_options import Options
from experiments.report.results import Result, read_result
from perception.geometry.files import RESULTS, read_text, replace_file

BEGIN, END = "<!-- bench-table -->", "<!-- end of bench-table -->"


@dataclasses.dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        what: Name of the measured quantity.
        peer: Name of the peer.
        key: Name of the metric.
        unit: Unit, written behind the number.
        check: Name of the check that holds the metric against its bar; empty if it has none.
        factor: Factor from the metric to the unit.
    """

    what: str
    peer: str
    key: str
    unit: str = " times"
    check: str = ""
    factor: float = 1.0


_OCTOMAP = "OctoMap, same clouds"
ROWS = (
    Row(
        "loop of two rovers, time", "bare `mj_step`", "loop_overhead", check="loop overhead, plane"
    ),
    Row(
        "loop among rocks, time",
        "bare `mj_step`",
        "loop_overhead/rocks",
        check="loop overhead, rocks",
    ),
    Row("real-time factor, one core", "", "rtf/plane", "", "real-time factor, plane"),
    Row(
        "identification, time",
        "`mujoco.sysid`, same data",
        "sysid_time_ratio",
        check="identification, time over that of mujoco.sysid",
    ),
    Row(
        "identification, error",
        "`mujoco.sysid`, same data",
        "sysid_error_ratio",
        check="identification, error over that of mujoco.sysid",
    ),
    Row(
        "exact voxel map, 1 cm, speed",
        _OCTOMAP,
        "octomap_speedup/exact_1cm",
        check="mapping, exact at 1 cm over OctoMap",
    ),
    Row(
        "sparse voxel map, 1 cm, speed",
        _OCTOMAP,
        "octomap_speedup/fast_1cm",
        check="mapping, fast at 1 cm over OctoMap",
    ),
    Row("sparse voxel map, 5 mm, speed", _OCTOMAP, "octomap_speedup/fast_5mm"),
    Row(
        "rating of views, speed",
        "OctoMap's rays",
        "octomap_speedup/views",
        check="mapping, view evaluation over OctoMap's rays",
    ),
    Row(
        "sparse map of 1 mm, memory",
        "",
        "memory_bytes/1mm",
        " MB",
        "mapping, memory at 1 mm over 1.5 m",
        1e-6,
    ),
    Row("placement on a map, speed", "every candidate rated", "search_speedup/map"),
    Row(
        "markers, error of `cv2.HoughCircles`",
        "ours",
        "marker_error_ratio/cv2_over_tht",
        check="markers, cv2.HoughCircles' error over the THT's",
    ),
    Row(
        "markers, time of `cv2.HoughCircles`",
        "ours",
        "marker_time_ratio/cv2_over_tht",
        check="markers, cv2.HoughCircles' time over the THT's",
    ),
    Row("predictor 5 of a picture, time", "`numpy.diff`", "predictor_ratio/5"),
    Row("inverse kinematics, 5 stages, speed", "brute force, listed poses", "braid_speedup/5"),
    Row(
        "the same, 10 stages",
        "brute force, extrapolated from 6",
        "braid_speedup/10_extrapolated",
    ),
    Row("time over robots, 1 to 8, exponent", "", "scaling_exponent/robots", ""),
    Row("time over voxels, 1 cm to 1 mm, exponent", "", "scaling_exponent/voxels", ""),
    Row("time over stages, 7 to 20, exponent", "", "scaling_exponent/stages", ""),
    Row("sweep by two processes, speed", "one process", "sweep_speedup/2"),
)


def run(options: Options) -> int:
    """Print the table, or write it into a file; return 0.

    Raises:
        ExperimentError: If there is no result of bench, or it cannot be read.
        OptionError: If the file has no marks for the table.
    """
    folder = options.out / "bench"
    if not (folder / "metrics.json").exists():
        raise ExperimentError(f"no result in {folder}: run python -m experiments bench first")
    table = bench_table(read_result(folder))
    if options.write is None:
        print(table)
    else:
        write_between_marks(options.write, table)
    return 0


def bench_table(result: Result) -> str:
    """Return the table in Markdown, and what it was measured on.

    Args:
        result: Result of bench; rows without a metric read "not run".
    """
    measured = result.metrics["measured"]
    checks = {check["name"]: check for check in result.metrics["checks"]}
    lines = ["| what | beside | ours (95 % interval) | bar |", "|---|---|---|---|"]
    lines += [
        f"| {row.what} | {row.peer} | {_value(row, measured)} | {_bar(row, checks)} |"
        for row in ROWS
    ]
    run = result.run
    date = str(run.get("finished", "?")).partition("T")[0]
    mujoco = run.get("versions", {}).get("mujoco", "?")
    where = f"{run.get('cores', '?')} cores of {run.get('cpu', '?')}, MuJoCo {mujoco}, {date}"
    size = ", quick run" if result.config.get("quick") else ""
    lines += ["", f"Measured on {where}{size}; `python -m experiments bench`."]
    return "\n".join(lines)


def write_between_marks(path: Path, table: str) -> None:
    """Replace what a file has between the marks of the table.

    Raises:
        OptionError: If the file cannot be read or written, or has not both marks, once each.
    """
    try:
        text = read_text(path, RESULTS)
    except (OSError, ValueError) as error:
        raise OptionError(f"--write {path}: {error}") from None
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise OptionError(f"--write {path}: expected one {BEGIN!r} and after it one {END!r}")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    text = f"{before}{BEGIN}\n\n{table}\n\n{END}{after}"
    try:
        replace_file(path, lambda stream: stream.write(text.encode()))
    except OSError as error:
        raise OptionError(f"--write {path}: {error.strerror}") from None


def _value(row: Row, measured: Mapping[str, Any]) -> str:
    if row.key not in measured:
        return "not run"
    centre, interval = format_metric(_scaled(measured[row.key], row.factor))
    return f"{centre}{row.unit}" + (f" ({interval.replace('..', 'to')})" if interval else "")


def _scaled(value: Any, factor: float) -> Any:
    """Return a number or a distribution with three digits, so that it can be read."""
    if isinstance(value, dict):
        return {key: _scaled(item, factor) for key, item in value.items()}
    return float(f"{factor * value:.3g}")


def _bar(row: Row, checks: Mapping[str, Mapping[str, Any]]) -> str:
    if row.check not in checks:
        return ""
    check = checks[row.check]
    bound = str(check["bound"])
    if row.factor != 1.0:
        sign, _, number = bound.partition(" ")
        bound = f"{sign} {row.factor * float(number):g}"
    return f"{bound}: {'holds' if check['ok'] else '**falls short**'}"
