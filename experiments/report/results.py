"""Result folders as the report reads them."""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

from experiments.harness import catalogue
from experiments.harness.contract import ExperimentError
from perception.geometry.files import RESULTS, read_json


@dataclasses.dataclass(frozen=True)
class Result:
    """One result folder as read.

    Attributes:
        name: Name of the experiment.
        title: Summary of the experiment; its name if it is not in the catalogue.
        thesis_element: Thesis element that it reproduces; empty if it is not in the catalogue.
        metrics: Contents of metrics.json.
        config: Contents of config.json.
        run: Contents of run.json.
        figures: PNG files.
        tables: CSV files.
    """

    name: str
    title: str
    thesis_element: str
    metrics: dict[str, Any]
    config: dict[str, Any]
    run: dict[str, Any]
    figures: tuple[Path, ...]
    tables: tuple[Path, ...]


def read_results(out: Path) -> list[Result]:
    """Return all complete results of a folder: those of the catalogue in its order, then others."""
    order = {name: index for index, name in enumerate(catalogue.EXPERIMENTS)}
    folders = [path.parent for path in out.glob("*/metrics.json")]
    folders.sort(key=lambda folder: (order.get(folder.name, len(order)), folder.name))
    return [read_result(folder) for folder in folders]


def read_result(folder: Path) -> Result:
    """Read one result folder.

    Raises:
        ExperimentError: If a file is missing or damaged.
    """
    entry = catalogue.EXPERIMENTS.get(folder.name)
    contents = {name: _read_json(folder / f"{name}.json") for name in ("metrics", "config", "run")}
    path = folder / "metrics.json"
    # Runs of earlier versions have no digest.
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if contents["run"].get("metrics_sha256", digest) != digest:
        raise ExperimentError(f"{path}: not as its run has written it; run the experiment again")
    for part, kind in (("measured", dict), ("thesis", dict), ("checks", list)):
        if not isinstance(contents["metrics"].get(part), kind):
            raise ExperimentError(f"{path}: {part!r} is missing or no {kind}")
    return Result(
        name=folder.name,
        title=entry.summary if entry else folder.name,
        thesis_element=entry.thesis if entry else "",
        metrics=contents["metrics"],
        config=contents["config"],
        run=contents["run"],
        figures=tuple(sorted((folder / "figures").glob("*.png"))),
        tables=tuple(sorted((folder / "tables").glob("*.csv"))),
    )


def _read_json(path: Path) -> dict[str, Any]:
    try:
        contents = read_json(path, RESULTS)
    except (OSError, ValueError) as error:
        raise ExperimentError(f"{path}: cannot be read ({error})") from None
    if not isinstance(contents, dict):
        raise ExperimentError(f"{path}: holds no object")
    return contents
