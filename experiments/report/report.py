"""``python -m experiments report``: all results in one self-contained page."""

from pathlib import Path

from experiments.harness import catalogue
from experiments.harness.contract import ExperimentError
from experiments.report.page import page
from experiments.report.report_options import Options
from experiments.report.results import read_results
from perception.geometry.files import replace_file


def run(options: Options) -> int:
    """Write the report and print where it is; return 0.

    Raises:
        ExperimentError: If there are no results, or one cannot be read.
    """
    print(write_report(options.out))
    return 0


def write_report(out: Path) -> Path:
    """Write OUT/report.html and return its path.

    Raises:
        ExperimentError: If there are no results, one cannot be read, or the page not written.
    """
    results = read_results(out)
    if not results:
        raise ExperimentError(f"no results in {out}: run an experiment first")
    path, text = out / "report.html", page(results, catalogue.EXPERIMENTS)
    try:
        replace_file(path, lambda stream: stream.write(text.encode()))
    except OSError as error:
        raise ExperimentError(f"{path}: {error.strerror}") from None
    return path
